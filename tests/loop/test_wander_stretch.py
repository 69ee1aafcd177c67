"""A while in which the bias is another one is told with its moment and its length."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from imucalib.loop.wander.bank import bank_of
from imucalib.loop.wander.left.stretch import stretches
from imucalib.loop.wander.left.strongest import strongest
from imucalib.loop.wander.likelihood import Terms
from imucalib.loop.wander.walk import Course, Walk, drawn

SPAN, ROWS, HOUR = 3.0 * 86400.0, 240, 3600.0
TRIED = (Walk(0.0, 1.0), Walk(1.0, HOUR), Walk(10.0, HOUR), Walk(10.0, SPAN / 6.0))


def recording(
    seed: int, bias: float, scale: float, walk: Walk, *, at: float = 30.0, tails: float = 0.0
) -> tuple[Any, Any]:
    """One axis that points up or down by chance; bias and scale are others for 3 h. tails :
    freedom of Student's t, 0 for a normal"""
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(0.0, SPAN, ROWS))
    up = rng.uniform(-1.0, 1.0, ROWS)
    course = Course(time, np.ones((ROWS, 1)), np.ones(ROWS), np.zeros(ROWS, np.intp))
    inside = (time >= at * HOUR) & (time < (at + 3.0) * HOUR)
    noise = rng.standard_t(tails, ROWS) / 3**0.5 if tails else drawn(course, walk, rng, 1)[:, 0]
    data = (bias + scale * up) * inside + noise
    bank = bank_of(course, TRIED, np.column_stack([np.ones(ROWS), up, data]))
    model = SimpleNamespace(slices=lambda _: {"bias": slice(0, 1), "scale": slice(1, 2)})
    fit = SimpleNamespace(
        model=model, parameters=[SimpleNamespace(typical=1.0)] * 2,
        observations=SimpleNamespace(context=None),
    )  # fmt: skip
    terms = Terms(np.arange(2), np.full(2, 0.01), 2)
    level = SimpleNamespace(walk=TRIED.index(walk) if walk in TRIED else 0)
    return SimpleNamespace(fit=fit), SimpleNamespace(bank=bank, terms=terms, level=level)


def told(problem: Any, found: Any) -> Any:
    one = strongest(found, stretches(problem, found))
    return () if one is None else (one.structure,)


@pytest.mark.parametrize("at", [0.0, 30.0, 69.0], ids=["first", "inside", "last"])
@pytest.mark.parametrize("of", ["bias", "calibration"])
@pytest.mark.parametrize("walk", TRIED[:2])
def test_a_while_is_told_with_its_moment_and_length(of: str, at: float, walk: Walk) -> None:
    one, two = (9.0, 0.0) if of == "bias" else (0.0, 16.0)
    found = told(*recording(1, one, two, walk, at=at))
    assert [f.name.partition(" is ")[0] for f in found] == [f"the {of}"]
    words = found[0].name.split()
    assert float(words[words.index("for") + 1]) == pytest.approx(3.0, abs=0.8)
    assert float(words[words.index("after") - 2]) == pytest.approx(at, abs=0.8)
    assert (found[0].driver, found[0].kind) == ("time", "stretch")
    assert found[0].p < 1e-3


@pytest.mark.parametrize("walk", [*TRIED, Walk(30.0, 2.0 * SPAN)])
def test_what_wanders_is_no_stretch(walk: Walk) -> None:
    assert not any(told(*recording(seed, 0.0, 0.0, walk)) for seed in range(4))


def test_heavy_tails_are_no_stretch() -> None:
    assert not any(told(*recording(seed, 0.0, 0.0, TRIED[0], tails=3.0)) for seed in range(8))


def test_few_runs_have_no_stretch() -> None:
    problem, found = recording(1, 9.0, 0.0, TRIED[0])
    bank = found.bank
    course = Course(bank.course.time[::8], np.ones((30, 1)), np.ones(30), np.zeros(30, np.intp))
    found.bank = bank_of(course, TRIED, bank.columns[::8])
    assert stretches(problem, found) == []
