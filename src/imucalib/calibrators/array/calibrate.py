"""`imucal array`: from a bench log to the posterior of the accelerometers' positions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.board.board import Board
from imucalib.calibrators.array.board.drawing import (
    board_from_log,
    check_board,
    refuse_contradiction,
)
from imucalib.calibrators.array.board.log import ArrayLog, array_log, of_board
from imucalib.calibrators.array.board.moving import Moving, find_moving
from imucalib.calibrators.array.board.rests import RestFit, fit_rests
from imucalib.calibrators.array.board.streams import (
    noisy_alone,
    streams,
)
from imucalib.calibrators.array.board.turns import scale_by_turns
from imucalib.calibrators.array.findings import linear_part, residual_in_motion
from imucalib.calibrators.array.motion.closed_loop import MotionLoop, close_array_loop
from imucalib.calibrators.array.motion.covariance import Uneven, add_unevenness
from imucalib.calibrators.array.motion.posterior import (
    PositionDraws,
    draw_as_published,
    draw_positions,
)
from imucalib.calibrators.array.motion.search import frame_term
from imucalib.calibrators.array.motion.setup import array_setup, set_up
from imucalib.calibrators.array.motion.state import (
    ArrayState,
    fit_all_samples,
    start_state,
)
from imucalib.calibrators.array.motion.terms import rest_terms
from imucalib.calibrators.array.motion.total import total_of
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.run import ArrayRun, LocatedBoard, PreparedLog, finish_run
from imucalib.errors import Undetermined
from imucalib.recording.recording import Recording
from imucalib.rests.candidates import refusals
from imucalib.rests.segments import Segments, still_segments

Say = Callable[[str], None]
#: Of the drawing's prior_sd, from which a place is said to be off it.
_FAR = 3.0
#: Readings of one kind, samples times IMUs, that a fit takes where nobody says how many: beyond
#: them memory and time grow, and positions are known far better than they repeat.
READINGS = 60_000
SEARCH_SAMPLES = 600  # moving samples on which effects are searched
HALVED_SAMPLES = 800  # moving samples of which each half is searched again


def calibrate_array(recording: Recording, request: ArrayRequest, say: Say) -> ArrayRun:
    """Rests, triads, gyros, informative samples, posterior, loop.

    Raises UnreadableInput for a recording that does not match the board, Undetermined when the
    rests or the motion do not hold the answer or contradict the board, NotConverged when the
    chains disagree.
    """
    request.refuse_contradictions()
    prepared, log = _prepare(recording, request, say)
    del recording  # from here on a log is side by side: held twice, one of many IMUs is large
    segments, board = prepared.segments, prepared.board
    rests = fit_rests(segments, board, request)
    say(f"{rests.poses} rests: triads fit gravity to {1e3 * rests.residual:.2f} mm/s² rms")
    moving = find_moving(log, rests)
    say("moving samples: " + ", ".join(f"{n} {name}" for name, n in moving.counts.items()))
    state, loop, uneven = _fit(board, request, moving, rests)
    if loop is not None:
        loop = loop.join_rests(rests.loop).hold_against_rests(segments, rests)
        say("found: " + (", ".join(s.effect for s in loop.steps) or "nothing"))
    drawn, motion = _draw(state, moving, request)
    say(f"{len(state.setup.inner)} samples: {drawn.sentence}")
    linear = linear_part(state)
    if loop is None:  # of gyros that were made like their mean
        linear = replace(linear, gyro_gain=moving.gyros.gain @ linear.gyro_gain)
    gyros = scale_by_turns(log, segments, rests, linear.gyro_gain, state.noise[1].factor)
    total = total_of(
        drawn.mean,
        motion,
        gyros=gyros,
        gravity_sd=request.gravity_sd,
        frame_sd=rests.frame_sd,
        distances=request.distances,
    )
    gaps = request.loop and not request.as_published and loop is None
    unsearched = ("the motion has too many gaps for the search for effects",) if gaps else ()
    off = off_the_drawing(total.mean, board)
    prepared = replace(prepared, notes=(*prepared.notes, *drawn.notes, *unsearched, *off))
    return finish_run(
        LocatedBoard(
            **vars(prepared),
            rests=rests,
            moving=moving,
            state=state,
            loop=loop,
            uneven=uneven,
            drawn=drawn,
            total=total,
            gyros=gyros,
            linear=linear,
            residual=residual_in_motion(loop, state),
        )
    )


def off_the_drawing(r: Array, board: Board) -> Iterator[str]:
    """A word on each IMU that is farther from its drawing than the board file allows for; r : (K,
    3) m, the first at zero."""
    off = np.abs(r - board.drawn)
    for k in np.flatnonzero(off.max(axis=1) > _FAR * board.prior_sd):
        yield (
            f"{board.imus[k]} is {1e3 * off[k].max():.2g} mm off its drawing along "
            f"{'xyz'[int(off[k].argmax())]}, where prior_sd allows for {1e3 * board.prior_sd:.2g}: "
            "check its place in the board file, or that of the first IMU"
        )


def _prepare(recording: Recording, request: ArrayRequest, say: Say) -> tuple[PreparedLog, ArrayLog]:
    """The IMUs of a board side by side, and their samples. Errors as of `calibrate_array`."""
    read = len(recording.notes)
    recording, board = of_board(recording, request.board)
    for note in recording.notes[read:]:
        say(note)
    log, segments = array_log(recording, board), still_segments(recording, request.still)
    _refuse_restless(segments, board, recording, log)
    if board.undrawn:
        recording, board = of_board(recording, board_from_log(log, segments, board))
        log, segments = array_log(recording, board), still_segments(recording, request.still)
    seen = streams(log)
    if not request.as_drawn:
        seen.refuse_late(board.imus, log.interval)
        refuse_contradiction(check_board(log, segments, board), request.agreeing)
    log = replace(log, clipped=log.clipped | seen.held)
    notes = (*recording.notes, *segments.notes, *log.notes, *seen.notes)
    # What the recording is called and how long it is, but no readings.
    channels = {
        name: replace(c, values=np.broadcast_to(np.nan, c.values.shape))
        for name, c in recording.channels.items()
    }
    prepared = PreparedLog(
        recording=replace(recording, channels=channels),
        board=board,
        request=request,
        segments=segments,
        notes=notes,
        broken=tuple(seen.find_broken(board.imus)),
    )
    return prepared, log


def _refuse_restless(segments: Segments, board: Board, recording: Recording, log: ArrayLog) -> None:
    if segments.n:
        return
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


def _fit(
    board: Board, request: ArrayRequest, moving: Moving, rests: RestFit
) -> tuple[ArrayState, MotionLoop | None, Uneven | None]:
    """The joint fit of rests and motion, searched where that was asked for; without a search, where
    positions differ from part to part of the motion."""
    most = min(len(moving.good), request.samples or max(READINGS // board.count, 1))
    searched = (request.loop or bool(request.declare)) and not request.as_published
    setup = array_setup(moving, board, min(most, SEARCH_SAMPLES)) if searched else None
    if searched and setup is None and request.declare:
        raise Undetermined(
            "the motion has too many gaps to fit declared effects",
            remedy="record longer stretches without gaps and clipping",
        )
    terms = rest_terms(rests)
    try:
        if setup is None:
            # Where nothing is searched, gyros are made like their mean by plain comparison.
            levelled, some = moving.levelled, min(most, SEARCH_SAMPLES)
            plain = array_setup(levelled, board, some)
            plain = plain or set_up(levelled, board, some, neighbours=False)
            state = fit_all_samples(start_state(plain, (*terms, frame_term())), most)
            state, uneven = add_unevenness(state)
            return state, None, uneven
        loop = close_array_loop(
            setup,
            terms,
            request,
            halved=array_setup(moving, board, min(most, HALVED_SAMPLES)),
            most=most,
        )
        return loop.final, loop, None
    except np.linalg.LinAlgError as error:
        raise Undetermined(
            f"no motion of a rigid board fits these readings: {error}",
            remedy="check `axes` and the ranges in the board file; `imucal inspect FILE` shows "
            "where readings clip or freeze",
        ) from error


def _draw(state: ArrayState, moving: Moving, request: ArrayRequest) -> tuple[PositionDraws, Array]:
    """Positions as they are drawn, and the covariance (d, d) m² that the motion leaves of them."""
    rng = np.random.default_rng(request.seed)
    if not request.as_published:
        drawn = draw_positions(state, request.stop, rng)
        return drawn, state.covariance[: state.positions, : state.positions]
    drawn = draw_as_published(
        moving,
        state.setup.board,
        rng,
        samples=request.samples,
        iterations=request.iterations,
        stop=request.stop,
    )
    return drawn, drawn.covariance
