"""Size, frame and distances in plain types, for report.json and calibration.yaml."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.estimate.size import GyroScale
from imucalib.calibrators.array.estimate.total import Total
from imucalib.units import DEG


def size_over(drawn: Array, total: Total) -> tuple[float, float, float]:
    """Size over the drawing's (the regression on it): value, sd, and sd of the motion's part."""
    own = (drawn[1:] - drawn[0]).ravel()
    row = own / (own @ own)
    value = float(row @ total.mean[1:].ravel())
    parts = (total.covariance, total.motion)
    whole, motion = (float(np.sqrt(row @ part @ row)) for part in parts)
    return value, whole, motion


def size_block(total: Total, gyros: GyroScale, board: Board) -> dict[str, Any]:
    """What fixes size and frame, and how well; distances from the first IMU hold the size's doubt
    and not the frame's, the shape neither."""
    value, sd, motion = size_over(board.drawn, total)
    away = [total.distance(0, k) for k in range(1, board.count)]
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
            "turns": None if turns is None else {
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
            {"from": board.imus[0], "to": name, "distance": 1e3 * d, "sd": 1e3 * s}
            for name, (d, s) in zip(board.imus[1:], away, strict=True)
        ],
    }  # fmt: skip
