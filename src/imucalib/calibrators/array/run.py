"""A finished calibration of one log: every stage of it, and what all calibrators hand out.

The calibration's parameters are the positions; every IMU has its linear correction, and found
effects with their values, and what of them no linear correction carries, are facts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.outcome import Limit, Outcome, Run, provenance_of
from imucalib.calibration.triads import DRIFT, Triad, drift_block
from imucalib.calibrators.array.board.board import Board
from imucalib.calibrators.array.board.moving import Moving
from imucalib.calibrators.array.board.rests import RestFit
from imucalib.calibrators.array.board.turns import GyroScale
from imucalib.calibrators.array.findings import (
    LinearPart,
    Residual,
    advice,
    array_errors,
    array_findings,
    effect_blocks,
    find_unexplained,
    noise_block,
    reasons,
    rest_blocks,
)
from imucalib.calibrators.array.motion.closed_loop import MotionLoop
from imucalib.calibrators.array.motion.covariance import Uneven
from imucalib.calibrators.array.motion.posterior import PositionDraws
from imucalib.calibrators.array.motion.state import ArrayState
from imucalib.calibrators.array.motion.total import Total, size_block
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.core.fit import StoredParameter
from imucalib.recording.identity import Identity
from imucalib.recording.pairing import channel_names
from imucalib.recording.recording import Recording
from imucalib.rests.segments import Segments
from imucalib.units import DEG, STANDARD_GRAVITY

#: Blocks of report.json that the YAML has not.
_OF_REPORT = ("distances_mm", "moving", "noise")


@dataclass(frozen=True, kw_only=True)
class PreparedLog:
    """A log laid out as its board is.

    recording : without its readings; segments : where the IMUs rest; notes : what is worth knowing
    broken : what to look at of sensors that do not serve all the time
    """

    recording: Recording
    board: Board
    request: ArrayRequest
    segments: Segments
    notes: tuple[str, ...]
    broken: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class LocatedBoard(PreparedLog):
    """With its rests and its motion fitted, and the positions with all of their uncertainty.

    state : the joint fit of all informative samples; loop : None where nothing was searched
    uneven : where positions differ from part to part of the motion and no loop says so
    drawn : chains over the joint fit, or those of the paper; total : with size and frame
    linear : what a linear correction holds of the joint fit
    """

    rests: RestFit
    moving: Moving
    state: ArrayState
    loop: MotionLoop | None
    uneven: Uneven | None
    drawn: PositionDraws
    total: Total
    gyros: GyroScale
    linear: LinearPart
    residual: Residual


@dataclass(frozen=True, kw_only=True)
class ArrayRun(Run, LocatedBoard):
    """A finished run: what all calibrators share, and every stage for its own report."""


def finish_run(made: LocatedBoard) -> ArrayRun:
    """The run of a located board: judged, with its calibration."""
    recording, request, rests, loop = made.recording, made.request, made.rests, made.loop
    errors = array_errors(loop, rests, made.residual)
    left = find_unexplained(
        made.residual, rests, made.board.imus, request.accepted, loop or made.uneven
    )
    values = {
        "max-error": (errors[0].held_out.final, errors[0].unit),
        "max-gyro-error": (errors[1].held_out.final, errors[1].unit),
        "max-position-sd": (1e3 * float(made.total.sd.max()), "mm"),
    }
    outcome = Outcome(
        "array",
        errors,
        provenance_of(
            path=recording.path,
            sha256=recording.sha256,
            samples=max((len(c.t) for c in recording.channels.values()), default=0),
            gaps=len(recording.gaps),
            mapping=recording.mapping,
            settings=request.describe_settings(),
            seed=request.seed,
            command=request.command,
        ),
        findings=array_findings(loop) if loop else None,
        reasons=reasons(loop, left),
        advice=(*made.broken, *(advice(loop, rests) if loop else ())),
        limits=tuple(
            Limit(name, values[name][0], limit, values[name][1])
            for name, limit in request.limits.items()
        ),
        notes=made.notes,
        left=left,
        sensor=Identity(device=recording.device, serial=recording.serial),
    )
    details = _details(made)
    calibration = array_calibration(
        outcome,
        made.total,
        made.board.imus,
        gravity=rests.gravity,
        facts={name: block for name, block in details.items() if name not in _OF_REPORT},
        triads=tuple(_triads(made)),
    )
    return ArrayRun(outcome=outcome, calibration=calibration, details=details, **vars(made))


def array_calibration(
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
        sensor=outcome.sensor,
    )


def _triads(made: LocatedBoard) -> Iterator[Triad]:
    """Each IMU as the rests and the found effects' linear parts have it."""
    board, rests, found = made.board, made.rests, made.linear
    channels = channel_names(made.recording)
    gain, bias, covariance = rests.in_board_axes()
    bias = bias + np.einsum("kij,kj->ki", gain, found.offset)
    gain = gain @ found.gain
    gyro_gain, gyro_bias = found.gyro_gain, rests.gyro_bias[0] + found.gyro_offset
    # What is corrected is read in the sensors' own axes: those of the package are undone first.
    back = board.rotations.transpose(0, 2, 1)
    wired, gyro_wired = (
        board.rotations @ own.transpose(0, 2, 1) @ back
        for own in (board.accelerometer_axes, board.gyro_axes)
    )
    both = np.zeros((board.count, 12, 12))
    both[:, :9, :9] = np.einsum("kij,ab->kiajb", wired, np.eye(3)).reshape(-1, 9, 9)
    both[:, 9:, 9:] = wired
    covariance = both @ covariance @ both.transpose(0, 2, 1)
    for k, name in enumerate(board.imus):
        yield Triad(
            name=name,
            rotation=board.rotations[k],
            gain=wired[k] @ gain[k],
            bias=wired[k] @ bias[k],
            gyro_gain=(1.0 + made.gyros.value) * gyro_wired[k] @ gyro_gain[k],
            gyro_bias=gyro_wired[k] @ gyro_bias[k],
            covariance=covariance[k],
            noise=float(rests.noise[k]),
            gyro_noise=float(rests.gyro_noise[k]),
            channel=channels.get(name, ""),
        )


def _details(made: LocatedBoard) -> dict[str, Any]:
    """What only an array has to say, for report.json; a part of it also for the YAML."""
    board, rests, total, residual = made.board, made.rests, made.total, made.residual
    # How the offsets moved during the rests, against their mean, which is what the file holds.
    away = rests.away(np.linspace(rests.start, rests.stop, 21))
    moved = np.ptp(away, axis=0).any()
    drift = ((DRIFT, float(np.sqrt(np.mean(away**2))), "m/s²"),) if moved else ()
    details: dict[str, Any] = {
        "board": board.name,
        "reference": board.imus[0],
        **instrument_block(board, made.moving.interval),
        "positions_mm": position_rows(board, total),
        **size_block(total, made.gyros, board),
        "rests": {
            "count": rests.poses,
            "residual_m_per_s2": rests.residual,
            "residual_before_search_m_per_s2": rests.before,
            "verdict": rests.loop.verdict if rests.loop else "not run",
            **_drift_of(rests, board),
        },
        "residual_in_motion": {
            "accelerometers_m_per_s2": residual.acceleration,
            "gyros_deg_per_s": residual.rate / DEG,
            "held_out": residual.held_out,
        },
        "effects": rest_blocks(rests),
        "not_undone": [
            {"effect": name, "rms": rms, "unit": unit}
            for name, rms, unit in (*drift, *made.linear.beyond)
        ],
        "diagnostics": _diagnostics(made),
        "moving": dict(made.moving.counts),
    }
    if made.loop is not None:
        details["effects"] += effect_blocks(made.loop)
        details["noise"] = noise_block(made.loop)
    return details


def position_rows(board: Board, total: Total, **more: Array) -> list[dict[str, Any]]:
    """mm, each IMU's mean, sd and drawing; more : (K, 3) mm of other columns."""
    columns = {"mean": 1e3 * total.mean, "sd": 1e3 * total.sd, "drawn": 1e3 * board.drawn, **more}
    return [
        {"imu": name, **{what: values[k].tolist() for what, values in columns.items()}}
        for k, name in enumerate(board.imus)
    ]


def instrument_block(board: Board, interval: float) -> dict[str, Any]:
    """What a later log's fusion and the exports need besides positions, triads and effects: the
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


def _drift_of(rests: RestFit, board: Board) -> dict[str, Any]:
    """Of the offsets at every rest, in the sensors' own axes; nothing where none is."""
    t = rests.fit.observations.context["time"]
    away = rests.away(t)
    if not np.ptp(away, axis=0).any():
        return {}
    return {"drift": drift_block(t, np.einsum("kji,nkj->nki", board.accelerometer_axes, away))}


def _diagnostics(made: LocatedBoard) -> dict[str, Any]:
    """What the chains say of themselves, and how far their mean is from the fit's."""
    drawn, state = made.drawn, made.state
    found = drawn.convergence
    own = np.sqrt(np.diag(made.total.motion))
    return {
        "sampler": drawn.sampler,
        "chains": drawn.free.shape[0],
        "draws": drawn.free.shape[1],
        "acceptance": drawn.accepted,
        "largest_rhat": float(np.max(found.rhat)),
        "smallest_bulk_ess": float(np.min(found.bulk)),
        "smallest_tail_ess": float(np.min(found.tail)),
        "largest_mcse_mm": float(1e3 * np.max(found.mcse)),
        "mean_off_mode_sd": float(np.max(np.abs((drawn.mean - state.r)[1:].ravel() / own))),
        "sandwich_over_noise": float(np.sqrt(np.median(_measure_widening(state)))),
        "samples": len(state.setup.inner),
    }


def _measure_widening(state: ArrayState) -> Array:
    """(d,) variances of the positions as stated over those if the noise is what was fitted."""
    assert state.by_noise is not None
    both = (np.diag(one)[: state.positions] for one in (state.covariance, state.by_noise))
    return np.asarray(np.divide(*both))
