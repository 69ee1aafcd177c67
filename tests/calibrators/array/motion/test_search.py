"""The array's loop: planted errors are named and undone, a clean log is left alone."""

from __future__ import annotations

import numpy as np
import pytest

from gates.bounds import at_most
from imucalib.calibrators.array.board.board import Board
from imucalib.calibrators.array.motion.closed_loop import MotionLoop
from imucalib.calibrators.array.motion.laws import array_catalogue, find_effect, find_skipped
from imucalib.calibrators.array.motion.terms import BoardMotion, board_motion
from imucalib.calibrators.request import Request
from imucalib.errors import UsageError
from imucalib.estimators.array.samples import Columns, Pair, fit_samples, gram
from worlds.array import corners, skew
from worlds.array_stories import BOARD, STORIES, closed, named, planted_log, positions_z
from worlds.places import ROOT


@pytest.fixture(scope="module")
def clean() -> MotionLoop:
    return closed(planted_log("clean", 5)[0], 150)


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in STORIES if n != "clean"])
def test_a_planted_error_is_named(name: str) -> None:
    recording, true = planted_log(name, 11)
    found = closed(recording, 200)
    assert STORIES[name][0] in named(found), [s.effect for s in found.steps]
    if STORIES[name][0] != "sensing_elements":  # they share directions with the positions
        assert np.sqrt(np.mean(positions_z(found, true) ** 2)) < 1.6
    assert found.gained is not None
    assert found.gained.acceleration.after <= found.gained.acceleration.before * 1.05


def test_a_set_is_searched_from_anew_at_the_noise_that_it_leaves() -> None:
    """While the force is in one gyro's readings that gyro counts as noisy, and a law that is nearly
    the right one is as good."""
    found = closed(planted_log("gyro that feels force, 0.3 deg/s/g", 12)[0], 200)
    assert named(found) == {"gyro_g_sensitivity@imu2"}
    assert not found.unexplained


@pytest.mark.slow
def test_clean_logs_are_left_alone_as_often_as_stated() -> None:
    again = [closed(planted_log("clean", seed)[0], 150) for seed in range(20, 60)]
    assert sum(bool(found.steps) for found in again) <= at_most(40, 0.05).most


def test_the_motion_is_taken_out_exactly() -> None:
    """Gram matrices against columns projected sample by sample by a dense QR."""
    rng = np.random.default_rng(4)
    r = corners(5)
    t, k = 7, 5
    w, spin = rng.normal(size=(t, 3)) * 15.0, rng.normal(size=(t, 3)) * 300.0
    turn = skew(w) @ skew(w) + skew(spin)
    y = np.einsum("tij,kj->tki", turn, r) + rng.normal(size=(t, 1, 3)) * 9.0
    y += rng.normal(size=y.shape) * 0.1
    g = w[:, None] + rng.normal(size=(t, k, 3)) * 0.01
    weights = Pair(rng.uniform(50.0, 150.0, (t, k)), rng.uniform(5e3, 2e4, (t, k)))
    sampled = fit_samples(Pair(y, g), weights, r, w)
    blocks = [
        Columns(rng.normal(size=(k, t, 3, 2)), False, False),
        Columns(rng.normal(size=(k, t, 3, 3)), True, True),
    ]
    found = gram(sampled, blocks, np.arange(t))
    dense = np.zeros((t, 6 * k, 2 * k + 3))
    residual, motion = np.zeros((t, 6 * k)), np.zeros((t, 6 * k, 9))
    for i in range(k):
        a, b = slice(3 * i, 3 * i + 3), slice(3 * (k + i), 3 * (k + i) + 3)
        root = np.sqrt(weights.acceleration[:, i])[:, None], np.sqrt(weights.rate[:, i])[:, None]
        dense[:, a, 2 * i : 2 * i + 2] = blocks[0].basis[i] * root[0][..., None]
        dense[:, b, 2 * k :] = blocks[1].basis[i] * root[1][..., None]
        residual[:, a] = sampled.off.acceleration[:, i] * root[0]
        residual[:, b] = sampled.off.rate[:, i] * root[1]
        motion[:, a] = sampled.arms[:, i] * root[0][..., None]
        motion[:, b, 6:] = np.eye(3) * root[1][..., None]
    q = np.linalg.qr(motion)[0]
    dense -= q @ (q.transpose(0, 2, 1) @ dense)
    residual -= (q @ (q.transpose(0, 2, 1) @ residual[..., None]))[..., 0]
    flat = dense.reshape(-1, dense.shape[2])
    # But for the weak prior of dω/dt, which the dense columns lack.
    assert found.matrix == pytest.approx(flat.T @ flat, rel=1e-7, abs=1e-5)
    assert found.along == pytest.approx(flat.T @ residual.ravel(), rel=1e-6, abs=1e-5)
    assert found.power == pytest.approx(float(np.sum(residual**2)), rel=1e-8)


def _motion(k: int = 3) -> BoardMotion:
    rng = np.random.default_rng(6)
    turns = np.array([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(k)])
    return board_motion(
        Board("", tuple(f"imu{i}" for i in range(k)), np.zeros((k, 3)), turns), np.arange(4.0),
        order=np.linspace(0.0, 1.0, 4), rate=rng.normal(size=(4, 3)),
        spin=rng.normal(size=(4, 3)), force=rng.normal(size=(4, k, 3)),
        jerk=rng.normal(size=(4, k, 3)), age=rng.uniform(-0.5, 0.5, (4, k)),
    )  # fmt: skip


def test_every_array_effect_is_documented() -> None:
    text = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    shown = [n for n, e in array_catalogue().items() if not e.missing(_motion().context)]
    assert len(shown) > 20
    assert not [name for name in shown if f"## {name}\n" not in text]


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("gyro_dela", "no array effect is called"),
        ("gyro_scale@imu99", "has no IMU"),
        ("gyro_delay@imu3", "acts on all IMUs alike"),
    ],
)
def test_names_of_effects_are_checked(name: str, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        find_skipped(Request(only=(name,)), BOARD.imus)
    with pytest.raises(UsageError, match=says):
        find_effect(name, BOARD.imus)
