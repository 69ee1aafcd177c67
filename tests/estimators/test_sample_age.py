"""Ages of chips that sample on their own clocks, on motions that are formulas."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.estimators.array.sample_age import fit_sample_age

SPAN, RATE = 0.004, 100.0
#: Hz of each gyro's beat, and turns by which it leaves its line, for the third quicker than a block
#: follows; of one that beats less than four times a harmonic is left, and the last has none.
BEATS = ((0.31, 0.06), (-0.47, 0.03), (0.8, 0.9), (0.05, 0.01), (0.02, 0.0), (0.0, 0.0))
#: Waves at every 1,100th sample and frequencies, of the code as it stood when four measured motions
#: were last held out, 2026-11-29.
BORN_WITH = np.array(
    [
        [0.309820732658, -0.469602494154, 0.810600155885, 0.050662509743, 0.216289945440],
        [-0.291695481811, -0.304590432985, -0.171029707744, -0.364890741645, 0.131248575799],
        [0.154480256485, -0.447822606391, 0.096427163778, 0.219593477796, 0.356290405548],
        [-0.424264911765, 0.390984722877, 0.185611286059, -0.224909453126, -0.282976117661],
        [-0.029065196634, 0.215719209522, -0.177481555932, 0.318140267251, -0.009260934931],
        [0.492801690739, -0.266235740831, 0.481095571632, 0.224805145640, 0.141415141240],
        [-0.131175074701, -0.465650536142, -0.422316049689, -0.219206942034, 0.373799155249],
        [0.274271987342, 0.363941253300, 0.216769740401, 0.336307523397, -0.165528936060],
        [-0.299196401575, 0.200139585783, 0.318716414487, -0.103197167669, 0.143982881337],
        [0.153397734042, 0.051583964332, -0.250525973399, 0.448608427027, -0.327317616922],
        [-0.398067188536, -0.097374131986, 0.124750892955, -0.006016085676, -0.016237660112],
        [0.023699543330, -0.257872160632, 0.179144189336, -0.425981806901, 0.329526792915],
        [0.442228200728, -0.442468563565, -0.136172511355, 0.130721726353, -0.253063312992],
    ]
)


def uneven(n: int, seed: float) -> Array:
    """(n, 3) within 1, without a pattern: what a formula has for noise."""
    return np.sin(1e4 * np.sin(seed + np.arange(3.0 * n))).reshape(n, 3)


def motion() -> tuple[Array, Array, Array, np.ndarray]:
    """t (N,), gyros less their mean (N, K, 3), dω/dt (N, 3), true waves (N, K)."""
    kept = np.arange(13000)
    t = kept[(kept < 4000) | (kept >= 4700)] / RATE
    slope = 4.0 * np.stack([np.sin(2.1 * t), np.sin(1.3 * t + 1.0), np.cos(3.7 * t)], axis=1)
    waves, off = np.zeros((len(t), len(BEATS))), np.zeros((len(t), len(BEATS), 3))
    for k, (f, wander) in enumerate(BEATS):
        turns = f * t + 0.2 + wander * np.sin(t / 15.0)
        waves[:, k] = (turns - np.floor(turns) - 0.5) if f else 0.0
        late = SPAN * waves[:, k] + 0.001 * (1.0 + t / 100.0)
        off[:, k] = -late[:, None] * slope + 0.002 * uneven(len(t), k)
    return t, off, slope, waves


def learned(t: Array) -> np.ndarray:
    """Two thirds of the samples, in groups."""
    return np.flatnonzero(np.floor(t / 1.7) % 3 != 0)


def test_each_gyro_has_its_own_beat_and_the_one_without_has_none() -> None:
    t, off, slope, true = motion()
    found = fit_sample_age(t, off, slope, learned(t))
    assert found.frequency[:2] == pytest.approx([f for f, _ in BEATS[:2]], abs=0.005)
    assert np.isnan(found.frequency[5])
    assert not found.wave[:, 5].any()
    away = np.abs(found.wave - true)[:, :2]
    assert np.mean(np.minimum(away, 1.0 - away)) < 0.02
    assert np.abs(found.wave).max() <= 0.5


def test_an_age_rises_and_falls_with_the_clock_that_is_read_against() -> None:
    """The same log backwards: what was born later is read first."""
    t, off, slope, _ = motion()
    rows = learned(t)
    there = fit_sample_age(t, off, slope, rows)
    back = fit_sample_age(t[-1] - t[::-1], off[::-1], slope[::-1], np.sort(len(t) - 1 - rows))
    assert back.frequency[:2] == pytest.approx(-there.frequency[:2], abs=0.005)
    away = np.abs(back.wave[::-1] - there.wave)[:, :2]
    assert np.mean(np.minimum(away, 1.0 - away)) < 0.02


def test_waves_are_those_that_were_held_out() -> None:
    t, off, slope, _ = motion()
    found = fit_sample_age(t, off, slope, learned(t))
    numbers = np.vstack([found.frequency[:5], found.wave[::1100, :5]])
    assert numbers == pytest.approx(BORN_WITH, abs=1e-9)
