"""`imucal array`: from a bench log to the posterior of the accelerometers' positions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.drawing.check import compared, refuse_contradiction, sketched
from imucalib.calibrators.array.drawing.streams import (
    Streams,
    noisy_alone,
    refuse_streams,
    stream_notes,
    streams,
)
from imucalib.calibrators.array.effect_blocks import with_rests
from imucalib.calibrators.array.estimate.covariance import (
    Uneven,
    fitted_on_all,
    samples_taken,
    with_uneven,
)
from imucalib.calibrators.array.estimate.sampled import sampled_positions
from imucalib.calibrators.array.estimate.total import (
    GyroScale,
    frame_sd,
    gravity_sd,
    restated,
    scale_by_turns,
    total_of,
)
from imucalib.calibrators.array.gyros import ATTITUDES, contradicted
from imucalib.calibrators.array.linear_part import (
    GYRO_FRAME,
    LinearPart,
    linear_part,
    of_alike_gyros,
)
from imucalib.calibrators.array.log import ArrayLog, array_log, of_board
from imucalib.calibrators.array.loop.closed_loop import MotionLoop, close_array_loop
from imucalib.calibrators.array.loop.motion import BoardMotion, motion_at_rest
from imucalib.calibrators.array.loop.search import start_state, with_declared
from imucalib.calibrators.array.loop.setup import array_setup
from imucalib.calibrators.array.loop.state import ArrayState, shared_by_neighbours
from imucalib.calibrators.array.loop.terms import Term, rest_terms
from imucalib.calibrators.array.moving import Moving, moving_part
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.rests import RestFit, fit_rests
from imucalib.calibrators.array.run import ArrayRun, finished
from imucalib.errors import Undetermined, UsageError
from imucalib.loop.found import Unexplained
from imucalib.recording.recording import Recording
from imucalib.rests.levels import refusals
from imucalib.rests.segments import Segments, still_segments

#: What stands beside a contradicted name.
OTHER = "what shows in motion only"


def held_against_rests(loop: MotionLoop, force: Array, rate: Array, t: Array) -> MotionLoop:
    """The loop with doubts where rests contradict a name: it stays corrected, is not certain, and
    what it stands for is left open.

    force : (n, K, 3) m/s² at n rests, rate : (n, K, 3) rad/s as read, in board axes; t : (n,) s
    """
    if len(force) < ATTITUDES:
        return loop
    state = loop.final
    motion = motion_at_rest(state.setup.imus, state.setup.board.rotations, force, t)
    wrong = {term.name for term in state.found if _contradicted(term, motion, rate)}
    if not wrong:
        return loop
    steps = tuple(
        replace(s, aliases=(*s.aliases, OTHER), certain=False) if s.effect in wrong else s
        for s in loop.steps
    )
    left = tuple(
        Unexplained(
            f"{s.effect} shows in motion and not at rest",
            "force",
            "probe",
            s.probability,
            s.evidence,
        )
        for s in loop.steps
        if s.effect in wrong
    )
    return replace(loop, steps=steps, unexplained=(*loop.unexplained, *left))


def _contradicted(term: Term, motion: BoardMotion, rate: Array) -> bool:
    """Whether a gyro's effect of the force makes the rests scatter more."""
    if term.effect.channel != "angular_rate" or "spin" in term.effect.needs:
        return False
    return contradicted(rate, term.reading(term.columns(motion)))


Say = Callable[[str], None]
_Fitted = tuple[MotionLoop | None, ArrayState | None, Uneven | None]
SEARCH_SAMPLES = 600  # moving samples on which effects are searched
HALVED_SAMPLES = 800  # moving samples of which each half is searched again
_BROKEN_UP = ("the motion is too broken up for the search of the loop",)


@dataclass(frozen=True)
class _Laid:
    """A recording laid out as the board is: its IMUs side by side, and where it rests.

    order : the board's IMUs in the segments' triads; taken : how the samples were taken
    """

    recording: Recording
    board: Board
    log: ArrayLog
    segments: Segments
    order: list[int]
    taken: Streams

    @property
    def notes(self) -> tuple[str, ...]:
        told = stream_notes(self.taken, self.board.imus)
        return (*self.recording.notes, *self.segments.notes, *self.log.notes, *told)


def calibrate_array(recording: Recording, request: ArrayRequest, say: Say) -> ArrayRun:
    """Rests, triads, gyros, informative samples, posterior, loop.

    Raises UnreadableInput for a recording that does not match the board, Undetermined when the
    rests or the motion do not hold the answer or contradict the board, NotConverged when the
    chains disagree.
    """
    if request.limits and not (request.loop or request.asked.declare):
        raise UsageError("limits need held-out data", remedy="leave --no-loop out")
    laid = _laid(recording, request, say)
    del recording  # from here on a log is side by side: held twice, one of many IMUs is large
    board, segments = laid.board, laid.segments
    asked = replace(request.asked, search=request.loop)
    rests = fit_rests(segments, board, laid.order, request.gravity, asked=asked)
    say(f"{segments.n} rests: triads fit gravity to {1e3 * rests.residual:.2f} mm/s² rms")
    moving = moving_part(laid.log, rests, board.imus)
    say("moving samples: " + ", ".join(f"{n} {name}" for name, n in moving.counts.items()))
    loop, state, apart = _fitted_or_told(moving, rests, board, request)
    if loop is not None:
        loop = _doubted(loop, laid, rests)
        say("found: " + (", ".join(s.effect for s in loop.steps) or "nothing"))
    rng = np.random.default_rng(request.seed)
    found, motion = sampled_positions(
        moving=moving,
        rests=rests,
        board=board,
        request=request,
        rng=rng,
        state=state,
        searched=loop is not None,
    )
    linear = _linear(loop, state, moving)
    gyros = _scaled(laid, rests, moving, linear, state)
    total = total_of(
        found.mean,
        motion,
        scale=gyros.value,
        scale_sd=gyros.sd,
        gravity_sd=gravity_sd(request.gravity_source),
        frame_sd=frame_sd(rests),
        distances=request.distances,
    )
    final = restated(found, total, rng)
    say(f"{final.data.samples} samples: {final.convergence.sentence}")
    unsearched = _BROKEN_UP if request.loop and loop is None else ()
    return finished(
        recording=laid.recording,
        board=board,
        request=request,
        segments=segments,
        rests=rests,
        moving=moving,
        final=final,
        total=total,
        gyros=gyros,
        loop=loop,
        state=state,
        apart=apart,
        linear=linear,
        notes=(*laid.notes, *final.notes, *unsearched),
    )


def _scaled(
    laid: _Laid,
    rests: RestFit,
    moving: Moving,
    linear: LinearPart | None,
    state: ArrayState | None,
) -> GyroScale:
    """The gyros' common scale, by gravity carried over the turns between rests."""
    return scale_by_turns(
        laid.log,
        laid.segments,
        rests,
        moving,
        laid.order,
        gyro_gain=None if linear is None else linear.gyro_gain,
        factor=None if state is None else state.noise[1].factor,
    )


def _linear(loop: MotionLoop | None, state: ArrayState | None, moving: Moving) -> LinearPart | None:
    """What the motion says of the gyros' gains, with its search or without."""
    if loop is not None:
        return linear_part(loop.final)
    return of_alike_gyros(state, moving.gyros.gain) if state is not None else None


def _doubted(loop: MotionLoop, laid: _Laid, rests: RestFit) -> MotionLoop:
    """With the word of the rests on what was found in motion."""
    segments, t = laid.segments, 0.5 * (laid.segments.start + laid.segments.stop)
    read, rate = (
        np.einsum("kij,nkj->nki", laid.board.rotations, values[:, laid.order])
        for values in (segments.mean, segments.rate)
    )
    return held_against_rests(loop, rests.corrected(read, t), rate, t)


def _laid(recording: Recording, request: ArrayRequest, say: Say) -> _Laid:
    read = len(recording.notes)
    recording, board = of_board(recording, request.board)
    for note in recording.notes[read:]:
        say(note)
    log = array_log(recording, board)
    segments = still_segments(recording, request.still)
    order = _order(segments, board, recording, log)
    if board.undrawn:
        board = sketched(log, segments, board, order)
        recording, board = of_board(recording, board)
        log = array_log(recording, board)
        segments = still_segments(recording, request.still)
    taken = streams(log)
    if not request.as_drawn:
        refuse_streams(taken, board.imus, log.interval)
        refuse_contradiction(compared(log, segments, board, order), request.agreeing)
    log = replace(log, clipped=log.clipped | taken.held)
    return _Laid(_without_values(recording), board, log, segments, order, taken)


def _without_values(recording: Recording) -> Recording:
    """The recording with what it is called and how long it is, but no readings."""
    channels = {
        name: replace(c, values=np.broadcast_to(np.nan, c.values.shape))
        for name, c in recording.channels.items()
    }
    return replace(recording, channels=channels)


def _order(segments: Segments, board: Board, recording: Recording, log: ArrayLog) -> list[int]:
    if segments.n == 0:
        noisy = noisy_alone(log)
        if noisy is not None:
            raise Undetermined(
                f"no rest found: the accelerometer of {board.imus[noisy]} is never still, where "
                "all others are",
                where=recording.path,
                remedy="take the IMU off the board file, or look for a loose mount or a bad supply",
            )
        raise Undetermined(
            "no rest found, so the accelerometers cannot be calibrated by gravity: "
            + refusals(segments.candidates),
            where=recording.path,
            remedy="hold the board still in nine or more attitudes before twisting it; "
            "`imucal inspect FILE --rests` lists what was refused",
        )
    return [segments.triads.index(name) for name in board.imus]


def _fitted_or_told(moving: Moving, rests: RestFit, board: Board, request: ArrayRequest) -> _Fitted:
    try:
        return _fitted(moving, rests, board, request)
    except np.linalg.LinAlgError as error:
        raise Undetermined(
            f"no motion of a rigid board fits these readings: {error}",
            remedy="check `axes` and the ranges in the board file; `imucal inspect FILE` shows "
            "where readings clip or freeze",
        ) from error


def _fitted(moving: Moving, rests: RestFit, board: Board, request: ArrayRequest) -> _Fitted:
    """The search and the joint fit of all informative samples, and where positions differ from part
    to part of the motion; no search where none is wanted, no fit where it is too broken up."""
    robust = request.accelerometer_sigma == "estimate"
    most = samples_taken(moving, request.samples)
    setup = array_setup(moving, board, min(most, SEARCH_SAMPLES), robust=robust)
    if setup is None:
        if request.asked.declare:
            raise Undetermined(
                "the motion is too broken up to fit declared effects",
                remedy="record longer stretches without gaps and clipping",
            )
        return None, None, None
    terms = rest_terms(rests)
    if not (request.loop or request.asked.declare):
        state = _unsearched(moving.levelled, board, terms, most, robust=robust)
        return None, *with_uneven(state, shared_by_neighbours(state, gyro=False))
    loop = close_array_loop(
        setup,
        terms,
        curves=request.curves,
        halved=array_setup(moving, board, min(most, HALVED_SAMPLES), robust=robust),
        most=most,
        asked=replace(request.asked, search=request.loop),
    )
    loop = with_rests(loop, rests.loop)
    return loop, loop.final, None  # the loop has told of its parts


def _unsearched(
    moving: Moving, board: Board, terms: tuple[Term, ...], most: int, *, robust: bool
) -> ArrayState:
    """The joint fit of all informative samples of gyros that are alike. What they share against
    the accelerometers no comparison of gyros shows, and every board has it."""
    setup = array_setup(moving, board, min(most, SEARCH_SAMPLES), robust=robust)
    assert setup is not None
    start = with_declared(start_state(setup, terms), (GYRO_FRAME,))
    return fitted_on_all(start, most)
