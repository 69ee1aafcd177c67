"""The calibration of an array: positions with their covariance, and every IMU's linear correction.

The positions are its parameters. Found effects with their values, and what of them no linear
correction carries, stand beside it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.calibration.outcome import Outcome
from imucalib.calibration.triads import DRIFT, Triad, drift_block
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.effect_blocks import effect_blocks, rest_blocks
from imucalib.calibrators.array.estimate.left import Residual
from imucalib.calibrators.array.estimate.total import GyroScale, Total, size_block
from imucalib.calibrators.array.findings import noise_block
from imucalib.calibrators.array.linear_part import LinearPart
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.moving import Moving
from imucalib.calibrators.array.rests import RestFit
from imucalib.estimators.array.sampler import ArrayPositions
from imucalib.units import DEG, STANDARD_GRAVITY

#: Blocks of report.json that the YAML has, too.
_SHARED = (
    "board",
    "reference",
    "reference_mm",
    "ranges",
    "sample_interval_s",
    "positions_mm",
    "size",
    "gyro_scale",
    "frame",
    "rests",
    "residual_in_motion",
    "effects",
    "not_undone",
    "diagnostics",
)


def array_calibration(
    outcome: Outcome,
    details: Mapping[str, Any],
    *,
    rests: RestFit,
    moving: Moving,
    total: Total,
    gyros: GyroScale,
    board: Board,
    linear: LinearPart | None,
    channels: Mapping[str, str],
) -> Calibration:
    """The calibration of a log. channels : IMU -> what the recording calls it."""
    return of_positions(
        outcome,
        total,
        board.imus,
        gravity=rests.gravity,
        facts={name: details[name] for name in _SHARED if name in details},
        triads=tuple(
            replace(triad, channel=channels.get(triad.name, ""))
            for triad in _triads(rests, moving, board, linear, 1.0 + gyros.value)
        ),
    )


def of_positions(
    outcome: Outcome,
    total: Total,
    imus: Sequence[str],
    *,
    gravity: float,
    facts: Mapping[str, Any],
    triads: tuple[Triad, ...],
) -> Calibration:
    """The calibration of one log or of several: places of all IMUs but the first are its
    parameters."""
    covariance = 1e6 * total.covariance
    # Standard deviations are the covariance's, to the last bit.
    sd = np.sqrt(np.diag(covariance))
    names = [f"{imu}.{axis}" for imu in imus[1:] for axis in "xyz"]
    return Calibration(
        calibrator="array",
        parameters=tuple(
            StoredParameter(name, "positions", "array", float(value), float(own), "mm")
            for name, value, own in zip(names, 1e3 * total.mean[1:].ravel(), sd, strict=True)
        ),
        covariance=covariance,
        raw_unit="m/s2",
        raw_to_si=1.0,
        gravity=gravity,
        status=outcome.status,
        reasons=outcome.reasons,
        facts={
            "gravity_source": outcome.provenance.settings["gravity_source"],
            "errors": [error.as_dict() for error in outcome.errors],
            **facts,
            "provenance": outcome.provenance.as_dict(),
        },
        triads=triads,
    )


def _triads(
    rests: RestFit, moving: Moving, board: Board, found: LinearPart | None, scale: float
) -> tuple[Triad, ...]:
    """Each IMU as the rests and the found effects' linear parts have it; scale : of all gyros."""
    gain, bias, covariance = rests.in_board_axes()
    gyro_gain, gyro_bias = moving.gyros.gain, rests.gyro_bias[0]
    if found is not None:
        bias = bias + np.einsum("kij,kj->ki", gain, found.offset)
        gain = gain @ found.gain
        gyro_gain, gyro_bias = found.gyro_gain, gyro_bias + found.gyro_offset
    # What is corrected is read in the sensors' own axes: those of the package are undone first.
    wired = _in_board_axes(board.accelerometer_axes, board.rotations)
    gyro_wired = _in_board_axes(board.gyro_axes, board.rotations)
    both = np.zeros((board.count, 12, 12))
    both[:, :9, :9] = np.einsum("kij,ab->kiajb", wired, np.eye(3)).reshape(-1, 9, 9)
    both[:, 9:, 9:] = wired
    covariance = both @ covariance @ both.transpose(0, 2, 1)
    return tuple(
        Triad(
            name=name,
            rotation=board.rotations[k],
            gain=wired[k] @ gain[k],
            bias=wired[k] @ bias[k],
            gyro_gain=scale * gyro_wired[k] @ gyro_gain[k],
            gyro_bias=gyro_wired[k] @ gyro_bias[k],
            covariance=covariance[k],
            noise=float(rests.noise[k]),
            gyro_noise=float(rests.gyro_noise[k]),
        )
        for k, name in enumerate(board.imus)
    )


def _in_board_axes(own: Array, rotations: Array) -> Array:
    """(K, 3, 3) from a package's axes to its sensor's own, as seen in board axes."""
    back = rotations.transpose(0, 2, 1)
    return np.asarray(rotations @ own.transpose(0, 2, 1) @ back)


def array_details(
    *,
    rests: RestFit,
    moving: Moving,
    final: ArrayPositions,
    total: Total,
    gyros: GyroScale,
    board: Board,
    loop: MotionLoop | None,
    linear: LinearPart | None,
    residual: Residual,
) -> dict[str, Any]:
    """What only an array has to say, for report.json; a part of it also for the YAML."""
    mean, sd, drawn = ((1e3 * v).tolist() for v in (total.mean, total.sd, board.drawn))
    details: dict[str, Any] = {
        "board": board.name,
        "reference": board.imus[0],
        **instrument_block(board, moving.interval),
        "positions_mm": [
            {"imu": name, "mean": mean[k], "sd": sd[k], "drawn": drawn[k]}
            for k, name in enumerate(board.imus)
        ],
        **size_block(total, gyros, board),
        "residual_in_motion": {
            "accelerometers_m_per_s2": residual.acceleration,
            "gyros_deg_per_s": residual.rate / DEG,
            "held_out": residual.held_out,
        },
        "diagnostics": _diagnostics(final),
        "rests": {
            "count": rests.poses,
            "residual_m_per_s2": rests.residual,
            "residual_before_search_m_per_s2": rests.before,
            "verdict": rests.loop.verdict if rests.loop else "not run",
            **_drift_of(rests, board),
        },
        "moving": dict(moving.counts),
        "not_undone": [
            {"effect": name, "rms": rms, "unit": unit}
            for name, rms, unit in (*_drift(rests), *(linear.left if linear else ()))
        ],
    }
    details["effects"] = rest_blocks(rests)
    if loop is not None:
        details["effects"] += effect_blocks(loop)
        details["noise"] = noise_block(loop)
    return details


def instrument_block(board: Board, interval: float) -> dict[str, Any]:
    """What a later log's fusion and the exports need beside positions, triads and effects: the
    first IMU's place in the drawing, where readings clip (None where the board file does not say)
    and the interval of samples, s."""
    stated = {
        "accelerometer_g": board.accelerometer_range / STANDARD_GRAVITY,
        "gyroscope_deg_per_s": board.gyroscope_range / DEG,
    }
    return {
        "reference_mm": (1e3 * board.positions[0]).tolist(),
        "ranges": {name: v if np.isfinite(v) else None for name, v in stated.items()},
        "sample_interval_s": interval,
    }


def _drift(rests: RestFit) -> Iterator[tuple[str, float, str]]:
    """How the offsets moved during the rests, against their end, which is where the biases hold."""
    t = np.linspace(rests.start, rests.stop, 21)
    away = rests.offset(t) - rests.offset(t[-1:])
    if away.any():
        yield DRIFT, float(np.sqrt(np.mean(away**2))), "m/s²"


def _drift_of(rests: RestFit, board: Board) -> dict[str, Any]:
    """The same at every rest, of readings in the sensors' own axes; nothing where none is."""
    t = rests.fit.observations.context["time"]
    away = rests.offset(t) - rests.offset(np.array([rests.stop]))
    if not away.any():
        return {}
    own = np.einsum("kji,nkj->nki", board.accelerometer_axes, away)
    return {"drift": drift_block(t, own)}


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
