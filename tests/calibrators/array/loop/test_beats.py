"""Beats of gyros' own clocks: the line that a sawtooth follows."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.array.loop.ages import Ages, beats
from imucalib.estimators.array.sample_age import _sawtooth

T = np.arange(0.0, 40.0, 0.01) + 100.0


@pytest.mark.parametrize(("frequency", "phase"), [(1.7, 0.3), (-0.6, 0.85)])
def test_frequency_phase_and_wander_of_a_sawtooth(frequency: float, phase: float) -> None:
    leaves = 0.05 * np.sqrt(2.0) * np.sin(2.0 * np.pi * T / 8.0)
    turns = frequency * (T - 100.0) + phase + leaves
    wave = np.column_stack([_sawtooth(turns), np.zeros(T.size)])
    clock = SimpleNamespace(frequency=np.array([frequency + 0.01, np.nan]))
    beat, none = beats(Ages(wave, np.ones(T.size, bool), clock), T)  # type: ignore[arg-type]
    assert none is None
    assert beat is not None
    assert beat.frequency == pytest.approx(frequency, abs=0.002)
    assert beat.phase == pytest.approx(phase, abs=0.03)
    assert beat.at == 100.0
    assert beat.wander == pytest.approx(0.05, rel=0.05)


def test_a_sawtooth_runs_from_minus_to_plus_a_half() -> None:
    turns = np.array([0.0, 0.25, 0.75, 1.0, -0.25])
    np.testing.assert_allclose(_sawtooth(turns), [-0.5, -0.25, 0.25, -0.5, 0.25])
