"""What the noise may be: points over which every evidence is summed.

    n ~ N(0, s² V),   V = A + Σ_c r_c² N_c N_cᵀ + ρ² K ∘ B Bᵀ

s is integrated out under Jeffreys' prior. A = 1 but while the noise of each axis is sought
(`gram.axis_noise`). A setting's error is shared by rows that were set together: by neighbours of
one dial value, by all rows of one value, or by none; where the order of rows is not that of work,
nobody knows which. A bias that walks goes on through the whole recording:
K(i, j) = exp(-|i - j| / memory), B what a bias does to each number.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations, SharedNoise
from imucalib.core.references import KnownVector
from imucalib.loop.faults.sheet import in_order
from imucalib.loop.posterior.odds import AS_SET, SETTINGS, WALK_MEMORIES, WALK_SIZES, WALKS

#: Name of the variance component that neighbours in the order of recording share.
NEIGHBOURS = "shared noise"
_JITTER = 1e-9


@dataclass(frozen=True)
class Point:
    """One noise: its log prior, and its covariance as what multiplies each of `Terms.grams` and the
    walk; sharing : which of the ways of sharing settings; walk : (size, memory in rows) or None"""

    log_prior: float
    ratio: tuple[float, ...]
    sharing: int
    walk: tuple[float, float] | None


@dataclass(frozen=True)
class Terms:
    """grams : of every way of sharing, N_c N_cᵀ (N, N) of each component
    bias : (N, N) B Bᵀ; axes : (N, K 3) share of each axis of K triads in a number's variance
    order : (N,) row of each number; points : all that are weighed"""

    grams: tuple[tuple[Array, ...], ...]
    bias: Array
    axes: Array
    order: Index
    points: tuple[Point, ...]

    def covariance(self, point: Point, power: Array | float = 1.0) -> Array:
        """(N, N) V; power : (K 3,) variance of each axis' noise beside what is assumed"""
        whole = np.diag(1.0 + self.axes @ (power - np.ones(self.axes.shape[1])))
        for ratio, gram in zip(point.ratio, self.grams[point.sharing], strict=True):
            if ratio:
                whole += ratio**2 * gram
        if point.walk is not None:
            size, memory = point.walk
            apart = np.abs(self.order[:, None] - self.order)
            whole += size**2 * np.exp(-apart / memory) * self.bias
        return whole


def shared_bias(data: Observations, memory: float) -> SharedNoise:
    """The walk as a variance component of a fit, whose size the fit estimates.

    memory : observations, in their order, after which it forgets
    """
    order = np.argsort(np.argsort(data.context["order"], kind="stable")).astype(float)
    apart = np.abs(order[:, None] - order)
    correlation = np.exp(-apart / memory) + _JITTER * np.eye(data.n)
    return SharedNoise(NEIGHBOURS, np.linalg.cholesky(correlation), memory)


def terms_of(fit: Fit) -> Terms:
    """All noises that a fit's observations may have."""
    at, n = fit.at, fit.observations.n
    ways = tuple(_sharings(fit))
    unit = np.broadcast_to(np.eye(3), (n, 1, 3, 3)) * float(np.median(at.sigma))
    triads = at.sigma.shape[1] // 3
    each = []
    for k in range(triads):
        block = np.zeros((n, triads, 3, 3))
        block[:, k] = unit[:, 0]
        each.append(at.columns(block))
    bias = np.concatenate(each, axis=1)
    grams = tuple(tuple(m @ m.T for m in way) for way in ways)
    points = tuple(_points(fit, ways, n))
    return Terms(grams, bias @ bias.T, bias**2, at.owner, points)


def _sharings(fit: Fit) -> Iterator[tuple[Array, ...]]:
    """Of every way of sharing settings the matrices N_c of all components, as set first."""
    at, reference = fit.at, fit.observations.reference
    yield at.settings
    if not isinstance(reference, KnownVector) or not at.free:
        return
    each = [m.sum(axis=1) for m in at.settings[: at.free]]  # one column is a row's own
    told = [reference.inclination_setting, reference.tool_face_setting]
    values = [np.round(reference.inclination, 9), np.round(reference.tool_face, 9)]
    seen = [tuple(map(bytes, told))]
    for ids in ([_numbered(v) for v in values], [np.arange(reference.n)] * 2):
        if tuple(map(bytes, ids)) not in seen:
            seen.append(tuple(map(bytes, ids)))
            own = [_spread(m, i[at.owner]) for m, i in zip(each, ids, strict=True)]
            yield (*own, *at.settings[at.free :])


def _numbered(values: Array) -> Index:
    return np.asarray(np.unique(values, return_inverse=True)[1], np.intp)


def _spread(column: Array, ids: Index) -> Array:
    matrix = np.zeros((column.size, int(ids.max()) + 1))
    matrix[np.arange(column.size), ids] = column
    return matrix


def _points(fit: Fit, ways: tuple[tuple[Array, ...], ...], n: int) -> Iterator[Point]:
    levels = [list(_levels(fit, c)) for c in range(len(fit.at.settings))]
    walks: list[tuple[tuple[float, float] | None, float]] = [(None, 1.0)]
    if "order" in fit.observations.context and n > 8:
        sizes = [(s, max(m * n, 1.5)) for s in WALK_SIZES for m in WALK_MEMORIES]
        walks = [(None, 1.0 - WALKS), *((w, WALKS / len(sizes)) for w in sizes)]
    shared = _ways_prior(fit, len(ways))
    for way in range(len(ways)):
        for picked in product(*levels):
            some = any(r for r, _ in picked[: fit.at.free])
            if way and not some:  # without scatter there is nothing to share
                continue
            for walk, share in walks:
                weight = np.log(share * (shared[way] if some else 1.0)) + sum(w for _, w in picked)
                yield Point(float(weight), tuple(r for r, _ in picked), way, walk)


def _ways_prior(fit: Fit, ways: int) -> Array:
    """(ways,) prior of every way of sharing settings: as set, where the rows stand in an order of
    work; else nobody knows."""
    reference = fit.observations.reference
    if ways == 1 or not isinstance(reference, KnownVector):
        return np.full(ways, 1.0 / ways)
    if not in_order(reference.inclination, reference.tool_face):
        return np.full(ways, 1.0 / ways)
    return np.array([AS_SET, *np.full(ways - 1, (1.0 - AS_SET) / (ways - 1))])


def _levels(fit: Fit, component: int) -> Iterator[tuple[float, float]]:
    """(ratio, log prior) of one component: of a setting its largest effect on a reading in steps;
    of what sessions share as the base model has it, which takes no part in the search."""
    at, prior = fit.at, fit.observations.noise_prior
    if component >= at.free:
        yield fit.noise.ratio[component], 0.0
        return
    reach = float(np.abs(at.settings[component]).max(initial=0.0)) or 1.0
    ratios = np.array(SETTINGS) / reach
    if prior is None:
        for ratio in ratios:
            yield float(ratio), -float(np.log(ratios.size))
        return
    edges = np.sqrt(ratios[1:] * np.maximum(ratios[:-1], ratios[1:] / 9.0))
    below = np.concatenate(
        [[0.0], 2.0 / np.pi * np.arctan(edges * fit.noise.factor / prior.setting), [1.0]]
    )
    for ratio, mass in zip(ratios, np.diff(below), strict=True):
        yield float(ratio), float(np.log(max(mass, 1e-12)))
