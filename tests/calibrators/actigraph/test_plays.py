"""A reading that sticks, and follows its input behind a play: a law of its own."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from imucalib.calibrators.actigraph.request import ActigraphRequest

#: Where the reading stands behind the moves of each axis (n, 3) g, for a play of so many g.
Moves = Any


def behind(x: Moves, width: float) -> Moves:
    at, found = x[0], []
    for row in x:
        at = np.clip(at, row - width / 2.0, row + width / 2.0)
        found.append(at)
    return np.array(found)


def solved(worn: ModuleType, monkeypatch: pytest.MonkeyPatch, effect: Any, seed: int) -> Any:
    monkeypatch.setitem(worn.EFFECTS, "planted", lambda x, t, u, c: effect(x, c))
    return worn.Case("white", "planted", 30.0, seed).solved(ActigraphRequest())


@pytest.mark.slow
@pytest.mark.parametrize("width", [0.004, 0.02, 0.3])
def test_a_play_is_no_share_of_the_posture_before(
    worn: ModuleType, monkeypatch: pytest.MonkeyPatch, width: float
) -> None:
    result = solved(worn, monkeypatch, lambda x, c: c * (behind(x, width) - x) / width, 1)
    step = result.loop.steps[0]
    assert step.effect == "approach_hysteresis"
    assert not any(s.certain for s in result.loop.steps if s.effect == "hysteresis")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
def test_a_share_of_the_posture_before_stays_certain(
    worn: ModuleType, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    result = solved(worn, monkeypatch, lambda x, c: c * np.vstack([x[:1], x[:-1]]), seed)
    (step,) = result.loop.steps
    assert step.effect == "hysteresis"
    assert step.certain
