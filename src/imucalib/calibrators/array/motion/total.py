"""All of what positions are uncertain by: the motion, the size, the frame, and gravity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.board.board import Board
from imucalib.calibrators.array.board.turns import GyroScale
from imucalib.calibrators.array.motion.posterior import size_over
from imucalib.core.effect import cross_matrix
from imucalib.units import DEG

_ROUNDS = 3  # of the linearisation of a distance


@dataclass(frozen=True)
class Distance:
    """A distance between two IMUs' accelerometers that was measured otherwise: m."""

    one: int
    two: int
    value: float
    sd: float


@dataclass(frozen=True)
class Total:
    """Positions with everything that is not known of them.

    mean : (K, 3) m, the first at zero; joint : (d + 5, d + 5) of the d = 3 (K - 1) other positions
    by the motion, the relative size by the gyros' common scale and by gravity, and the frame's
    small turns (rad) about the board's axes
    by_motion : (K, 3) m and motion : (d, d) m², what log and rests alone say and leave
    """

    mean: Array
    joint: Array
    by_motion: Array
    motion: Array

    @property
    def covariance(self) -> Array:
        """(d, d) m² of the positions."""
        spread = _spread(self.mean)
        return np.asarray(spread @ self.joint @ spread.T)

    @property
    def sd(self) -> Array:
        """(K, 3) m."""
        own = np.sqrt(np.diag(self.covariance)).reshape(-1, 3)
        return np.concatenate([np.zeros((1, 3)), own])

    @property
    def size_sd(self) -> float:
        """Relative sd of the size beyond what the motion says of it."""
        return float(np.sqrt(self.joint[-5:-3, -5:-3].sum()))

    @property
    def gravity_sd(self) -> float:
        return float(np.sqrt(self.joint[-4, -4]))

    @property
    def frame_sd(self) -> Array:
        """(3,) rad about the board's axes."""
        return np.asarray(np.sqrt(np.diag(self.joint)[-3:]))

    @property
    def shape(self) -> Array:
        """(d, d) m² of what no turn of the board and no scale changes."""
        q, values, _ = np.linalg.svd(_spread(self.mean)[:, -4:], full_matrices=False)
        q = q[:, values > 1e-9 * values[0]]
        keep = np.eye(len(q)) - q @ q.T
        return np.asarray(keep @ self.covariance @ keep.T)

    def distance(self, one: int, two: int) -> tuple[float, float]:
        """Between two IMUs, with its sd: m."""
        value, slope = _apart(self.mean, one, two)
        return value, float(np.sqrt(slope @ self.covariance @ slope))


def total_of(
    r: Array,
    motion: Array,
    *,
    gyros: GyroScale,
    gravity_sd: float,
    frame_sd: float,
    distances: Sequence[Distance] = (),
) -> Total:
    """Positions r (K, 3) m of the motion with covariance (d, d) m², put right by all the rest.

    gravity_sd : relative; frame_sd : rad, of the triads' mean axes against the board's; distances :
    what fixes the size otherwise
    """
    d, factor = len(motion), (1.0 + gyros.value) ** 2
    joint = np.zeros((d + 5, d + 5))
    joint[:d, :d] = factor**2 * motion
    more = np.array([2.0 * gyros.sd, gravity_sd, frame_sd, frame_sd, frame_sd])
    joint[range(d, d + 5), range(d, d + 5)] = more**2
    found = Total(factor * r, joint, r, motion)
    for one in distances:
        found = _measure(found, one)
    return found


def _measure(found: Total, seen: Distance) -> Total:
    """The best estimate with one distance more, by the iterated extended Kalman update."""
    start, joint = found.mean[1:].ravel(), found.joint
    spread, mean = _spread(found.mean), found.mean
    for _ in range(_ROUNDS):
        value, slope = _apart(mean, seen.one, seen.two)
        row = slope @ spread
        gain = joint @ row / (row @ joint @ row + seen.sd**2)
        moved = spread @ gain * (seen.value - value - slope @ (start - mean[1:].ravel()))
        mean = np.concatenate([np.zeros((1, 3)), (start + moved).reshape(-1, 3)])
    return replace(found, mean=mean, joint=joint - np.outer(gain, row @ joint))


def _spread(mean: Array) -> Array:
    """(d, d + 5) the positions per unit of all that is uncertain."""
    own = mean[1:].ravel()
    turns = (cross_matrix(np.eye(3)) @ mean[1:, None, :, None])[..., 0]  # (K - 1, 3 axes, 3)
    about = turns.transpose(0, 2, 1).reshape(-1, 3)
    return np.concatenate([np.eye(len(own)), own[:, None], own[:, None], about], axis=1)


def _apart(mean: Array, one: int, two: int) -> tuple[float, Array]:
    """A distance (m) and its derivative (d,) by the free positions."""
    away = mean[two] - mean[one]
    value = float(np.linalg.norm(away))
    slope = np.zeros_like(mean)
    slope[two] += away / value
    slope[one] -= away / value
    return value, slope[1:].ravel()


def size_block(total: Total, gyros: GyroScale, board: Board) -> dict[str, Any]:
    """What fixes size and frame, and how well; distances from the first IMU hold the size's doubt
    and not the frame's, the shape neither."""
    value, sd = size_over(board.drawn, total.mean, total.covariance)
    motion = size_over(board.drawn, total.mean, total.motion)[1]
    turns = gyros.turns
    return {
        "size": {
            "relative_to_drawing": value,
            "sd": sd,
            "sd_of_motion": motion,
            "sd_beyond_motion": total.size_sd,
            "sd_of_gravity": total.gravity_sd,
        },
        "gyro_scale": {
            "common_error": gyros.value,
            "sd": gyros.sd,
            "sd_by_data_sheet": gyros.tolerance,
            "turns": turns
            and {
                "common_error": turns.scale,
                "sd": turns.sd,
                "count": turns.count,
                "misfit_deg": turns.misfit / DEG,
            },
        },
        "frame": {
            "sd_deg": (total.frame_sd / DEG).tolist(),
            "shape_sd_mm": float(1e3 * np.sqrt(np.median(np.diag(total.shape)))),
        },
        "distances_mm": [
            {"from": board.imus[0], "to": name, "distance": 1e3 * value, "sd": 1e3 * sd}
            for k, name in enumerate(board.imus[1:], start=1)
            for value, sd in [total.distance(0, k)]
        ],
    }
