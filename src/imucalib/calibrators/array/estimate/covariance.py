"""Covariance of a joint fit that holds whatever the noise's tails are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.estimate.response import information
from imucalib.calibrators.array.estimate.uneven import Uneven, uneven
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.estimators.array.gram import gram, scores
from imucalib.estimators.array.samples import reweighed


def stated_covariance(state: ArrayState) -> Array:
    """(q, q) of the positions (m) and of the terms' coordinates: A⁻¹ B A⁻¹."""
    return _sandwich(state)[0]


def _sandwich(state: ArrayState) -> tuple[Array, Array]:
    """That covariance, and what each sample (inner,) pulls the positions by (m).

    A is what the weights say times how far the scores answer to it (`information`), with the prior
    P; B = Σ g gᵀ + P, g the score of one sample, is what the scores really scatter (Huber 1967,
    White 1982). As many parameters as there are count as samples
    of which B is what A says, so that few samples do not make it singular.
    """
    a, g = information(state)
    base, inner = state.base, state.setup.inner
    told = base.free(gram(reweighed(state.sampled, a, g), base.blocks, inner)).matrix
    prior = np.diag(base.prior)
    own = base.along(scores(state.sampled, base.blocks, inner))
    share = len(inner) / (len(inner) + len(base.prior))
    scatter = share * (own.T @ own) + (1.0 - share) * told + prior
    bread = np.linalg.inv(told + prior)
    found = bread @ scatter @ bread
    return 0.5 * (found + found.T), own @ bread[:, : state.positions]


def with_uneven(state: ArrayState, factor: float) -> tuple[ArrayState, Uneven | None]:
    """The state with that covariance, positions known no better than parts of the motion agree on
    them, and where they do not; factor : how many times fewer samples noise that neighbours share
    leaves."""
    covariance, pulls = _sandwich(state)
    covariance *= factor
    found = uneven(state, pulls, factor)
    if found is not None:
        at = np.arange(state.positions)
        covariance[at, at] += found.spread**2
    return replace(state, covariance=covariance), found
