"""What the noise may be: points over which every evidence is summed.

    n ~ N(0, s² V),   V = A + Σ_c r_c² N_c N_cᵀ + ρ² K ∘ B Bᵀ

s is integrated out under Jeffreys' prior. A = 1 but while the noise of each axis is sought
(`gram.axis_noise`). A setting's error is shared by rows that were set together: by neighbours of
one dial value, by all rows of one value, or by none; where the order of rows is not that of work,
nobody knows which. A bias that walks goes on through the whole recording:
K(i, j) = exp(-|i - j| / memory), B what a bias does to each number.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.balance import Whitener, below, whitener
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations, SharedNoise
from imucalib.core.references import KnownVector
from imucalib.loop.faults.sheet import in_order
from imucalib.loop.posterior.odds import AS_SET, SETTINGS, WALK_MEMORIES, WALK_SIZES, WALKS

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: Name of the variance component that neighbours in the order of recording share.
NEIGHBOURS = "shared noise"
_JITTER = 1e-9
#: Numbers up to which one dense matrix is quicker than its blocks; numbers that a column of a block
#: holds at most; knots of a walk.
_FEW, _SHARED, _KNOTS = 240, 30, 64


@dataclass(frozen=True)
class Point:
    """One noise: its log prior, and what multiplies each factor; sharing : which of the ways of
    sharing settings; walk : (size, memory in rows) or None"""

    log_prior: float
    ratio: tuple[float, ...]
    sharing: int
    walk: tuple[float, float] | None


@dataclass(frozen=True)
class Covariance:
    """V, whose inverse is never formed: B + G Gᵀ, with what few numbers share in the blocks B, and
    what many share in G, taken off by the identity of Woodbury (1950).

    near : whitens B; wide : (N, k) G, whitened; lower : (k, k) Cholesky factor of 1 + Gᵀ B⁻¹ G
    """

    near: Whitener
    wide: Array
    lower: Array

    @property
    def log_det(self) -> float:
        """log|V|"""
        return float(self.near.log_det + 2.0 * np.log(np.diag(self.lower)).sum())

    def solve(self, columns: Array) -> Array:
        """(N, m) V⁻¹ times columns (N, m)."""
        from scipy.linalg import cho_solve

        white = self.near(columns)
        if self.wide.size:
            inside = cho_solve((self.lower, True), self.wide.T @ white, check_finite=False)
            white = white - self.wide @ inside
        return self.near.back(white)


@dataclass(frozen=True)
class Factor:
    """near, wide : (N, k) columns of a component that few numbers share, and that many"""

    near: csr_array
    wide: Array


@dataclass(frozen=True)
class Terms:
    """ways : of every way of sharing, the factor of each component
    walks : memory -> (N, k) factor of a walk of unit size that forgets after so many rows
    axes : (N, K 3) share of each axis of K triads in a number's variance
    order : (N,) row of each number; points : all that are weighed
    """

    ways: tuple[tuple[Factor, ...], ...]
    walks: Mapping[float, Array]
    axes: Array
    order: Index
    points: tuple[Point, ...]

    def covariance(self, point: Point) -> Covariance:
        """V at a point."""
        own = self.ways[point.sharing]
        wide = [
            m * size for m, size in zip(self._wide(own), self._sizes(point), strict=True) if size
        ]
        near, n = [f.near for f in own], self.order.size
        if sum(m.shape[1] for m in wide) >= n:
            return Covariance(
                whitener((*near, *wide), (*point.ratio, *(1.0 for _ in wide))),
                np.zeros((n, 0)),
                np.zeros((0, 0)),
            )
        white = whitener(near, point.ratio)
        columns = white(np.column_stack([np.zeros((n, 0)), *wide]))
        inner = np.eye(columns.shape[1]) + columns.T @ columns
        return Covariance(white, columns, np.asarray(np.linalg.cholesky(inner)))

    def evidence(
        self,
        points: Sequence[Point],
        free: Array,
        known: Array,
        dof: float,
        lacked: Array,
        power: Array,
    ) -> Array:
        """(P,) log evidence of free columns at some points, but for the priors of their sizes.

        free : (N, p + 1) the columns, and what they shall explain; known : (k, p + 1) what is known
        of them before; dof : that are left; lacked : (N, m) factor of what may be there beside the
        noise; power : (K 3,) variance of each axis' noise beside what is assumed
        """
        scale = np.sqrt(1.0 + self.axes @ (power - 1.0))[:, None]
        logs, groups = np.empty(len(points)), dict[tuple[float, ...], list[int]]()
        for k, point in enumerate(points):
            pairs = zip(self.ways[point.sharing], point.ratio, strict=True)
            key = (point.sharing, *(ratio for f, ratio in pairs if f.near.nnz))
            groups.setdefault(key, []).append(k)
        for group in groups.values():
            first = points[group[0]]
            own = self.ways[first.sharing]
            near = whitener([f.near.multiply(1.0 / scale).tocsr() for f in own], first.ratio)
            wide = [near(m / scale) for m in (*self._wide(own), lacked)]
            inside = _Inside.of(wide, near(free / scale))
            for k in group:
                log_det, rest = inside((*self._sizes(points[k]), 1.0))
                log_det += near.log_det + 2.0 * np.log(scale).sum()
                logs[k] = points[k].log_prior - 0.5 * log_det + _free(rest + known.T @ known, dof)
        return logs

    def _wide(self, own: Sequence[Factor]) -> tuple[Array, ...]:
        return (*(f.wide for f in own), *self.walks.values())

    def _sizes(self, point: Point) -> tuple[float, ...]:
        """Of each of `_wide`."""
        size, memory = point.walk or (0.0, 0.0)
        return (*point.ratio, *(size * (memory == m) for m in self.walks))


@dataclass(frozen=True)
class _Inside:
    """Free columns beside I + Σ size² W Wᵀ at any sizes, by products of whichever is smaller.

    products : (N, N) W Wᵀ of each part and the free columns (N, p), or `gram`, (k + p, k + p)
    products of all columns, and how many columns a part has
    """

    products: tuple[Array, ...]
    free: Array
    gram: Array
    count: tuple[int, ...]

    @staticmethod
    def of(wide: Sequence[Array], free: Array) -> _Inside:
        count = tuple(m.shape[1] for m in wide)
        if sum(count) >= len(free):
            return _Inside(tuple(m @ m.T for m in wide), free, np.zeros((0, 0)), count)
        every = np.column_stack([*wide, free])
        return _Inside((), free, every.T @ every, count)

    def __call__(self, sizes: Sequence[float]) -> tuple[float, Array]:
        """log|I + Σ size² W Wᵀ| and (p, p) products of the free columns beside it."""
        return self._of_numbers(sizes) if self.products else self._of_columns(sizes)

    def _of_numbers(self, sizes: Sequence[float]) -> tuple[float, Array]:
        whole = np.eye(len(self.free))
        for size, square in zip(sizes, self.products, strict=True):
            if size:
                whole += size**2 * square
        lower = np.linalg.cholesky(whole)
        rest = below(lower, self.free)
        return 2.0 * float(np.log(np.diag(lower)).sum()), np.asarray(rest.T @ rest)

    def _of_columns(self, sizes: Sequence[float]) -> tuple[float, Array]:
        every = np.repeat(sizes, self.count)
        used, first = np.flatnonzero(every), every.size
        scale = every[used, None]
        inner = np.eye(used.size) + scale * self.gram[np.ix_(used, used)] * scale.T
        lower = np.linalg.cholesky(inner)
        taken = below(lower, scale * self.gram[used, first:])
        log_det = 2.0 * float(np.log(np.diag(lower)).sum())
        return log_det, np.asarray(self.gram[first:, first:] - taken.T @ taken)


def diagonal_logs(gram: Array, ridge: float) -> Array:
    """(..., p) logs of the diagonal of the Cholesky factor of products (..., p, p), scaled to one
    before a ridge is added, so that no unit matters."""
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 1e-24))
    inner = gram / scale[..., :, None] / scale[..., None, :]
    root = np.linalg.cholesky(inner + ridge * np.eye(scale.shape[-1]))
    return np.asarray(np.log(np.diagonal(root, axis1=-2, axis2=-1)) + np.log(scale))


def _free(gram: Array, dof: float) -> float:
    """Log evidence of columns with flat priors and of the noise factor; gram : (p + 1, p + 1) their
    products and those with the readings, last"""
    size = diagonal_logs(gram, _JITTER)
    return -float(size[:-1].sum() + dof * size[-1])


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
    points = tuple(_points(fit, ways, n))
    memories = {p.walk[1] for p in points if p.walk}
    return Terms(
        ways=tuple(tuple(_parted(m) for m in way) for way in ways),
        walks={memory: _walk(at.owner, bias, memory) for memory in sorted(memories)},
        axes=bias**2,
        order=at.owner,
        points=points,
    )


def _parted(columns: Array) -> Factor:
    """Of few numbers all columns count as shared by many: there is nothing to gain."""
    from scipy.sparse import csr_array

    shared = (columns != 0.0).sum(axis=0) > (_SHARED if len(columns) > _FEW else 0)
    return Factor(csr_array(columns[:, ~shared]), columns[:, shared])


def _walk(order: Index, bias: Array, memory: float) -> Array:
    """(N, k) factor of K ∘ B Bᵀ. A walk is known between knots that are near beside its memory: the
    bridge between them is smaller than the noise (Quiñonero-Candela and Rasmussen 2005)."""
    n = int(order.max()) + 1
    knots = np.linspace(0.0, n - 1.0, min(n, _KNOTS))
    own = np.exp(-np.abs(knots[:, None] - knots) / memory) + _JITTER * np.eye(knots.size)
    lower = np.linalg.cholesky(own)
    course = below(lower, np.exp(-np.abs(knots[:, None] - order) / memory)).T
    return np.asarray((bias[:, :, None] * course[:, None]).reshape(order.size, -1))


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
