"""Swings with a period are told from a bias that wanders, on noise of known walks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from imucalib.loop.wander.bank import bank_of
from imucalib.loop.wander.left.strongest import strongest
from imucalib.loop.wander.left.swing import swings
from imucalib.loop.wander.likelihood import Terms
from imucalib.loop.wander.walk import Course, Walk, drawn

SPAN, ROWS, HOUR = 3.0 * 86400.0, 240, 3600.0
TRIED = (Walk(0.0, 1.0), Walk(1.0, HOUR), Walk(10.0, HOUR), Walk(10.0, SPAN / 6.0))


def recording(seed: int, bias: float, scale: float, walk: Walk) -> tuple[Any, Any]:
    """One axis that points up or down by chance; its bias and scale swing in 7 h."""
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(0.0, SPAN, ROWS))
    up = rng.uniform(-1.0, 1.0, ROWS)
    course = Course(time, np.ones((ROWS, 1)), np.ones(ROWS), np.zeros(ROWS, np.intp))
    wave = np.sin(2.0 * np.pi * time / (7.0 * HOUR) + 1.0)
    data = (bias + scale * up) * wave + drawn(course, walk, rng, 1)[:, 0]
    bank = bank_of(course, TRIED, np.column_stack([np.ones(ROWS), up, data]))
    model = SimpleNamespace(slices=lambda _: {"bias": slice(0, 1), "scale": slice(1, 2)})
    fit = SimpleNamespace(
        model=model, parameters=[SimpleNamespace(typical=1.0)] * 2,
        observations=SimpleNamespace(context=None),
    )  # fmt: skip
    terms = Terms(np.arange(2), np.full(2, 0.01), 2)
    level = SimpleNamespace(walk=1)  # an hour's walk, for which such a swing passes
    return SimpleNamespace(fit=fit), SimpleNamespace(bank=bank, terms=terms, level=level)


def told(problem: Any, found: Any) -> Any:
    one = strongest(found, swings(problem, found))
    return () if one is None else (one.structure,)


@pytest.mark.parametrize("walk", [Walk(0.0, 1.0), Walk(3.0, HOUR)])
@pytest.mark.parametrize("of", ["bias", "scale"])
def test_a_swing_is_told_with_its_period(of: str, walk: Walk) -> None:
    size = 6.0 if walk.rho else 2.0
    found = told(*recording(1, size * (of == "bias"), 2.0 * size * (of == "scale"), walk))
    assert [f.name.partition(" of ")[0] for f in found] == [f"the {of} swings with a period"]
    assert float(found[0].name.split()[-2]) == pytest.approx(7.0, rel=0.06)
    assert (found[0].driver, found[0].kind) == ("time", "swing")
    assert found[0].p < 1e-3
    assert 0.0 < found[0].share < 1.0


@pytest.mark.parametrize("walk", [*TRIED, Walk(30.0, 2.0 * SPAN)])
def test_what_wanders_has_no_period(walk: Walk) -> None:
    assert not any(told(*recording(seed, 0.0, 0.0, walk)) for seed in range(4))


def test_three_swings_are_no_period_of_few_runs() -> None:
    problem, found = recording(1, 9.0, 0.0, TRIED[0])
    bank = found.bank
    course = Course(bank.course.time[::20], np.ones((12, 1)), np.ones(12), np.zeros(12, np.intp))
    found.bank = bank_of(course, TRIED, bank.columns[::20])
    assert told(problem, found) == ()
