"""How much of what was found a linear correction of every IMU carries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.motion.state import ArrayState
from imucalib.calibrators.array.motion.terms import Term, board_motion
from imucalib.units import DEG

_SMALL = 1e-6  # share of an effect beyond its linear part from which on it counts


@dataclass(frozen=True)
class LinearPart:
    """What found effects add to a calibrated reading, to first order about rest.

    gain, offset : (K, 3, 3) and (K, 3) of the accelerometers, m/s²: reading = gain force + offset
    gyro_gain, gyro_offset : the same of the gyros, rad/s
    beyond : effects of which more remains, and its rms in this motion, with the unit
    """

    gain: Array
    offset: Array
    gyro_gain: Array
    gyro_offset: Array
    beyond: tuple[tuple[str, float, str], ...]


def linear_part(state: ArrayState) -> LinearPart:
    """The linear part of all found effects, in the middle of the motion."""
    setup, motion, beyond = state.setup, state.motion, []
    gains, offsets = np.tile(np.eye(3), (2, setup.triads, 1, 1)), np.zeros((2, setup.triads, 3))
    for term in state.found:
        gyro = term.effect.channel == "angular_rate"
        gain, offset = slope_at_rest(
            term, setup.imus, setup.board.rotations, float(np.median(setup.t))
        )
        gains[int(gyro)] += gain
        offsets[int(gyro)] += offset
        drive = motion.context.in_common(motion.truth.turning.rate if gyro else motion.truth.force)
        whole = term.reading(term.columns(motion))
        more = whole - np.einsum("kij,tkj->tki", gain, drive) - offset
        rms, of = (float(np.sqrt(np.mean(v**2))) for v in (more, whole))
        if rms > _SMALL * of:
            beyond.append((term.name, rms / DEG if gyro else rms, "deg/s" if gyro else "m/s²"))
    return LinearPart(gains[0], offsets[0], gains[1], offsets[1], tuple(beyond))


def slope_at_rest(
    term: Term, imus: tuple[str, ...], rotations: Array, at: float = 0.0
) -> tuple[Array, Array]:
    """(K, 3, 3) and (K, 3): what a term adds per unit of force or rate, and without any.

    rotations : (K, 3, 3) package axes to board axes; at : s, for effects of time
    """
    h, gyro = 1e-4, term.effect.channel == "angular_rate"
    small = np.zeros((4, 3))
    small[1:] = h * np.eye(3)
    seen = board_motion(
        imus=imus,
        rotations=rotations,
        t=np.full(4, at),
        rate=small if gyro else None,
        force=None if gyro else small,
        age=np.zeros((4, len(imus))),
    )
    made = term.reading(term.columns(seen))
    return np.asarray((made[1:] - made[:1]).transpose(1, 2, 0) / h), np.asarray(made[0])
