"""The covariance that positions are stated with, and where parts of a motion do not agree on it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.motion.state import (
    ArrayState,
    measure_dispersion,
    subtract_terms,
)
from imucalib.core.eigen import eigen
from imucalib.estimators.array.noise import weigh
from imucalib.estimators.array.samples import (
    Columns,
    Sampled,
    fit_samples,
    gradient,
    gram,
    inverse_root,
    reweigh,
    scores,
)
from imucalib.posterior.closed_loop.found import Unexplained

#: What is not explained where positions differ, with what the parts differ by.
POSITIONS = "positions against "
_PARTS, _FEWEST = 4, 40  # of a drive other than time, and samples of a part at least
#: Family-wise chance over all coordinates and drives below which positions are not the same.
_ALPHA = 1e-3
_SAMPLES = 800  # at which the answer is measured
_ROUNDS = 12  # of weights and motion after a shift
_SHIFT = 3.0  # in standard deviations of each direction
_LEAST = 0.1  # share that is there in any case
_SEEN = 1e-3  # of the best known direction's information, below which one is not shifted


@dataclass(frozen=True)
class Uneven:
    """follows : what the parts differ by; p : family-wise; nats : of the coordinate that shows it
    most; spread : (d,) m, sd of each coordinate over the parts, beyond chance"""

    follows: str
    p: float
    nats: float
    spread: Array

    @property
    def unexplained(self) -> Unexplained:
        """The same as structure that stays."""
        name = POSITIONS + self.follows
        return Unexplained(name, self.follows, "probe", 1.0 - self.p, self.nats)


def uneven(state: ArrayState, pulls: Array, dispersion: float) -> Uneven | None:
    """By the drive that shows it most; None where chance does as well.

    Each sample pulls the answer by its score. In a part of the motion these pulls add up by chance,
    or by what the part has of its own: a board that bows as it warms up, chips that tilt with the
    rate. Sums of pulls u have variance Σ u² under chance: χ² of each coordinate, and what the
    parts' own places scatter by beyond it.

    pulls : (inner, d) m, what each sample moves the positions by; dispersion : how many times fewer
    samples noise that neighbours share leaves
    """
    from scipy.special import gammaincc

    found, size = [], pulls.shape[1]
    for follows, part in _drives(state):
        square, beyond, freedom = np.zeros(size), np.zeros(size), -1
        for own in (pulls[part == one] for one in np.unique(part)):
            if len(own) < _FEWEST:
                continue
            total, chance = own.sum(axis=0), dispersion * np.sum(own**2, axis=0)
            square += total**2 / chance
            beyond += (total**2 - chance) * len(pulls) / len(own)
            freedom += 1
        if freedom < 1:
            found.append(Uneven(follows, 1.0, 0.0, np.zeros(size)))
            continue
        most = float(square.max())
        p = min(1.0, float(gammaincc(0.5 * freedom, 0.5 * most)) * size)
        spread = np.sqrt(np.maximum(beyond, 0.0))
        found.append(Uneven(follows, p, 0.5 * (most - freedom), spread))
    worst = min(found, key=lambda one: one.p)
    p = worst.p * len(found)
    if p > _ALPHA:
        return None
    spread = np.max([one.spread for one in found if one.p * len(found) <= _ALPHA], axis=0)
    return Uneven(worst.follows, p, worst.nats, spread)


def _drives(state: ArrayState) -> Iterator[tuple[str, Index]]:
    """What could change positions, with the part (inner,) that each sample belongs to."""
    inner, sampled = state.setup.inner, state.sampled
    yield "time", state.setup.block
    for name, vector in (("|ω|", sampled.rate), ("|a|", sampled.origin)):
        size = np.linalg.norm(vector[inner], axis=1)
        ends = np.quantile(size, np.arange(1, _PARTS) / _PARTS)
        yield name, np.searchsorted(ends, size).astype(np.intp)


def information(state: ArrayState) -> tuple[float, float]:
    """What accelerometers and gyros tell over what their weights say, by the answer of the scores
    of positions and of gyro offsets to a shift of these: 1 where the noise is Gaussian.

    Weights (ν + 3)/(ν + d²) fall where a residual grows, so that a score answers a shift of what is
    fitted by less than its weights say: by (ν + 3)/(ν + 5) where residuals are the errors (Lange,
    Little, Taylor 1989, JASA 84). The motion of a sample takes a part of few IMUs' errors and may
    lay one chip's on another, and then the share is another: of four chips less still. So it is
    measured.
    """
    if not any(np.isfinite(noise.freedom) for noise in state.noise):
        return 1.0, 1.0
    inner, r = state.setup.inner, state.r
    rows = inner[np.linspace(0, len(inner) - 1, min(_SAMPLES, len(inner))).astype(np.intp)]
    readings, count = subtract_terms(state).take(rows), 3 * len(r)

    def at(shift: Array, sampled: Sampled) -> Sampled:
        """Weights and motion, fitted anew at a shift (6 K,) of all positions and gyro offsets."""
        moved = readings._replace(rate=readings.rate - shift[count:].reshape(-1, 3))
        for _ in range(_ROUNDS):
            weights = weigh(state.noise, sampled.off, sampled.rate)
            sampled = fit_samples(moved, weights, r + shift[:count].reshape(-1, 3), sampled)
        return sampled

    weights = weigh(state.noise, state.sampled.off.take(rows), state.sampled.rate[rows])
    first = fit_samples(readings, weights, r, state.sampled.rate[rows])
    start = at(np.zeros(2 * count), first)
    every = np.arange(len(rows))

    def columns(found: Sampled) -> list[Columns]:
        """Of all positions and gyro offsets."""
        bases = (np.broadcast_to(x, (len(r), len(rows), 3, 3)) for x in (found.turn, np.eye(3)))
        return [Columns(np.asarray(b), bool(gyro), False) for gyro, b in enumerate(bases)]

    whole = gram(start, columns(start), every).matrix

    def share(which: Index) -> float:
        """Mean over directions that weigh alike, by one shift of all of them and back."""
        own = whole[np.ix_(which, which)]
        values, vectors = eigen(own)
        seen = values > _SEEN * float(values[-1])
        signs = np.where(np.arange(int(seen.sum())) % 2, -1.0, 1.0)
        shift = np.zeros(2 * count)
        shift[which] = _SHIFT * (vectors[:, seen] / np.sqrt(values[seen])) @ signs
        less, more = at(-shift, start), at(shift, start)
        one, two = (gradient(found, columns(found), every) for found in (less, more))
        answer = 0.5 * (one - two)
        size = shift[which] @ own @ shift[which]
        return float(np.clip(shift @ answer / size, _LEAST, 1.0))

    return share(np.arange(3, count)), share(np.arange(count, 2 * count))


def sandwich(state: ArrayState) -> tuple[Array, Array, Array]:
    """(q, q) covariance A⁻¹ B A⁻¹ of the positions (m) and of the terms' coordinates, A⁻¹ itself,
    and what each sample (inner,) pulls the positions by (m).

    A is what the weights say times how far the scores answer to it (`information`), with the prior
    P; B = Σ g gᵀ + P, g the score of one sample, is what the scores really scatter (Huber 1967,
    White 1982). As many parameters as there are count as samples of which B is what A says, so that
    few samples do not make it singular.
    """
    base, inner = state.base, state.setup.inner
    known = base.multiply(reweigh(state.sampled, *information(state)), inner)
    prior = np.diag(base.prior)
    own = scores(state.sampled, base.blocks, inner) @ base.turn
    share = len(inner) / (len(inner) + len(base.prior))
    scatter = share * (own.T @ own) + (1.0 - share) * known.matrix + prior
    bread = np.asarray(np.linalg.inv(known.matrix + prior))
    found = bread @ scatter @ bread
    return 0.5 * (found + found.T), bread, own @ bread[:, : state.positions]


def sd_of_few(state: ArrayState, count: int) -> Array:
    """(3,) m, median over the IMUs of the sd that so many evenly chosen samples leave, whose noise
    is what was fitted."""
    base, inner = state.base, state.setup.inner
    rows = inner[np.linspace(0, len(inner) - 1, count).astype(np.intp)]
    known = base.multiply(state.sampled, rows).matrix + np.diag(base.prior)
    variance = np.sum(inverse_root(known)[: state.positions] ** 2, axis=1)
    return np.asarray(np.sqrt(np.median(variance.reshape(-1, 3), axis=0)))


def add_unevenness(
    state: ArrayState, shifts: Iterable[Array] = ()
) -> tuple[ArrayState, Uneven | None]:
    """The state with that covariance, of as many fewer samples as noise that neighbours share
    leaves; positions known no better than parts of the motion agree on them, nor than by what moves
    them and is not corrected; and where the parts do not agree.

    shifts : (d,) m each, of what is not corrected
    """
    factor = measure_dispersion(state, gyro=False)
    covariance, by_noise, pulls = sandwich(state)
    covariance *= factor
    found, own = uneven(state, pulls, factor), np.arange(state.positions)
    if found is not None:
        covariance[own, own] += found.spread**2
    for moved in shifts:
        covariance[: len(own), : len(own)] += np.outer(moved, moved)
    return replace(state, covariance=covariance, by_noise=by_noise), found
