"""Axes and places of an array from its motion, and the scale of its gyros from its turns, in plain
numpy: what is read, which side of a limit, and how well it is known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibrators.array.board import undrawn_board
from imucalib.calibrators.array.drawing.check import (
    SIGNED,
    in_words,
    places,
    relative_axes,
    rough_places,
    sketched,
)
from imucalib.calibrators.array.estimate.total import (
    GyroScale,
    frame_sd,
    size_block,
    size_over,
    total_of,
)
from imucalib.calibrators.array.estimate.turns import Turns
from imucalib.calibrators.array.log import at_end, at_range
from worlds.boards import DEG, BoardPlan, handled, twisted

Array = NDArray[np.float64]
PLAN = BoardPlan(rests=10, twist_s=4.0)
PLACES = 0.02 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0.2)])
NAMES = ("a", "b", "c", "d")


@cache
def motion() -> tuple[Array, Array, Array, Array]:
    """Times, ω, dω/dt and the force of the origin: rests and turns, then twisting."""
    rng = np.random.default_rng(3)
    parts = zip(handled(PLAN, rng), twisted(PLAN, rng), strict=True)
    w, spin, force = (np.concatenate(p) for p in parts)
    return np.arange(len(w)) / PLAN.hz, w, spin, force


#: All packages mounted alike.
ALIKE = np.tile(np.eye(3), (4, 1, 1))


def felt() -> Array:
    _, w, spin, force = motion()
    out = np.cross(w[:, None], np.cross(w[:, None], PLACES)) + np.cross(spin[:, None], PLACES)
    return force[:, None] + out


def rests() -> tuple[Array, Array]:
    start = np.arange(PLAN.rests) * (PLAN.rest_s + PLAN.turn_s)
    return start, start + PLAN.rest_s - 1.0 / PLAN.hz


def seen(acceleration: Array, gyro: Array, noise: float = 0.02) -> tuple[object, object]:
    """The log and its rests, with every IMU's axes S of its readings: read = Sᵀ truth, biases of
    gyros beside."""
    t, w, _, _ = motion()
    rng = np.random.default_rng(5)
    read = np.einsum("kji,tkj->tki", acceleration, felt()) + noise * rng.normal(size=(len(t), 4, 3))
    bias = np.radians([[1.0, -2.0, 0.5]] * 4)
    rate = np.einsum("kji,tj->tki", gyro, w) + bias + 1e-3 * rng.normal(size=read.shape)
    start, stop = rests()
    at = [
        slice(round(a * PLAN.hz), round(b * PLAN.hz) + 1) for a, b in zip(start, stop, strict=True)
    ]
    segments = SimpleNamespace(
        mean=np.array([read[s].mean(axis=0) for s in at]),
        rate=np.array([rate[s].mean(axis=0) for s in at]), start=start, stop=stop, n=len(start),
    )  # fmt: skip
    log = SimpleNamespace(t=t, acceleration=read, rate=rate, clipped=np.zeros(len(t), bool))
    return log, segments


def test_a_board_without_a_drawing_is_sketched_in_the_axes_of_its_first() -> None:
    """Each IMU in any of the 24 proper signed permutations; places to a millimetre."""
    proper = SIGNED[np.linalg.det(SIGNED) > 0.0]
    own = np.stack([np.eye(3), *proper[[3, 11, 20]]])
    log, segments = seen(own, own)
    board = sketched(log, segments, undrawn_board(4), [0, 1, 2, 3])  # type: ignore[arg-type]
    np.testing.assert_array_equal(board.rotations, own)
    assert np.abs(board.positions - (PLACES - PLACES.mean(axis=0))).max() < 1e-3
    np.testing.assert_array_equal(board.accelerometer_axes, np.tile(np.eye(3), (4, 1, 1)))
    assert board.prior_sd == 0.02


def test_axes_are_told_where_the_others_agree() -> None:
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(30, 3))
    own = SIGNED[[0, 0, 17, 0]]
    read = np.einsum("kji,nj->nki", own, truth)
    same = np.tile(np.eye(3), (4, 1, 1))
    found = relative_axes(read + 0.05 * rng.normal(size=read.shape), same)
    np.testing.assert_array_equal(found, own)
    wild = relative_axes(read + 2.0 * rng.normal(size=read.shape), same)
    np.testing.assert_array_equal(wild[2], np.eye(3))
    assert in_words(SIGNED[0]) == "x,y,z"
    assert in_words(np.array([[0.0, -1, 0], [0, 0, 1], [1, 0, 0]])) == "-y,z,x"


def test_places_are_seen_by_the_forces_differences() -> None:
    t, w, _, _ = motion()
    fast = np.linalg.norm(w, axis=1) > 60.0 * DEG
    found = rough_places(t, felt() + np.array([0.1, 0.0, 0.0]), w, fast)
    assert found is not None
    assert np.abs(found - (PLACES - PLACES.mean(axis=0))).max() < 2e-4
    rows = np.flatnonzero(fast)
    few = np.zeros_like(fast)
    few[rows[:40]] = True
    assert rough_places(t, felt(), w, few) is None
    noise = np.random.default_rng(0).normal(size=felt().shape)
    assert rough_places(t, felt() + 300.0 * noise, w, fast) is None
    swapped = places(t, felt()[:, [0, 2, 1, 3]], w, fast, drawn=PLACES, mounted=ALIKE)
    assert swapped is not None
    assert swapped.place.tolist() == [0, 2, 1, 3]
    assert swapped.exchanged.tolist() == [1, 2]
    assert not swapped.other_unit


def test_the_frame_is_known_by_how_the_packages_turns_scatter() -> None:
    """Root mean square about their mean with a belief of 0.3 deg worth one number, over √K."""
    rng = np.random.default_rng(0)
    angles = 0.01 * rng.normal(size=(5, 3)) + 0.5
    x, y, z = angles.T
    zero = np.zeros(5)
    skew = np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1),
                     np.stack([-y, x, zero], -1)], 1)  # fmt: skip
    made = SimpleNamespace(in_board_axes=lambda: (np.eye(3) + skew, None, None))
    square = np.sum((angles - angles.mean(axis=0)) ** 2) + (0.3 * DEG) ** 2
    assert frame_sd(made) == pytest.approx(np.sqrt(square / 13.0 / 5.0))  # type: ignore[arg-type]


def test_the_size_is_the_regression_on_the_drawing() -> None:
    root = np.random.default_rng(1).normal(size=(9, 9)) * 1e-5
    total = total_of(1.01 * PLACES, root @ root.T, scale=0.0, scale_sd=2e-3, gravity_sd=1e-3,
                     frame_sd=2e-3)  # fmt: skip
    own = PLACES[1:].ravel()
    value, sd, motion_sd = size_over(PLACES + 5.0, total)
    row = own / np.sum(own**2)
    assert value == pytest.approx(1.01)
    assert sd == pytest.approx(np.sqrt(row @ total.covariance @ row))
    assert motion_sd == pytest.approx(np.sqrt(row @ root @ root.T @ row))
    board = replace(undrawn_board(4), imus=NAMES, positions=PLACES)
    turns = Turns(0.01, 0.001, 9, 0.02, 1.0)
    block = size_block(total, GyroScale(0.008, 0.0009, 0.002, turns), board)
    assert [row["from"] + row["to"] for row in block["distances_mm"]] == ["ab", "ac", "ad"]
    assert block["distances_mm"][0]["distance"] == pytest.approx(20.2)
    assert block["distances_mm"][2]["sd"] == pytest.approx(1e3 * total.distance(0, 3)[1])
    assert block["frame"]["sd_deg"] == pytest.approx([2e-3 / DEG] * 3)
    assert block["frame"]["shape_sd_mm"] == pytest.approx(
        1e3 * np.sqrt(np.median(np.diag(total.shape))))  # fmt: skip
    assert block["gyro_scale"]["turns"]["misfit_deg"] == pytest.approx(0.02 / DEG)


def test_clipping_is_at_the_range_or_where_an_end_repeats() -> None:
    values = np.array([[0.0, 99.9, 0.0], [0.0, 99.7, 0.0], [-99.8, 0.0, 0.0]])
    assert at_range(values, 100.0).tolist() == [True, False, True]
    rng = np.random.default_rng(0)
    noisy = rng.normal(size=(200, 3))
    top = np.sort(np.abs(noisy[:, 0]))[::-1]
    held = noisy.copy()
    held[:, 0] = np.clip(held[:, 0], None, 3.5 * np.median(np.abs(noisy[:, 0])))
    held[:6, 0] = 4.0 * top[0]
    assert np.flatnonzero(at_end(held)).tolist() == list(range(6))
    held[4:6, 0] = 0.0
    assert not at_end(held).any()
