"""Axes that repeat one number: what noise or movement rules out is left out, the rest stays."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.errors import Undetermined
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.runs import PostureRuns, posture_runs, scan
from imucalib.units import MG, STANDARD_GRAVITY

Array = NDArray[np.float64]
G, RATE, REST = STANDARD_GRAVITY, 10.0, 400  # samples


def worn(rests: int, noise: float, step: float) -> Array:
    """(n, 3) m/s²: rests of 40 s in postures of their own, each with a movement of 10 s before;
    noise of a sample and step of the reading in mg."""
    rng = np.random.default_rng(4)
    x = rng.standard_normal((rests, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    g = np.repeat(x, REST + 100, axis=0)
    g += 1e-3 * noise * rng.standard_normal(g.shape)
    moves = np.arange(len(g)) % (REST + 100) < 100
    g[moves] += 0.2 * rng.standard_normal((int(moves.sum()), 3))
    return np.asarray(MG * step * np.round(1e3 * g / step))


def found(values: Array) -> PostureRuns:
    t = np.arange(len(values)) / RATE
    channel = Channel(t, values, "m/s2", "acceleration", "imu0", RATE)
    return posture_runs(scan([Recording({"imu0/acceleration": channel}, "a", "a", "")], 10.0))


@pytest.mark.parametrize("held", [-0.3, 0.0, -0.0])
@pytest.mark.parametrize("noise", [3.0, 0.1], ids=["fine", "coarse"])
def test_an_axis_that_stands_still_while_others_move_is_left_out(noise: float, held: float) -> None:
    values = worn(40, noise, 1.0)
    values[5000:10000, 1] = held * G
    runs = found(values)
    assert not np.any((runs.time > 500.0) & (runs.time < 1000.0))
    assert runs.time.size >= 28
    assert runs.faults == (
        f"y repeats {held + 0.0:.3g} g for 8.3 min from 0.14 h on, while it should move: stuck, or "
        "at a limit; left out of the rests",
    )


def test_an_axis_that_is_held_and_keeps_its_noise_is_left_out() -> None:
    """It stood in the fit, which it took from 0.4 to 33 mg; the others are not blamed for it."""
    values = worn(40, 3.0, 1.0)
    noise = MG * np.round(3.0 * np.random.default_rng(5).standard_normal(5000))
    values[5000:10000, 1] = -0.3 * G + noise
    runs = found(values)
    assert not np.any((runs.time > 500.0) & (runs.time < 1000.0))
    assert runs.time.size >= 28
    assert runs.faults == (
        "y stays at -0.3 g for 8.3 min from 0.14 h on, whatever the others do: it is not its own "
        "reading; left out of the rests",
    )


@pytest.mark.parametrize("noise", [3.0, 0.6, 0.1])
def test_a_live_axis_is_not_stuck(noise: float) -> None:
    runs = found(worn(40, noise, 1.0))
    assert runs.faults == ()
    assert runs.n == 40


@pytest.mark.parametrize("step", [4.0, 16.0])
def test_rests_that_repeat_one_step_are_rests(step: float) -> None:
    """They were frozen, and the quietest motion the noise, which shook: nothing was still."""
    runs = found(worn(60, 0.0, step))
    assert runs.n == 60
    assert runs.faults == runs.notes == ()
    assert np.all(runs.noise < 0.5 * runs.resolution)


def test_a_limit_below_gravity_is_told_with_its_axis() -> None:
    values = worn(60, 3.0, 1.0)
    up = np.minimum(values[:, 0], 0.9 * G)
    values[:, 0] = up
    runs = found(values)
    assert [text.partition(":")[0] for text in runs.faults] == ["x reads nothing above 0.9 g"]
    assert np.all(runs.mean[:, 0] < 0.9 * G)


def test_an_axis_that_never_moves_is_refused() -> None:
    values = worn(20, 3.0, 1.0)
    values[:, 0] = 0.0
    with pytest.raises(Undetermined, match=r"x repeats 0 g for 17 min from 0\.00 h on"):
        found(values)
