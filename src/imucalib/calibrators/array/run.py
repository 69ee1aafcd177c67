"""A finished calibration of one log: what all calibrators hand out, and every stage of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from imucalib.calibration.outcome import ErrorSummary, Limit, Outcome, Run
from imucalib.calibration.provenance import Provenance, provenance_of
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.calibration import array_calibration, array_details
from imucalib.calibrators.array.estimate.covariance import Uneven
from imucalib.calibrators.array.estimate.left import (
    Residual,
    left_in_words,
    residual_in_motion,
    what_is_left,
)
from imucalib.calibrators.array.estimate.total import GyroScale, Total
from imucalib.calibrators.array.findings import advice, array_errors, array_findings
from imucalib.calibrators.array.linear_part import LinearPart
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.moving import Moving
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.rests import RestFit
from imucalib.estimators.array.sampler import ArrayPositions
from imucalib.recording.pairing import channel_names
from imucalib.recording.recording import Recording
from imucalib.rests.segments import Segments


@dataclass(frozen=True, kw_only=True)
class ArrayRun(Run):
    """A finished run: what all calibrators share, and every stage for its own report."""

    recording: Recording
    board: Board
    request: ArrayRequest
    segments: Segments
    rests: RestFit
    moving: Moving
    final: ArrayPositions
    total: Total
    gyros: GyroScale
    loop: MotionLoop | None
    residual: Residual


class _Stages(TypedDict):
    """What both the details and the calibration are made of."""

    rests: RestFit
    moving: Moving
    total: Total
    gyros: GyroScale
    board: Board
    linear: LinearPart | None


def finished(
    *,
    recording: Recording,
    board: Board,
    request: ArrayRequest,
    segments: Segments,
    rests: RestFit,
    moving: Moving,
    final: ArrayPositions,
    total: Total,
    gyros: GyroScale,
    loop: MotionLoop | None,
    state: ArrayState | None,
    apart: Uneven | None,
    linear: LinearPart | None,
    notes: tuple[str, ...],
) -> ArrayRun:
    """The run of these stages: judged, with its calibration."""
    residual = residual_in_motion(loop, state, final, moving)
    noise = (_rms(rests.noise), _rms(rests.gyro_noise))
    errors = array_errors(loop, noise, board.count, residual)
    left = what_is_left(residual, rests, loop, request.accepted, apart)
    outcome = Outcome(
        "array",
        errors,
        _provenance(recording, request),
        findings=array_findings(loop) if loop else None,
        reasons=left_in_words(loop, left),
        advice=advice(loop, rests) if loop else (),
        limits=_limits(request, errors, final),
        notes=notes,
        left=left,
    )
    stages = _Stages(
        rests=rests, moving=moving, total=total, gyros=gyros, board=board, linear=linear
    )
    details = array_details(**stages, final=final, loop=loop, residual=residual)
    channels = channel_names(recording)
    calibration = array_calibration(outcome, details, **stages, channels=channels)
    return ArrayRun(
        outcome=outcome,
        calibration=calibration,
        details=details,
        recording=recording,
        board=board,
        request=request,
        segments=segments,
        rests=rests,
        moving=moving,
        final=final,
        total=total,
        gyros=gyros,
        loop=loop,
        residual=residual,
    )


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _limits(
    request: ArrayRequest, errors: tuple[ErrorSummary, ...], final: ArrayPositions
) -> tuple[Limit, ...]:
    """The user's limits against what was found."""
    values = {
        "max-error": (errors[0].held_out.final, errors[0].unit),
        "max-gyro-error": (errors[1].held_out.final, errors[1].unit),
        "max-position-sd": (1e3 * float(final.sd.max()), "mm"),
    }
    return tuple(
        Limit(name, values[name][0], limit, values[name][1])
        for name, limit in request.limits.items()
    )


def _provenance(recording: Recording, request: ArrayRequest) -> Provenance:
    return provenance_of(
        path=recording.path,
        sha256=recording.sha256,
        samples=max((len(c.t) for c in recording.channels.values()), default=0),
        gaps=len(recording.gaps),
        mapping=recording.mapping,
        settings=request.stated(),
        seed=request.seed,
        command=request.command,
    )
