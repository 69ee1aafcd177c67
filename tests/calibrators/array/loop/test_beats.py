"""Beats of gyros' own clocks: the line that a sawtooth follows."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.array.loop.ages import Ages, beats
from imucalib.calibrators.array.loop.timing import _sawtooth, _sharpened

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


def test_the_first_seconds_know_nothing_of_the_last() -> None:
    """A clock whose phase jumps in the last block: the phase of the first stays where it is."""
    t = np.arange(0.0, 30.0, 0.02)
    turns = 0.9 * t
    true = turns + np.where(t > 27.0, 0.14, -0.06)
    series = np.asarray(true - np.floor(true) - 0.5)
    # The last three seconds turn harder by far.
    power = np.where(t > 27.0, 400.0, 1.0)
    wave = _sharpened(t, turns, 1.0, np.arange(len(t)), series * power, power)
    first = t < 1.0
    shift = np.angle(np.mean(np.exp(2j * np.pi * (wave[first] - turns[first] + 0.5)))) / 2.0 / np.pi
    assert abs(shift + 0.06) < 0.02
