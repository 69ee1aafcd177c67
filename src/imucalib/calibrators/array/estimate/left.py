"""What a calibrated array leaves unexplained, in the terms of who uses it: mm, mg and deg/s.

Whether positions are the same in all parts of the motion, as a rigid board's are.

Each sample pulls the answer by its score. In a part of the motion these pulls add up by chance, or
by what the part has of its own: a board that bows as it warms up, chips that tilt with the rate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.outcome import Left
from imucalib.calibrators.array.estimate.covariance import POSITIONS, Uneven
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.loop.cross_fit import NORMAL_MAD
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.moving import Moving
from imucalib.calibrators.array.rests import RestFit
from imucalib.estimators.array.sampler import ArrayPositions
from imucalib.units import DEG, MG

#: Times the others' noise or residual from which an IMU stands out.
NOISY = 2.0


@dataclass(frozen=True)
class Accepted:
    """What a user lets pass unexplained: mm of a position, mg and deg/s of a residual in motion
    beyond the noise at rest."""

    mm: float = 0.05
    mg: float = 50.0
    deg_per_s: float = 2.0


@dataclass(frozen=True)
class Residual:
    """1.4826 times the median absolute deviation in motion: acceleration (m/s²), rate (rad/s);
    held_out : whether of motion that took no part in any choice; each : (K,) of each of
    the `imus`, of the fit, where there is one"""

    acceleration: float
    rate: float
    held_out: bool
    each: tuple[Array, Array] | None = None
    imus: tuple[str, ...] = ()


def residual_in_motion(
    loop: MotionLoop | None, state: ArrayState | None, final: ArrayPositions, moving: Moving
) -> Residual:
    """Held out where there is such motion; else of the fit; else of the sampler and the gyros."""
    each = None if state is None else residual_of_each(state)
    imus = () if state is None else state.setup.imus
    if loop is not None and loop.gained is not None:
        after = loop.gained.after
        return Residual(
            NORMAL_MAD * after.acceleration, NORMAL_MAD * after.rate * DEG, True, each, imus
        )
    if state is not None:
        force, rate = (float(NORMAL_MAD * np.median(np.abs(off))) for off in _whole(state))
        return Residual(force, rate, False, each, imus)
    scatter = float(np.median(moving.gyros.scatter[moving.good]))
    return Residual(final.noise, scatter, False)


def residual_of_each(state: ArrayState) -> tuple[Array, Array]:
    """(K,) m/s² and rad/s: 1.4826 times the median absolute deviation of each IMU in motion."""
    one, two = (
        NORMAL_MAD * np.median(np.abs(off.swapaxes(0, 1).reshape(off.shape[1], -1)), axis=1)
        for off in _whole(state)
    )
    return np.asarray(one), np.asarray(two)


def _whole(state: ArrayState) -> tuple[Array, Array]:
    """(n, K, 3) m/s² and rad/s: residuals, each over the share of its variance that the motion
    leaves it."""
    inner, off, kept = state.setup.inner, state.sampled.off, state.sampled.kept
    one, two = (
        values[inner] / np.sqrt(share.share[inner])[..., None]
        for values, share in zip((off.acceleration, off.rate), kept, strict=True)
    )
    return one, two


def what_is_left(
    residual: Residual,
    rests: RestFit,
    loop: MotionLoop | None,
    accepted: Accepted,
    apart: Uneven | None = None,
) -> tuple[Left, ...]:
    """Residuals beyond the noise at rest, those of an IMU that stands out by itself, and how far
    structure that is not explained would move the positions; apart : how far parts of the motion
    do, where nothing was searched."""
    noise = (float(np.sqrt(np.mean(v**2))) for v in (rests.noise, rests.gyro_noise))
    values = (residual.acceleration / MG, residual.rate / DEG)
    beyond = [
        _beyond(value, own / unit)
        for value, own, unit in zip(values, noise, (MG, DEG), strict=True)
    ]
    found = (
        Left("accelerometers in motion", beyond[0], accepted.mg, "mg"),
        Left("gyros in motion", beyond[1], accepted.deg_per_s, "deg/s"),
        *_single(residual, rests, accepted),
    )
    if loop is None:
        return found if apart is None else (_uneven(apart, accepted), *found)
    moved = list(loop.moved.values())
    if loop.suspected:
        # What is corrected and not proved could as well not be.
        moved.append(float(np.sqrt(np.mean((loop.final.r - loop.base.r)[1:] ** 2))))
    return (Left("positions", 1e3 * max(moved, default=0.0), accepted.mm, "mm"), *found)


def _uneven(apart: Uneven, accepted: Accepted) -> Left:
    moved = 1e3 * float(apart.spread.max())
    return Left(POSITIONS + apart.driver, moved, accepted.mm, "mm")


def _beyond(value: float, noise: float) -> float:
    return float(np.sqrt(max(value**2 - noise**2, 0.0)))


def _single(residual: Residual, rests: RestFit, accepted: Accepted) -> Iterator[Left]:
    """IMUs whose residual is more than is accepted and stands out from the others': one of many
    moves no median. What they leave is held against the others' noise at rest, for noise of its own
    is no less left for being there at rest too."""
    if residual.each is None:
        return
    for sensor, off, still, unit, limit, name in (
        ("accelerometer", residual.each[0], rests.noise, MG, accepted.mg, "mg"),
        ("gyro", residual.each[1], rests.gyro_noise, DEG, accepted.deg_per_s, "deg/s"),
    ):
        for k, imu in enumerate(residual.imus):
            if off[k] < NOISY * float(np.median(np.delete(off, k))):
                continue
            one = _beyond(off[k] / unit, float(np.median(np.delete(still, k))) / unit)
            if one > limit:
                yield Left(f"{sensor} of {imu} in motion", one, limit, name)


def left_in_words(loop: MotionLoop | None, left: tuple[Left, ...]) -> tuple[str, ...]:
    """Why the result is not as good as it could be: what exceeds what is accepted, with the
    structure that is behind it; empty where nothing does."""
    if not any(one.beyond for one in left):
        return ()
    found = [f"not explained: {one.sentence}" for one in left if one.beyond]
    if loop is not None and loop.unexplained:
        names = "; ".join(u.name for u in loop.unexplained)
        found.append(f"structure that no effect of the catalogue explains: {names}")
    return tuple(found)
