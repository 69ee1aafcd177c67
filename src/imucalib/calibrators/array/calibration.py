"""The calibration of an array: positions with their covariance, and every IMU's linear correction.

The positions are its parameters. Found effects with their values, and what of them no linear
correction carries, stand beside it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.calibration.outcome import Outcome
from imucalib.calibration.triads import Triad
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.findings import LinearPart, effect_blocks, noise_block
from imucalib.calibrators.array.found import ArrayLoop
from imucalib.calibrators.array.moving import Moving
from imucalib.calibrators.array.static import StaticFit
from imucalib.estimators.array.sampler import ArrayPositions

#: Blocks of report.json that the YAML has, too.
_SHARED = ("board", "reference", "positions_mm", "size", "accelerometer_sigma_in_motion_m_per_s2",
           "effects", "not_undone", "diagnostics")  # fmt: skip


def array_calibration(
    outcome: Outcome,
    details: Mapping[str, Any],
    *,
    static: StaticFit,
    moving: Moving,
    final: ArrayPositions,
    board: Board,
    linear: LinearPart | None,
) -> Calibration:
    """The calibration of a log."""
    mean, sd = 1e3 * final.mean, 1e3 * final.sd
    covariance = 1e6 * final.covariance
    # Standard deviations are the covariance's, to the last bit.
    sd[1:] = np.sqrt(np.diag(covariance)).reshape(-1, 3)
    parameters = tuple(
        StoredParameter(
            f"{imu}.{axis}", "positions", "array", float(mean[k, i]), float(sd[k, i]), "mm"
        )
        for k, imu in enumerate(board.imus)
        if k
        for i, axis in enumerate("xyz")
    )
    facts = {name: details[name] for name in _SHARED if name in details}
    settings = outcome.provenance.settings
    return Calibration(
        calibrator="array",
        parameters=parameters,
        covariance=covariance,
        raw_unit="m/s2",
        raw_to_si=1.0,
        gravity=static.gravity,
        status=outcome.status,
        reasons=outcome.reasons,
        facts={
            "gravity_source": settings["gravity_source"],
            "errors": [error.as_dict() for error in outcome.errors],
            **facts,
            "provenance": outcome.provenance.as_dict(),
        },
        triads=_triads(static, moving, board, linear),
    )


def _triads(
    static: StaticFit, moving: Moving, board: Board, found: LinearPart | None
) -> tuple[Triad, ...]:
    """Each IMU as the rests and the found effects' linear parts have it."""
    gain, bias = static.gain, static.bias[0]
    gyro_gain, gyro_bias = moving.gyros.gain, static.gyro_bias[0]
    if found is not None:
        bias = bias + np.einsum("kij,kj->ki", gain, found.offset)
        gain = gain @ found.gain
        gyro_gain, gyro_bias = found.gyro_gain, gyro_bias + found.gyro_offset
    return tuple(
        Triad(
            name=name,
            rotation=board.rotations[k],
            gain=gain[k],
            bias=bias[k],
            gyro_gain=gyro_gain[k],
            gyro_bias=gyro_bias[k],
            covariance=static.covariance[k, :, k, :],
            noise=float(static.noise[k]),
            gyro_noise=float(static.gyro_noise[k]),
        )
        for k, name in enumerate(board.imus)
    )


def array_details(
    static: StaticFit,
    moving: Moving,
    final: ArrayPositions,
    board: Board,
    loop: ArrayLoop | None,
    linear: LinearPart | None,
) -> dict[str, Any]:
    """What only an array has to say, for report.json; a part of it also for the YAML."""
    mean, sd, drawn = ((1e3 * v).tolist() for v in (final.mean, final.sd, board.drawn))
    scale, scale_sd = final.scale
    details: dict[str, Any] = {
        "board": board.name,
        "reference": board.imus[0],
        "positions_mm": [
            {
                "imu": name,
                "mean": mean[k],
                "sd": sd[k],
                "drawn": drawn[k],
            }
            for k, name in enumerate(board.imus)
        ],
        "size": {
            "relative_to_drawing": scale,
            "sd": scale_sd,
            "sd_from_gyro_tolerance": moving.gyros.scale_sd,
        },
        "accelerometer_sigma_in_motion_m_per_s2": final.noise,
        "diagnostics": _diagnostics(final),
        "static": {
            "rests": static.poses,
            "residual_m_per_s2": static.residual,
            "residual_without_drift_m_per_s2": static.before,
            "drift_order": static.order,
        },
        "moving": dict(moving.counts),
        "not_undone": [
            {"effect": name, "rms": rms, "unit": unit}
            for name, rms, unit in (*_drift(static), *(linear.left if linear else ()))
        ],
    }
    if loop is not None:
        details["effects"] = effect_blocks(loop)
        details["noise"] = noise_block(loop)
    return details


def _drift(static: StaticFit) -> Iterator[tuple[str, float, str]]:
    """The rests' warm-up drift, against their end, which is where the biases hold."""
    if static.order:
        at = np.linspace(-1.0, 0.0, 21)[:, None] ** np.arange(1, static.order + 1)
        away = np.einsum("no,oki->nki", at, static.bias[1:])
        yield "warm-up drift of the rests", float(np.sqrt(np.mean(away**2))), "m/s²"


def _diagnostics(final: ArrayPositions) -> dict[str, Any]:
    """What the sampler says of itself."""
    found = final.convergence
    return {
        "sampler": final.sampler,
        "chains": final.unknowns.shape[0],
        "draws": final.unknowns.shape[1],
        "acceptance": final.accepted,
        "largest_rhat": float(np.max(found.rhat)),
        "smallest_bulk_ess": float(np.min(found.bulk)),
        "smallest_tail_ess": float(np.min(found.tail)),
        "largest_mcse_mm": float(1e3 * np.max(found.mcse[: final.prior.positions])),
        "samples": final.data.samples,
    }
