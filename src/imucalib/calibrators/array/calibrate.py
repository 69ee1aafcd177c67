"""`imucal array`: from a bench log to the posterior of the accelerometers' positions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.drawing.check import compared, refuse_contradiction
from imucalib.calibrators.array.drawing.sketch import sketched
from imucalib.calibrators.array.drawing.streams import refuse_streams, stream_notes, streams
from imucalib.calibrators.array.estimate.corrected import corrected_samples, restated
from imucalib.calibrators.array.estimate.covariance import with_stated_covariance
from imucalib.calibrators.array.estimate.every import fitted_on_all, samples_taken
from imucalib.calibrators.array.estimate.size import frame_sd, gravity_sd, scale_by_turns
from imucalib.calibrators.array.estimate.total import total_of
from imucalib.calibrators.array.linear_part import linear_part
from imucalib.calibrators.array.log import array_log, in_package_axes
from imucalib.calibrators.array.loop.at_rest import with_rests
from imucalib.calibrators.array.loop.closed_loop import ARRAY_RULES, MotionLoop, close_array_loop
from imucalib.calibrators.array.loop.noise_tests import shared_by_neighbours
from imucalib.calibrators.array.loop.setup import array_setup
from imucalib.calibrators.array.loop.state import ArrayState, start_state
from imucalib.calibrators.array.loop.terms import rest_terms
from imucalib.calibrators.array.moving import Moving, moving_part, samples_of, spread_over
from imucalib.calibrators.array.request import NON_LINEARITY, ArrayRequest
from imucalib.calibrators.array.rests import RestFit, fit_rests
from imucalib.calibrators.array.run import ArrayRun, finished
from imucalib.errors import NotConverged, Undetermined, UsageError
from imucalib.estimators.array.problem import ArrayData, ArrayPrior
from imucalib.estimators.array.sampler import (
    ArrayPositions,
    gaussian_positions,
    refuse_collapse,
    refuse_vague,
    sample_positions,
)
from imucalib.estimators.markov.convergence import convergence
from imucalib.estimators.markov.pmmh import run_pmmh
from imucalib.recording.recording import Recording
from imucalib.rests.refused import refusals
from imucalib.rests.segments import Segments, still_segments

Say = Callable[[str], None]
SEARCH_SAMPLES = 600  # moving samples on which effects are searched
HALVED_SAMPLES = 800  # moving samples of which each half is searched again
PUBLISHED_SAMPLES = 2000  # moving samples of the paper's sampler, where nobody says how many


def calibrate_array(recording: Recording, request: ArrayRequest, say: Say) -> ArrayRun:
    """Rests, triads, gyros, informative samples, posterior, loop.

    Raises UnreadableInput for a recording that does not match the board, Undetermined when the
    rests or the motion do not hold the answer or contradict the board, NotConverged when the
    chains disagree.
    """
    if request.limits and not (request.loop or request.asked.declare):
        raise UsageError("limits need held-out data", remedy="leave --no-loop out")
    recording = in_package_axes(recording, request.board)
    log, board = array_log(recording, request.board)
    segments = still_segments(recording, request.still)
    order = _order(segments, board, recording)
    if board.undrawn:
        board = sketched(log, segments, board, order)
        recording = in_package_axes(recording, board)
        log, board = array_log(recording, board)
        segments = still_segments(recording, request.still)
    taken = streams(log)
    if not request.as_drawn:
        refuse_streams(taken, board.imus, log.interval)
        refuse_contradiction(compared(log, segments, board, order))
    log = replace(log, clipped=log.clipped | taken.held)
    rests = fit_rests(
        segments, board, order, request.gravity,
        asked=replace(request.asked, search=request.loop), seed=request.seed,
    )  # fmt: skip
    say(f"{segments.n} rests: triads fit gravity to {1e3 * rests.residual:.2f} mm/s² rms")
    moving = moving_part(log, rests, board.imus)
    say("moving samples: " + ", ".join(f"{n} {name}" for name, n in moving.counts.items()))
    rng = np.random.default_rng(request.seed)
    loop, state = _fitted(moving, rests, board, request)
    if loop is not None:
        say("found: " + (", ".join(f"{s.effect} ({s.value})" for s in loop.steps) or "nothing"))
    found, motion = _sampled(moving, rests, board, request, rng, loop, state)
    linear = linear_part(loop) if loop is not None else None
    gyros = scale_by_turns(
        log, segments, rests, moving, order, None if linear is None else linear.gyro_gain
    )
    total = total_of(
        found.mean, motion, scale=gyros.value, scale_sd=gyros.sd,
        gravity_sd=gravity_sd(request.gravity_source), frame_sd=frame_sd(rests),
        distances=request.distances,
    )  # fmt: skip
    final = restated(found, total, rng)
    say(f"{final.data.samples} samples: {final.convergence.sentence}")
    notes = (
        *recording.notes, *segments.notes, *log.notes, *stream_notes(taken, board.imus),
        *final.notes,
    )  # fmt: skip
    if request.loop and loop is None:
        notes += ("the motion is too broken up for the search of the loop",)
    return finished(
        recording=recording, board=board, request=request, segments=segments, rests=rests,
        moving=moving, final=final, total=total, gyros=gyros, loop=loop, state=state,
        linear=linear, notes=notes,
    )  # fmt: skip


def _order(segments: Segments, board: Board, recording: Recording) -> list[int]:
    names = board.imus if set(board.imus) <= set(segments.triads) else segments.triads
    if segments.n == 0:
        raise Undetermined(
            "no rest found, so the accelerometers cannot be calibrated by gravity: "
            + refusals(segments.candidates),
            where=recording.path,
            remedy="hold the board still in nine or more attitudes before twisting it; "
            "`imucal inspect FILE --rests` lists what was refused",
        )
    return [segments.triads.index(name) for name in names]


def _fitted(
    moving: Moving, rests: RestFit, board: Board, request: ArrayRequest
) -> tuple[MotionLoop | None, ArrayState | None]:
    """The search and the joint fit of all informative samples; no search where none is wanted, no
    fit where the motion is too broken up."""
    robust = request.accelerometer_sigma == "estimate"
    most = samples_taken(moving, request.samples)
    setup = array_setup(moving, board, min(most, SEARCH_SAMPLES), robust=robust)
    if setup is None:
        if request.asked.declare:
            raise Undetermined(
                "the motion is too broken up to fit declared effects",
                remedy="record longer stretches without gaps and clipping",
            )
        return None, None
    terms = rest_terms(rests)
    if not (request.loop or request.asked.declare):
        state = fitted_on_all(start_state(setup, terms), moving, most)
        return None, with_stated_covariance(state, shared_by_neighbours(state, gyro=False))
    loop = close_array_loop(
        setup, terms, moving, np.random.default_rng(request.seed),
        replace(ARRAY_RULES, curves=request.curves, draws=request.draws),
        array_setup(moving, board, min(most, HALVED_SAMPLES), robust=robust), most,
        asked=replace(request.asked, search=request.loop),
    )  # fmt: skip
    loop = with_rests(loop, rests.loop)
    return loop, loop.final


def _sampled(
    moving: Moving, rests: RestFit, board: Board, request: ArrayRequest,
    rng: np.random.Generator, loop: MotionLoop | None, state: ArrayState | None,
) -> tuple[ArrayPositions, Array]:  # fmt: skip
    """The sampler's answer, and the covariance of the positions by log and rests."""
    sigma, estimate = _sigma(rests, board, request)
    published = request.sampler == "pmmh" or request.motion == "flat"
    prior = ArrayPrior(
        board.drawn, board.prior_sd, request.motion, request.exponent,
        estimate_noise=estimate and (state is None or (published and loop is None)),
    )  # fmt: skip
    few = min(request.samples or PUBLISHED_SAMPLES, len(moving.good))
    if state is None or (published and loop is None):
        rows = spread_over(moving.good, few)
        data = samples_of(moving, rows, sigma, request.gyro_covariance)
        found = _drawn(data, prior, request, rng)
        return found, found.covariance
    data = corrected_samples(state)
    if request.sampler == "pmmh":
        data = data.take(spread_over(np.arange(data.samples), few))
    if not estimate:
        data = replace(data, sigma=sigma)
    motion = state.covariance[: state.positions, : state.positions]
    if board.on_a_line:
        own = state.r[1:].ravel()
        return gaussian_positions(data, prior, own, motion, rng), motion
    return _drawn(data, prior, request, rng), motion


def _drawn(
    data: ArrayData, prior: ArrayPrior, request: ArrayRequest, rng: np.random.Generator
) -> ArrayPositions:
    if request.sampler == "pmmh":
        return _by_pmmh(data, prior, request, rng)
    return sample_positions(
        data, prior, rng, chains=request.chains, stop=request.stop, checkpoint=request.checkpoint
    )


def _sigma(rests: RestFit, board: Board, request: ArrayRequest) -> tuple[Array, bool]:
    """Sigma of each triad, m/s², and whether a common factor on them is estimated."""
    chosen = request.accelerometer_sigma
    if chosen == "nonlinearity":
        if not np.isfinite(board.accelerometer_range):
            raise Undetermined(
                "the non-linearity rule needs the accelerometers' range",
                remedy="state accelerometer_range (g) in the board file",
            )
        return np.full(board.count, NON_LINEARITY * board.accelerometer_range), False
    if chosen == "estimate":
        # In motion the errors are not the noise at rest: one size for all, its factor free.
        return np.full(board.count, 5.0 * float(np.sqrt(np.mean(rests.noise**2)))), True
    return np.full(board.count, float(chosen)), False


def _by_pmmh(
    data: ArrayData, prior: ArrayPrior, request: ArrayRequest, rng: np.random.Generator
) -> ArrayPositions:
    from imucalib.estimators.array.mode import start_prior

    chosen = start_prior(data, prior)
    found = run_pmmh(data, chosen, rng, iterations=request.iterations, chains=request.chains or 2)
    checked = convergence(found.draws)
    if not checked.reached(request.stop.rhat, request.stop.ess):
        raise NotConverged(
            f"the chains of Algorithm 1 do not agree after {request.iterations} iterations: "
            f"{checked.sentence}",
            remedy="more --iterations, or the default sampler",
        )
    note = (
        f"Algorithm 1: N = {found.monte_carlo}, variance of the log likelihood "
        f"{found.variance:.2g}, acceptance {100 * found.accepted:.0f} %, burn-in {found.burn_in}"
    )
    thin = max(1, request.iterations // 2000)
    positions = ArrayPositions(
        data=data,
        prior=chosen,
        unknowns=found.draws[:, ::thin],
        frame=None,
        accepted=found.accepted,
        steps=1,
        convergence=checked,
        sampler="pmmh",
        notes=(note,),
    )
    refuse_collapse(positions.mean, chosen.nominal)
    refuse_vague(positions)
    return positions
