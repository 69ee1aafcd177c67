"""What stays of a search that was repeated without each block of time."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.loop.design import Fold
from imucalib.loop.difference import Difference
from imucalib.loop.found import Step
from imucalib.loop.wander.confirm import _doubt
from imucalib.loop.wander.report import beside_its_moment
from imucalib.loop.wander.scores import Entry

LIKELY = Difference(2.0, 1.0, -0.1, 1.5, 0.1, 10, nats=4.0, nats_low=1.0)
NOT = replace(LIKELY, plain_low=-0.1, nats_low=-0.1)


def doubt(timed: bool, again: int, evidence: float, gained: Difference) -> str:
    """Of an effect with an alias that is found again, under either name, in some of ten."""
    step = Step("bias_step@3600s", 0.01, 99, evidence, (), ("thermal_lag@2h",))
    names = [{"cubic", "bias_step"}, {"thermal_lag"}]
    found = [names[k % 2] if k < again else {"cubic"} for k in range(10)]
    taken = SimpleNamespace(
        found=SimpleNamespace(entry=SimpleNamespace(timed=timed, family=""), evidence=evidence)
    )
    each = SimpleNamespace(found=found)
    return _doubt(taken, step, 9.0, each, gained)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("timed", "again", "stays"),
    [(False, 5, True), (False, 4, False), (True, 8, True), (True, 7, False)],
)
def test_half_of_the_searches_find_it_again_and_most_what_time_drives(
    timed: bool, again: int, stays: bool
) -> None:
    found = doubt(timed, again, 50.0, LIKELY)
    assert (found == "") == stays
    assert (f"found again in {again} of 10" in found) == (not stays)


@pytest.mark.parametrize(
    ("timed", "evidence", "stays"),
    [(False, 13.6, True), (False, 13.4, False), (True, 50.0, False)],
)
def test_without_a_likely_gain_it_is_half_above_the_bar_and_not_of_time(
    timed: bool, evidence: float, stays: bool
) -> None:
    """The bar is nine nats."""
    found = doubt(timed, 10, evidence, NOT)
    assert (found == "") == stays
    assert ("gains +4.0 nats there, at least -0.1" in found) == (not stays)


@pytest.mark.parametrize(("again", "stays"), [(5, True), (4, False)])
def test_a_form_is_found_again_in_every_name_of_its_driver(again: int, stays: bool) -> None:
    """An exponential of the temperature in five searches, its straight line in seven: refused."""
    step = Step("shape@bias:temperature:exponential:1:2", 0.01, 99, 160.0, (), ())
    entry = Entry(step.effect, "shape", "temperature", np.arange(3))
    taken = SimpleNamespace(found=SimpleNamespace(entry=entry, evidence=160.0))
    found = [{"temperature_bias", "bias:temperature"}] * again + [{"cubic", "response:xyz"}] * (
        10 - again
    )
    each = SimpleNamespace(found=found)
    assert (_doubt(taken, step, 9.0, each, LIKELY) == "") == stays  # type: ignore[arg-type]


def test_the_block_in_which_a_bias_jumps_says_nothing_of_the_jump() -> None:
    """Four hours of ten rows each, left out with the row on either side; in the third, whose jump
    nobody can time without it, all is lost."""
    time = 360.0 * np.arange(40.0)
    rows = np.arange(40).reshape(4, 10)
    near = [np.arange(max(r[0] - 1, 0), min(r[-1] + 2, 40)) for r in rows]
    folds = [Fold(r, np.setdiff1d(np.arange(40), n)) for r, n in zip(rows, near, strict=True)]
    after = np.where(np.arange(40) // 10 == 2, 50.0, 1.0)
    each = SimpleNamespace(
        before=SimpleNamespace(error=np.full((40, 1, 1), 2.0)),
        after=SimpleNamespace(error=after[:, None, None]),
        gains=np.array([8.0, 9.0, -500.0, 10.0]),
    )

    def gained(name: str) -> Difference:
        taken = SimpleNamespace(found=SimpleNamespace(entry=SimpleNamespace(name=name)))
        return beside_its_moment(each, folds, time, taken)  # type: ignore[arg-type]

    assert gained("bias_step@9000s").nats == 27.0
    assert gained("bias_step@9000s").likely
    assert gained("bias_step@9000s").gain == pytest.approx(1.0)
    # Within the gap of two blocks neither is one that knows it.
    assert gained("bias_step@10700s").nats == 17.0
    for name in ("bias_drift", "bias_step@record9", "thermal_lag@1h"):
        assert gained(name).nats == -473.0
        assert not gained(name).likely
