"""Numbers behind the fused IMU, by hand."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from imucalib.calibrators.array.fused.instrument import Beyond, beyond_linear
from imucalib.calibrators.array.loop.motion import board_motion

QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TURN = np.array([np.eye(3), QUARTER])


def block(effect: str, *values: float) -> dict[str, Any]:
    return {"effect": effect, "parameters": [{"value": v} for v in values]}


def beyond(*blocks: dict[str, Any]) -> Beyond:
    triads = [SimpleNamespace(name=n, rotation=r) for n, r in zip("ab", TURN, strict=True)]
    return beyond_linear(SimpleNamespace(triads=triads, facts={"effects": blocks}))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "answer"),
    [("gyro_low_pass", lambda x: 1.0 / (1.0 + x)), ("gyro_delay", lambda x: np.exp(-x))],
)
def test_lags_over_time_are_not_those_of_the_first_order(
    name: str, answer: Callable[[complex], complex]
) -> None:
    """A tone of 4 Hz, 4 ms: the second order is 1 % of it, and half of that for a delay."""
    t, pace = 0.01 * np.arange(400), 2.0j * np.pi * 4.0
    tone = np.exp(pace * t)[:, None] * np.array([12.0, 0.0, 5.0])
    beside = np.stack([np.arange(400) > 0, np.arange(400) < 399], axis=1)
    motion = board_motion(
        imus=("a", "b"), rotations=TURN, t=t, rate=tone.imag, spin=(pace * tone).imag
    ).coursed(beside)
    made = beyond(block(name, 4.0))
    late = made.late(t, None)
    assert late is not None
    read = (answer(4e-3 * pace) * tone).imag[:, None]
    first = tone.imag[:, None] + np.matmul(late, (pace * tone).imag[:, None, :, None])[..., 0]
    inner = slice(20, -20)
    assert np.abs(first - read)[inner].max() > 0.05
    assert np.abs(first + made.added_by_lags(motion)[1] - read)[inner].max() < 0.004
