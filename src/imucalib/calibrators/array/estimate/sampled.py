"""The sampler's answer: what it gets, and what it must not be asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.moving import Moving, samples_of, spread_over
from imucalib.calibrators.array.request import NON_LINEARITY, ArrayRequest
from imucalib.calibrators.array.rests import RestFit
from imucalib.errors import NotConverged, Undetermined
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

PUBLISHED_SAMPLES = 2000  # moving samples of the paper's sampler, where nobody says how many


def sampled_positions(
    *,
    moving: Moving,
    rests: RestFit,
    board: Board,
    request: ArrayRequest,
    rng: np.random.Generator,
    state: ArrayState | None,
    searched: bool,
) -> tuple[ArrayPositions, Array]:
    """The sampler's answer, and the covariance (d, d) m² of the positions by log and rests.

    state : the joint fit, or None where the motion is too broken up; searched : whether its terms
    were searched for. The paper's sampler and its flat prior get the plain samples, as published,
    where no search has found more. Raises Undetermined and NotConverged.
    """
    sigma, estimate = _sigma(rests, board, request)
    published = request.sampler == "pmmh" or request.motion == "flat"
    plain = state is None or (published and not searched)
    prior = ArrayPrior(
        board.drawn,
        board.prior_sd,
        request.motion,
        request.exponent,
        estimate_noise=estimate and plain,
    )
    few = min(request.samples or PUBLISHED_SAMPLES, len(moving.good))
    if state is None or plain:
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


def corrected_samples(state: ArrayState) -> ArrayData:
    """Readings with the effects taken out, as Gaussian data of one sigma.

    Where the noise has tails or grows with the rate, each residual is shrunk to λ/λ₀ of itself: the
    score of every unknown is then the weighted one at the mode (Huber's pseudo-values). The
    precision λ₀ is the mean of the weights over what each sample says of the positions, times the
    share of it that noise with tails tells.
    """
    sampled, inner, k = state.sampled, state.setup.inner, state.setup.triads
    weight = sampled.weights.acceleration[inner]
    lever = np.sum(sampled.turn[inner] ** 2, axis=(1, 2))[:, None]
    one = float(np.sum(lever * weight) / np.sum(lever) / k) * state.noise[0].information
    off = sampled.off.acceleration[inner] * (weight / one)[..., None]
    acceleration = sampled.force[inner] + off
    weight = sampled.weights.rate[inner]
    own = float(np.mean(weight)) * state.noise[1].information
    off = sampled.off.rate[inner] * (weight / own)[..., None]
    rate = sampled.rate[inner] + off.mean(axis=1)
    return ArrayData(acceleration, np.full(k, one**-0.5), rate, np.eye(3) * own * k)


def _sigma(rests: RestFit, board: Board, request: ArrayRequest) -> tuple[Array, bool]:
    """Sigma of each triad, m/s², and whether a common factor on them is estimated."""
    chosen = request.accelerometer_sigma
    if chosen == "nonlinearity":
        if not np.isfinite(board.accelerometer_range):
            raise Undetermined(
                "the non-linearity rule needs the accelerometers' range",
                remedy="state accelerometer_range (g) in the board file",
            )
        chosen = NON_LINEARITY * board.accelerometer_range
    if chosen == "estimate":
        # In motion the errors are not the noise at rest: one size for all, its factor free.
        return np.full(board.count, 5.0 * float(np.sqrt(np.mean(rests.noise**2)))), True
    return np.full(board.count, float(chosen)), False


def _drawn(
    data: ArrayData, prior: ArrayPrior, request: ArrayRequest, rng: np.random.Generator
) -> ArrayPositions:
    """By the sampler that is asked for, with a word on what the flat prior of ω̇ does: T integrals,
    each worth |J|^-1/2, pull the size to zero by 3 T times its variance."""
    if request.sampler == "pmmh":
        found = _by_pmmh(data, prior, request, rng)
    else:
        found = sample_positions(
            data,
            prior,
            rng,
            chains=request.chains,
            stop=request.stop,
            checkpoint=request.checkpoint,
        )
    if prior.motion != "flat":
        return found
    size, sd = found.scale
    pull = 3.0 * data.samples * (sd / size) ** 2
    word = (
        f"the flat prior on the angular acceleration shrinks the array by about {100 * pull:.2g} % "
        f"of its size, {pull * size / sd:.1f} of its stated sd; --motion-prior learned does not"
    )
    return replace(found, notes=(*found.notes, word))


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
        convergence=checked,
        sampler="pmmh",
        notes=(note,),
    )
    refuse_collapse(positions.mean, chosen.nominal)
    refuse_vague(positions)
    return positions
