"""What a calibration leaves open in a fused sample: each part against the fit itself, moved by a
little, and against its equation written out."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibrators.array.fused import doubt
from imucalib.calibrators.array.fused.doubt import Doubt, of_the_calibration
from imucalib.calibrators.array.fused.fuse import _seen, _widened
from imucalib.calibrators.array.fused.noise import ChipNoise
from imucalib.calibrators.array.loop.motion import board_motion
from imucalib.calibrators.array.loop.terms import Term
from imucalib.effects import catalogue
from imucalib.estimators.array.fusion import FusedMotion, Sensed, fused_motion

Array = NDArray[np.float64]
K, T = 4, 3
R = np.random.default_rng(1).normal(size=(K, 3)) * 0.02
LATE = np.tile(1e-3 * np.eye(3), (T, K, 1, 1)) * np.arange(1.0, K + 1)[None, :, None, None]


def sensed(late: Array | None = None, spin: bool = False) -> Sensed:
    """Three samples of four chips that agree with a motion of 5 rad/s, but for noise."""
    rng = np.random.default_rng(2)
    rate, turn, force = 5.0 * rng.normal(size=(T, 3)), 40.0 * rng.normal(size=(T, 3)), rng.normal(
        size=(T, 3)) * 9.0  # fmt: skip
    felt = force[:, None] + np.cross(turn[:, None], R)
    felt = felt + np.cross(rate[:, None], np.cross(rate[:, None], R))
    seen = np.repeat(rate[:, None], K, axis=1)
    if late is not None:
        seen = seen + np.einsum("tkij,tj->tki", late, turn)
    root = rng.normal(size=(2, T, K, 3, 3)) * 0.2 + np.eye(3)
    weight = root @ root.swapaxes(-1, -2)
    return Sensed(
        felt + 0.01 * rng.normal(size=felt.shape), seen + 1e-3 * rng.normal(size=seen.shape),
        weight[0] / 0.04**2, weight[1] / 3e-3**2, late,
        turn if spin else None, np.full((T, 3), 0.5) if spin else None,
    )  # fmt: skip


def nine(motion: FusedMotion) -> Array:
    return np.concatenate([motion.force, motion.spin, motion.rate], axis=1)


@pytest.mark.parametrize("late", [None, LATE], ids=["at once", "late"])
def test_a_readings_error_moves_the_motion_as_its_gain_says(late: Array | None) -> None:
    said = sensed(late)
    start = said.rate.mean(axis=1)
    motion = fused_motion(said, R, start)
    gains = dict(zip(("force", "rate"), doubt._gains(motion, said, R), strict=True))
    for name, size in (("force", 1e-4), ("rate", 1e-6)):
        for k in range(K):
            for axis in range(3):
                step = np.zeros((T, K, 3))
                step[:, k, axis] = size
                ends = [
                    nine(fused_motion(replace(said, **{name: getattr(said, name) + s}), R, start))
                    for s in (step, -step)
                ]
                slope = (ends[0] - ends[1]) / (2.0 * size)
                # To first order: what is left of the readings bends it by the residual's share.
                np.testing.assert_allclose(
                    gains[name][:, k, :, axis], slope,
                    atol=0.02 * float(np.abs(slope).max()), rtol=0.05,
                )  # fmt: skip


def test_a_triads_own_error_is_its_gains_times_the_force() -> None:
    """error_i = Σ_j dG_ij f_j + db_i with the file's covariance of the twelve, rows first."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(2, 12, 12))
    covariance, force = root @ root.swapaxes(1, 2), rng.normal(size=(T, 2, 3))
    found = doubt._of_triads(covariance, force)
    for t in range(T):
        for k in range(2):
            slope = np.hstack([np.kron(np.eye(3), force[t, k]), np.eye(3)])
            np.testing.assert_allclose(found[t, k], slope @ covariance[k] @ slope.T)


def motion_of(said: Sensed) -> FusedMotion:
    return fused_motion(said, R, said.rate.mean(axis=1))


@pytest.mark.parametrize("told", [False, True], ids=["alone", "with neighbours"])
def test_gravity_scale_and_frame_move_the_whole(told: bool) -> None:
    """Gravity scales the force, gyros ω, and dω/dt twice where only accelerometers show it, once
    where the neighbours' rates do; a turn of the frame turns all three."""
    said = sensed(spin=told)
    motion = motion_of(said)
    none = Doubt(np.zeros((3 * K, 3 * K)), np.zeros((K, 12, 12)), 0.0, 0.0, np.zeros(3), ())
    share = np.zeros((T, 3))
    if told:
        share = np.einsum("tii->ti", motion.covariance)[:, 3:6] * 0.5
    spin = motion.spin * (2.0 - share)
    zero = np.zeros((T, 3))
    for changed, columns in (
        ({"gravity": 0.1}, [np.hstack([0.1 * motion.force, zero, zero])]),
        ({"scale": 0.2}, [np.hstack([zero, 0.2 * spin, 0.2 * motion.rate])]),
        ({"frame": np.array([0.1, 0.2, 0.3])}, [
            np.hstack([size * np.cross(np.eye(3)[a], v) for v in
                       (motion.force, motion.spin, motion.rate)])
            for a, size in enumerate((0.1, 0.2, 0.3))
        ]),
    ):  # fmt: skip
        found = doubt._of_the_whole(replace(none, **changed), motion, said)  # type: ignore[arg-type]
        np.testing.assert_allclose(found, sum(np.einsum("ti,tj->tij", c, c) for c in columns),
                                   atol=1e-12)  # fmt: skip
    assert 0.0 < share.max() < 1.0 or not told


def test_the_parts_add_up() -> None:
    """Places by W r, triads by their gains, and an effect of each chip by its columns."""
    said = sensed()
    motion, rng = motion_of(said), np.random.default_rng(4)
    root = rng.normal(size=(K, 12, 12)) * 1e-3
    place = rng.normal(size=(3 * K, 3 * K)) * 1e-4
    names = tuple(f"imu{k}" for k in range(K))
    turns = np.tile(np.eye(3), (K, 1, 1))
    seen = board_motion(
        imus=names, rotations=turns, t=np.arange(float(T)), order=np.full(T, 0.5),
        rate=motion.rate, spin=motion.spin, force=motion.felt(R), jerk=np.zeros((T, K, 3)),
    )  # fmt: skip
    effect = catalogue()["gyro_g_sensitivity"]
    count = len(effect.each) * (1 if effect.shared else K)  # type: ignore[union-attr]
    term = Term("one", effect, None, np.eye(count), np.ones(count), np.ones(count))  # type: ignore[arg-type]
    by_effect = rng.normal(size=(count, 2)) * 1e-3
    whole = Doubt(place @ place.T, root @ root.swapaxes(1, 2), 1e-3, 0.0, np.zeros(3),
                  ((term, by_effect),))  # fmt: skip
    found = of_the_calibration(whole, motion, said, R, seen)

    force, rate = doubt._gains(motion, said, R)
    skew = np.array([[np.cross(v, e) for e in np.eye(3)] for v in motion.spin]).swapaxes(1, 2)
    out = motion.rate[:, :, None] * motion.rate[:, None]
    trace = np.sum(motion.rate**2, axis=1)[:, None, None] * np.eye(3)
    turning = out - trace + skew
    columns = term.columns(seen)
    for t in range(T):
        across = np.hstack([force[t, k] @ turning[t] for k in range(K)])
        due = across @ whole.places @ across.T
        own = doubt._of_triads(whole.triads, motion.felt(R))[t]
        due = due + sum(force[t, k] @ own[k] @ force[t, k].T for k in range(K))
        gravity = np.concatenate([1e-3 * motion.force[t], np.zeros(6)])
        due = due + np.outer(gravity, gravity)
        for draw in by_effect.T:
            made = columns.at(draw)[t]
            moved = np.sum([rate[t, k] @ made[k] for k in range(K)], axis=0)
            due = due + np.outer(moved, moved)
        np.testing.assert_allclose(found[t], due, rtol=1e-9, atol=1e-15)


def test_tails_widen_what_stands_on_them() -> None:
    """Force and dω/dt on the accelerometers' ν, ω on the gyros'."""
    motion = motion_of(sensed())
    noise = [ChipNoise(np.ones((K, 3)), np.zeros(K), nu) for nu in (4.0, np.inf)]
    found = _widened(motion, (noise[0], noise[1])).covariance
    wide = np.array([(4.0 + 5.0) / (4.0 + 3.0)] * 6 + [1.0] * 3)
    np.testing.assert_allclose(found, motion.covariance * np.sqrt(np.outer(wide, wide)))


def test_the_jerk_is_that_of_neighbours_in_time() -> None:
    """(f(t + Δt) - f(t - Δt)) / 2Δt at every place; none at the ends and beside a gap."""
    t = np.arange(12) * 0.01
    t[6:] += 0.02
    force = np.sin(7.0 * t)[:, None] * np.ones(3)
    motion = FusedMotion(force, np.zeros((12, 3)), np.zeros((12, 3)), np.zeros((12, 9, 9)))
    made = SimpleNamespace(
        r=R, imus=tuple(f"imu{k}" for k in range(K)),
        beyond=SimpleNamespace(rotations=np.tile(np.eye(3), (K, 1, 1)), needs_jerk=True),
    )  # fmt: skip
    jerk = _seen(made, t, motion).truth.turning.jerk  # type: ignore[arg-type]
    due = np.zeros(12)
    due[1:-1] = (force[2:, 0] - force[:-2, 0]) / (t[2:] - t[:-2])
    due[[5, 6]] = 0.0
    np.testing.assert_allclose(jerk, np.broadcast_to(due[:, None, None], (12, K, 3)))
    made.beyond.needs_jerk = False
    assert not _seen(made, t, motion).truth.turning.jerk.any()  # type: ignore[arg-type]


def test_what_size_and_frame_have_put_into_positions_is_not_counted_twice() -> None:
    rng = np.random.default_rng(5)
    places, turn, size = rng.normal(size=(3, 3)), np.array([0.1, 0.2, 0.3]), 0.05
    root = rng.normal(size=(9, 9)) * 0.01
    own = root @ root.T
    whole = own + size**2 * np.outer(places.ravel(), places.ravel())
    for axis, sd in zip(np.eye(3), turn, strict=True):
        moved = sd * np.cross(axis, places).ravel()
        whole = whole + np.outer(moved, moved)
    np.testing.assert_allclose(doubt._by_motion(whole, places, size, turn), own, atol=1e-12)
