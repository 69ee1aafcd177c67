"""Whether what time drives leads a bias that wanders slowly, on noise of known walks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from imucalib.loop.found import Step
from imucalib.loop.wander.bank import bank_of
from imucalib.loop.wander.likelihood import Terms
from imucalib.loop.wander.scores import Entry
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


def leads(walk: Walk, step: float) -> np.ndarray:
    return np.array([lead(*recording(seed, walk, step)) for seed in range(6)])


def test_a_step_leads_slow_walks_and_a_slow_walk_is_no_step() -> None:
    white = Walk(0.0, 1.0)
    assert leads(white, 4.0).min() > 6.0
    assert np.median(leads(Walk(30.0, SPAN), 0.0)) < 0.0


@pytest.mark.parametrize(("step", "walk", "alone"), [(4.0, 0.0, True), (0.0, 30.0, False)])
def test_only_what_time_drives_has_the_slow_walk_as_its_rival(
    step: float, walk: float, alone: bool
) -> None:
    bank, terms, taken = recording(1, Walk(walk, SPAN), step)
    other = Entry("cubic", "", "shape", np.array([0]))
    cubic = SimpleNamespace(found=SimpleNamespace(entry=other), size=1.0)
    told = (Step("cubic", 0.01, 99, 9.0, (), ()), Step("step", 0.01, 99, 9.0, (), ("lag",)))
    found = beside_slow_walks(bank, terms, (cubic, taken), told)
    assert found[0] is told[0]
    assert found[1].aliases == (("lag",) if alone else ("lag", "wandering_bias"))
