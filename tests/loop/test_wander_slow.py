"""Whether what time drives leads a bias that wanders slowly, on noise of known walks."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from imucalib.loop.found import Step
from imucalib.loop.wander.bank import bank_of
from imucalib.loop.wander.beside.changes import beside_changes
from imucalib.loop.wander.beside.every import unsure_together
from imucalib.loop.wander.choice import Search, Taken
from imucalib.loop.wander.likelihood import Level, Terms
from imucalib.loop.wander.scores import Entry, Scored
from imucalib.loop.wander.slow import beside_slow_walks, lead
from imucalib.loop.wander.walk import Course, Walk, drawn

SPAN, ROWS = 86400.0, 150


def recording(seed: int, walk: Walk, step: float) -> tuple[Any, Terms, Any]:
    """A bank of three parts whose bias has a step halfway and wanders; one axis is seen."""
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(0.0, SPAN, ROWS))
    part = np.arange(ROWS) * 3 // ROWS
    course = Course(time, np.ones((ROWS, 1)), np.ones(ROWS), part.astype(np.intp))
    late = (time > 0.5 * SPAN).astype(float)
    data = step * late + drawn(course, walk, rng, 1)[:, 0]
    tried = (Walk(0.0, 1.0), Walk(1.0, SPAN / 6.0), Walk(10.0, SPAN / 6.0))
    bank = bank_of(course, tried, np.column_stack([np.ones(ROWS), late, data]))
    entry = Entry("bias_step@43200s", "bias_step", "time", np.array([1]))
    taken = SimpleNamespace(found=SimpleNamespace(entry=entry), size=3.0)
    return bank, Terms(np.arange(1), np.full(1, 0.01), 1), taken


def as_found(bank: Any, terms: Terms, taken: tuple[Any, ...]) -> tuple[Any, Any]:
    """A problem and its search; column 0 of a bank of four is the base model's scale."""
    slices = {"scale": slice(0, 1)} if bank.columns.shape[1] == 4 else {}
    fit = SimpleNamespace(
        model=SimpleNamespace(slices=lambda _: slices), parameters=[SimpleNamespace(typical=0.001)],
        observations=SimpleNamespace(context=None),
    )  # fmt: skip
    small = SimpleNamespace(observations=SimpleNamespace(context={}))
    noise = SimpleNamespace(scatter=1.0)
    problem = SimpleNamespace(fit=fit, small=small, terms=terms, noise=noise)
    level = Level(0, 0.0, 1.0, 1)
    return problem, Search(bank, terms, level, taken, (), (), ())


def scaled(data: Any) -> tuple[Any, Terms, Any]:
    """A bank whose one axis points up or down, in which the scale drifted, with data (time / span,
    up) -> (n,) beside white noise."""
    rng = np.random.default_rng(4)
    time = np.sort(rng.uniform(0.0, SPAN, ROWS))
    up = rng.uniform(-1.0, 1.0, ROWS)
    course = Course(time, np.ones((ROWS, 1)), np.ones(ROWS), np.zeros(ROWS, np.intp))
    drift = up * (time / SPAN - 0.5)
    y = data(time / SPAN, up) + rng.standard_normal(ROWS)
    bank = bank_of(course, (Walk(0.0, 1.0),), np.column_stack([up, np.ones(ROWS), drift, y]))
    entry = Entry("scale_drift", "", "time", np.array([2]))
    score = Scored(entry, 20.0, 0, 3.0, 1.0, 1.0, 0.5)
    taken = Taken(score, 3.0, np.zeros(2), 2.0, 1.0, ())
    return bank, Terms(np.arange(2), np.full(2, 0.01), 2), taken


def leads(walk: Walk, step: float) -> np.ndarray:
    every = [recording(seed, walk, step) for seed in range(6)]
    return np.array([lead(b, terms, [taken], b.course.seen) for b, terms, taken in every])


def test_a_step_leads_slow_walks_and_a_slow_walk_is_no_step() -> None:
    white = Walk(0.0, 1.0)
    assert leads(white, 4.0).min() > 6.0
    assert np.median(leads(Walk(30.0, SPAN), 0.0)) < 0.0


@pytest.mark.parametrize(("step", "walk", "alone"), [(4.0, 0.0, True), (0.0, 30.0, False)])
def test_only_what_may_follow_time_has_the_slow_walk_as_its_rival(
    step: float, walk: float, alone: bool
) -> None:
    bank, terms, taken = recording(1, Walk(walk, SPAN), step)
    other = Entry("cubic", "", "shape", np.array([0]))
    cubic = SimpleNamespace(found=SimpleNamespace(entry=other), size=1.0)
    told = (Step("cubic", 0.01, 99, 9.0, (), ()), Step("step", 0.01, 99, 9.0, (), ("lag",)))
    found = beside_slow_walks(*as_found(bank, terms, (cubic, taken)), told)
    assert found[0] is told[0]
    assert found[1].aliases == (("lag",) if alone else ("lag", "wandering_bias"))


def test_what_follows_the_past_of_the_temperature_leads_a_slow_walk_by_more() -> None:
    """The same columns and the same data, by three nats or by ten."""
    bank, terms, taken = recording(2, Walk(0.0, 1.0), 1.6)
    gained = lead(bank, terms, [taken], bank.course.seen)
    assert 3.0 < gained < 10.0
    told = (Step("step", 0.01, 99, 9.0, (), ()),)
    for name, kind, sure in (("step", "time", True), ("thermal_lag@1h", "temperature", False)):
        entry = replace(taken.found.entry, name=name, kind=kind)
        one = SimpleNamespace(found=SimpleNamespace(entry=entry), size=taken.size)
        found = beside_slow_walks(*as_found(bank, terms, (one,)), told)
        assert (found[0].aliases == ()) == sure


def test_what_may_stand_for_another_step_is_unsure_with_it() -> None:
    lag = Step("thermal_lag@1h", 0.01, 99, 30.0, (), ("bias_step@7200s",))
    jump, cubic = (Step(name, 0.01, 99, 13.0, (), ()) for name in ("bias_step@7300s", "cubic"))
    found = unsure_together((lag, jump, cubic))
    assert [step.aliases for step in found] == [lag.aliases, ("thermal_lag@1h",), ()]


STEP = Step("scale_drift", 0.01, 99, 20.0, (), ())


@pytest.mark.parametrize(
    ("data", "rival"),
    [
        (lambda t, up: 12.0 * up * (t - 0.5), ""),
        (lambda t, up: 6.0 * up * (t > 0.5), "scale_step"),
        (lambda t, up: 6.0 * up * (t > 0.3), "scale_step"),
    ],
)
def test_a_scale_that_jumps_is_no_certain_drift_of_it(data: Any, rival: str) -> None:
    bank, terms, taken = scaled(data)
    found = beside_changes(*as_found(bank, terms, (taken,)), (STEP,))
    assert [name.partition("@")[0] for name in found[0].aliases] == ([rival] if rival else [])


def test_a_scale_that_wanders_slowly_is_no_certain_drift_of_it() -> None:
    bank, terms, taken = scaled(lambda t, up: 8.0 * up * np.sin(9.0 * t + 2.0 * t**2))
    found = beside_slow_walks(*as_found(bank, terms, (taken,)), (STEP,))
    assert found[0].aliases == ("wandering_scale",)


def test_where_time_drives_nothing_no_scale_is_held_to_jump() -> None:
    bank, terms, taken = scaled(lambda t, up: 12.0 * up * (t - 0.5))
    other = SimpleNamespace(found=SimpleNamespace(entry=Entry("cubic", "", "shape", np.array([2]))))
    assert beside_changes(*as_found(bank, terms, (other,)), (STEP,)) == (STEP,)
    nothing = as_found(bank, terms, (taken,))
    nothing[0].fit.model = SimpleNamespace(slices=lambda _: {})
    assert beside_changes(*nothing, (STEP,)) == (STEP,)
