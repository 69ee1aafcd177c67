"""What a calibrated array leaves unexplained, in the terms of who uses it: mm, mg and deg/s."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.outcome import Left
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.loop.held_out import NORMAL_MAD
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.moving import Moving
from imucalib.calibrators.array.rests import RestFit
from imucalib.estimators.array.sampler import ArrayPositions
from imucalib.units import DEG, MG


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
    held_out : whether of motion that took no part in any choice"""

    acceleration: float
    rate: float
    held_out: bool


def residual_in_motion(
    loop: MotionLoop | None, state: ArrayState | None, final: ArrayPositions, moving: Moving
) -> Residual:
    """Held out where there is such motion; else of the fit; else of the sampler and the gyros."""
    if loop is not None and loop.gained is not None:
        after = loop.gained.after
        return Residual(NORMAL_MAD * after.acceleration, NORMAL_MAD * after.rate * DEG, True)
    if state is not None:
        inner, off, kept = state.setup.inner, state.sampled.off, state.sampled.kept
        return Residual(
            _deviation(off.acceleration, kept[0].share, inner),
            _deviation(off.rate, kept[1].share, inner),
            False,
        )
    rate = float(np.median(moving.gyros.scatter[moving.good]))
    return Residual(final.noise, rate, False)


def _deviation(off: Array, kept: Array, rows: Index) -> float:
    """Of residuals (T, K, 3), each over the share of its variance that the motion leaves it."""
    whole = off[rows] / np.sqrt(kept[rows])[..., None]
    return float(NORMAL_MAD * np.median(np.abs(whole)))


def what_is_left(
    residual: Residual, rests: RestFit, loop: MotionLoop | None, accepted: Accepted
) -> tuple[Left, ...]:
    """Residuals beyond the noise at rest, and how far structure that is not explained would move
    the positions."""
    noise = (float(np.sqrt(np.mean(v**2))) for v in (rests.noise, rests.gyro_noise))
    values = (residual.acceleration / MG, residual.rate / DEG)
    beyond = [
        float(np.sqrt(max(value**2 - (own / unit) ** 2, 0.0)))
        for value, own, unit in zip(values, noise, (MG, DEG), strict=True)
    ]
    found = (
        Left("accelerometers in motion", beyond[0], accepted.mg, "mg"),
        Left("gyros in motion", beyond[1], accepted.deg_per_s, "deg/s"),
    )
    if loop is None:
        return found
    moved = list(loop.moved.values())
    if loop.suspected:
        # What is corrected and not proved could as well not be.
        moved.append(float(np.sqrt(np.mean((loop.final.r - loop.base.r)[1:] ** 2))))
    return (Left("positions", 1e3 * max(moved, default=0.0), accepted.mm, "mm"), *found)


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
