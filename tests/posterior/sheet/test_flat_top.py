"""Saturation before the noise: rows that stop at one height while their position asks for more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.posterior.sheet.converter import find_cut_offs, flat_tops, rows_of

GOLDENS = Path(__file__).parents[2] / "goldens"


def positions(rng: np.random.Generator, n: int) -> Array:
    f = rng.standard_normal((n, 3))
    return 1000.0 * f / np.linalg.norm(f, axis=1, keepdims=True)


def sensed(rng: np.random.Generator, truth: Array) -> Array:
    """mg of an ordinary sensor before its end, without noise."""
    map_ = np.eye(3) + np.diag(0.01 * rng.standard_normal(3))
    map_ += 0.005 * np.tril(rng.standard_normal((3, 3)), -1)
    return truth @ map_.T + 20.0 * rng.standard_normal(3)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_rows_that_stop_at_a_height_are_told_and_no_others(seed: int, known: bool) -> None:
    """No reading repeats: noise lies on what saturated. An end counts from a row that is 20 mg
    short."""
    rng = np.random.default_rng(seed)
    truth = positions(rng, 90)
    free = sensed(rng, truth)
    reading = np.clip(free, -900.0, 900.0) + rng.normal(0.0, 0.5, free.shape)
    assert not find_cut_offs(reading, truth if known else None)
    ends = flat_tops(reading, truth if known else None)
    beyond = np.flatnonzero((np.abs(free) > 922.0).any(axis=1))
    at = np.flatnonzero((np.abs(free) > 888.0).any(axis=1))
    assert set(beyond) <= set(rows_of(ends)) <= set(at)
    assert all(abs(abs(end.value) - 900.0) < 9.0 for end in ends)


@pytest.mark.parametrize("known", [True, False])
def test_a_sensor_with_room_to_spare_has_no_end(known: bool) -> None:
    """Neither its curvature nor two exchanged rows, nor a grid of positions, are one."""
    rng = np.random.default_rng(7)
    for k in range(60):
        truth = positions(rng, int(rng.integers(14, 120)))
        if k % 3 == 0:
            truth = 500.0 * np.round(truth / 500.0)
            truth = truth[np.linalg.norm(truth, axis=1) > 400.0]
            truth *= 1000.0 / np.linalg.norm(truth, axis=1, keepdims=True)
        reading = sensed(rng, truth) + 8.0 * (truth / 1000.0) ** 3
        reading += rng.choice([0.5, 3.0]) * rng.standard_normal(truth.shape)
        if k % 5 == 0:
            pair = rng.integers(0, len(truth), 2)
            reading[pair] = reading[pair[::-1]]
        assert not flat_tops(reading, truth if known else None)


def test_too_few_rows_away_from_the_ends_tell_nothing() -> None:
    rng = np.random.default_rng(1)
    truth = np.vstack([np.eye(3), -np.eye(3)]).repeat(3, axis=0) * 1000.0
    reading = np.clip(truth, -900.0, 900.0) + rng.normal(0.0, 0.5, truth.shape)
    assert not flat_tops(reading, truth)
    assert not flat_tops(reading)


def test_faces_of_a_box_are_no_flat_top() -> None:
    """Rests of a box on its faces end at gravity; the few rows elsewhere left open by how much (11
    of these 44 were saturated, for certain)."""
    reading = np.loadtxt(GOLDENS / "xsens_rests.csv", delimiter=",", skiprows=3)
    assert flat_tops(reading) == ()
