"""A board without a drawing, from the log itself: axes that all share, places to a millimetre."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.drawing.axes import common_gyro_axes, relative_axes
from imucalib.calibrators.array.drawing.places import rough_places
from imucalib.calibrators.array.log import ArrayLog
from imucalib.calibrators.array.moving import SLOWEST
from imucalib.errors import Undetermined
from imucalib.rests.segments import Segments

#: m, of each place about the first look: wide enough to say nothing, so that it counts once.
_WIDE = 0.02


def sketched(log: ArrayLog, segments: Segments, board: Board, order: list[int]) -> Board:
    """The board in the axes of its first IMU. log : of the undrawn board, in the packages' axes.

    Raises Undetermined where axes are no signed permutations of each other, or where the motion
    does not show the places.
    """
    turns = board.rotations
    still = segments.mean[:, order]
    usable = (np.median(np.linalg.norm(log.rate, axis=2), axis=1) > SLOWEST) & ~log.clipped
    acceleration = _to_the_first(relative_axes(still, turns))
    offset = segments.rate[:, order].mean(axis=0)
    gyro = _to_the_first(relative_axes((log.rate - offset)[usable], turns))
    force = np.einsum("kij,nkj->nki", acceleration, log.acceleration)
    rate = np.einsum("kij,nkj->nki", gyro, log.rate - offset)
    up = np.einsum("kij,nkj->nki", acceleration, still).mean(axis=1)
    common = common_gyro_axes(log.t, rate.mean(axis=1), up, segments.start, segments.stop)
    gyro = common @ gyro
    seen = rough_places(log.t, force, rate.mean(axis=1) @ common.T, usable)
    if seen is None:
        raise Undetermined(
            "without a drawing the motion must show where the IMUs are about, and it does not",
            remedy="twist the board faster about all axes, or give a board file",
        )
    proper = np.linalg.det(gyro) > 0.0
    rotations = np.where(proper[:, None, None], gyro, acceleration)
    if np.any(np.linalg.det(rotations) < 0.0):
        rotations = np.where(proper[:, None, None], rotations, np.eye(3))
    back = rotations.transpose(0, 2, 1)
    return replace(
        board,
        positions=seen,
        rotations=rotations,
        prior_sd=_WIDE,
        accelerometer_axes=back @ acceleration,
        gyro_axes=back @ gyro,
    )


def _to_the_first(signed: np.ndarray) -> np.ndarray:
    """Axes relative to the first IMU's, which are the board's."""
    return np.asarray(signed[0].T @ signed)
