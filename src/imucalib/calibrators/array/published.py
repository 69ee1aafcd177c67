"""Positions by paper 001's own procedure: its prior, its noise and its chain on plain samples."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Index
from imucalib.calibrators.array.board.board import Board
from imucalib.calibrators.array.board.moving import Moving, spread_over
from imucalib.calibrators.array.motion.posterior import (
    PositionDraws,
    refuse_collapse,
    refuse_open,
    size_over,
)
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.errors import NotConverged, Undetermined
from imucalib.estimators.array.published import ArrayData, DrawnPrior, run_pmmh
from imucalib.estimators.markov.convergence import convergence

SAMPLES = 2000  # moving samples, where nobody says how many
#: The paper's rule: a data sheet's non-linearity, as a share of the accelerometers' range.
NON_LINEARITY = 0.005
_KEPT = 2000  # draws of a chain that are kept


def draw_as_published(
    moving: Moving, board: Board, request: ArrayRequest, rng: np.random.Generator
) -> PositionDraws:
    """Algorithm 1 of paper 001 on at most `SAMPLES` samples.

    Raises Undetermined where the board file lacks what it needs, or the positions collapse or stay
    open, NotConverged where its chains disagree.
    """
    rows = spread_over(moving.good, min(request.samples or SAMPLES, len(moving.good)))
    data = samples_of(moving, rows, board)
    prior = DrawnPrior(board.drawn, board.prior_sd)
    found = run_pmmh(data, prior, rng, iterations=request.iterations)
    checked = convergence(found.draws)
    if not checked.is_reached(request.stop.rhat, request.stop.ess):
        raise NotConverged(
            f"the chains of Algorithm 1 do not agree after {request.iterations} iterations: "
            f"{checked.sentence}",
            remedy="more --iterations, or leave --as-published out",
        )
    drawn = found.draws[:, :: max(1, request.iterations // _KEPT)]
    notes = [
        f"Algorithm 1: N = {found.monte_carlo}, variance of the log likelihood "
        f"{found.variance:.2g}, burn-in {found.burn_in}"
    ]
    positions = PositionDraws(drawn, found.accepted, checked, "pmmh")
    refuse_collapse(positions.mean, board.drawn)
    refuse_open(positions.mean, positions.covariance, board)
    size, sd = size_over(board.drawn, positions.mean, positions.covariance)
    pull = 3.0 * data.samples * (sd / size) ** 2
    notes.append(
        f"the flat prior on the angular acceleration shrinks the array by about {100 * pull:.2g} % "
        f"of its size, {pull * size / sd:.1f} of its stated sd"
    )
    return PositionDraws(drawn, found.accepted, checked, "pmmh", notes=tuple(notes))


def samples_of(moving: Moving, rows: Index, board: Board) -> ArrayData:
    """Rows of the moving part with the paper's noise: accelerometers by their non-linearity, gyros
    by the scatter of each sample over the triads (equation (30b)).

    Raises Undetermined where the board file does not state the accelerometers' range.
    """
    if not np.isfinite(board.accelerometer_range):
        raise Undetermined(
            "the paper's noise is a share of the accelerometers' range",
            remedy="state accelerometer_range (g) in the board file",
        )
    gyros, rate = moving.gyros, moving.levelled.rate[rows]
    off = rate - rate.mean(axis=1, keepdims=True)
    each = np.einsum("nki,nkj->nij", off, off) / (gyros.triads - 1)
    # What three scattered axes of few gyros show may have no rank.
    doubt = each + 1e-3 * np.trace(gyros.covariance) / 3.0 * np.eye(3)
    sigma = np.full(board.count, NON_LINEARITY * board.accelerometer_range)
    return ArrayData(moving.acceleration[rows], sigma, gyros.mean[rows], np.linalg.inv(doubt))
