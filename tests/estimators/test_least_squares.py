"""When a fit is given up: θ that creeps at every noise has no end."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from imucalib.core.effect import Context
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownVector
from imucalib.effects import named
from imucalib.estimators import least_squares
from imucalib.units import MG, STANDARD_GRAVITY


def sheet(n: int = 30) -> Observations:
    rng = np.random.default_rng(0)
    i, t = np.arcsin(rng.uniform(-1.0, 1.0, n)), rng.uniform(0.0, 2.0 * np.pi, n)
    u = np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=-1)
    reading = STANDARD_GRAVITY * u + 20.0 * MG + MG * rng.standard_normal((n, 3))
    ids = np.arange(n)
    reference = KnownVector(i, t, STANDARD_GRAVITY, ids, ids)
    sigma = np.full((n, 1, 3), MG)
    return Observations(reading[:, None], sigma, reference, Context(n), ids, ("",) * n)


@pytest.mark.parametrize(("creeps", "rounds"), [(100, 3), (2, None), (0, None)])
def test_a_fit_that_creeps_three_times_in_a_row_is_given_up(
    creeps: int, rounds: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    solve, done = least_squares.minimise, []

    def slow(*arguments: Any) -> Any:
        done.append(1)
        found = solve(*arguments)
        return replace(found, converged=False) if len(done) <= creeps else found

    monkeypatch.setattr(least_squares, "minimise", slow)
    found = least_squares.fit(Model((named("bias"),)), sheet())
    assert found.converged == (rounds is None)
    if rounds is not None:
        assert len(done) == rounds
    assert found.theta == pytest.approx([20.0] * 3, abs=1.0)
