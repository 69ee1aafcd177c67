"""The words of a search follow from its numbers: each from both sides of where it changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student

from imucalib.loop.found import Loop, Step, Unexplained
from imucalib.loop.held_out import Difference, difference, with_density
from imucalib.loop.record_errors import RecordError

STEP = Step("cubic", 9.0, (), (), certain=True)
CURVE = replace(STEP, effect="curve@bias:order:0:1:4", curve=True)
RECORD = RecordError(3, "row 4", "y", 100.0, 3.0, "mg", "lost sign of y", (), 0.999)
LEFT = Unexplained("a", "order", "bias", 0.999, 9.0)
SURE = Difference(2.0, 1.0, 0.5, 1.5, 0.6, 20)
UNSURE = replace(SURE, low=-0.1)


@pytest.mark.parametrize(
    ("loop", "word"),
    [
        (Loop(0, 1), "nothing missing"),
        (Loop(0, 1, steps=(STEP,), difference=SURE), "explained"),
        (Loop(0, 1, steps=(STEP,)), "explained"),  # nothing was left out, as declared effects
        (Loop(0, 1, steps=(STEP,), difference=UNSURE), "suspected"),
        (Loop(0, 1, steps=(STEP, CURVE), difference=SURE), "explained in part"),
        (Loop(0, 1, steps=(STEP,), unexplained=(LEFT,), difference=SURE), "explained in part"),
        (Loop(0, 1, steps=(CURVE,), difference=SURE), "unexplained"),
        (Loop(0, 1, unexplained=(LEFT,)), "unexplained"),
        (Loop(0, 1, records=(RECORD,)), "explained"),
        (Loop(0, 1, records=(replace(RECORD, probability=0.9),)), "suspected"),
        (Loop(0, 1, records=(RECORD, replace(RECORD, probability=0.9))), "suspected"),
        (Loop(0, 1, records=(RECORD,), unexplained=(LEFT,)), "explained in part"),
    ],
)
def test_the_verdict(loop: Loop[int], word: str) -> None:
    assert loop.verdict == word


@pytest.mark.parametrize(
    ("found", "proved", "likely", "holds"),
    [
        (SURE, True, True, True),
        (UNSURE, False, True, True),
        (replace(UNSURE, plain_low=-0.1), False, False, True),
        (replace(UNSURE, after=2.1, plain_low=-0.3), False, False, False),
        (replace(UNSURE, nats=3.0, nats_low=0.1), True, True, True),
        # Without a gain beyond the scatter both error and density have to gain.
        (replace(UNSURE, plain_low=-0.1, nats=0.1, nats_low=-2.0), False, False, True),
        (replace(UNSURE, plain_low=-0.1, nats=-0.1, nats_low=-2.0), False, False, False),
        (replace(UNSURE, after=2.1, plain_low=-0.3, nats=0.1, nats_low=-2.0), False, False, False),
        # The density proves it where the error moves within its scatter, and not beyond.
        (replace(UNSURE, after=2.1, plain_low=-0.3, nats=9.0, nats_low=4.0), True, True, True),
        (replace(UNSURE, after=2.1, plain_low=-0.15, nats=9.0, nats_low=4.0), True, True, False),
    ],
)  # fmt: skip
def test_what_a_gain_allows_to_say(
    found: Difference, proved: bool, likely: bool, holds: bool
) -> None:
    assert (found.proved, found.likely, found.holds) == (proved, likely, holds)


@pytest.mark.parametrize("metric", ["mean", "rms"])
def test_the_interval_of_a_gain_is_students_over_the_parts(metric: str) -> None:
    """Parts of equal size, of five folds: widened by sqrt(1 + 5 / 4). Of an rms the interval of the
    mean squares, divided by the sum of both roots."""
    rng = np.random.default_rng(1)
    before, after = np.abs(rng.normal(2.0, 0.5, (12, 3))), np.abs(rng.normal(1.5, 0.5, (12, 3)))
    found = difference(before.ravel(), after.ravel(), np.repeat(np.arange(12), 3), 5, metric)  # type: ignore[arg-type]
    power = 1 if metric == "mean" else 2
    each = np.mean(before**power - after**power, axis=1)
    start, end = (np.mean(e**power) ** (1 / power) for e in (before, after))
    unit = 1.0 if metric == "mean" else start + end
    half = student.ppf(0.975, 11) * np.std(each, ddof=1) / np.sqrt(12)
    assert (found.before, found.after, found.parts) == pytest.approx((start, end, 12))
    edges = [each.mean() - np.sqrt(2.25) * half, each.mean() + np.sqrt(2.25) * half]
    assert [found.low, found.high] == pytest.approx([e / unit for e in edges])
    assert found.plain_low == pytest.approx((each.mean() - half) / unit)


def test_the_gain_in_density_has_students_lower_edge() -> None:
    nats = np.array([1.0, 3.0, -0.5, 2.0, 2.5])
    found = with_density(SURE, nats)
    edge = 8.0 - student.ppf(0.975, 4) * np.std(nats, ddof=1) * np.sqrt(5)
    assert (found.nats, found.nats_low) == pytest.approx((8.0, edge))
