"""What the noise may be: points over which every evidence is summed.

    n ~ N(0, s² V),   V = A + Σ_c r_c² N_c N_cᵀ + ρ² K ∘ B Bᵀ

s is integrated out under Jeffreys' prior. A = 1 but while the noise of each axis is sought
(`explored.Start.axis_noise`). A setting's error is shared by rows that were set together: by
neighbours of one dial value, by all rows of one value, or by none; where the order of rows is not
that of work, nobody knows which. A bias that walks goes on through the whole recording:
K(i, j) = exp(-|i - j| / memory), B what a bias does to each number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.balance import SettingBlocks, Whitener, below, whitener
from imucalib.core.fit import Fit
from imucalib.core.observations import BIAS, Observations, SharedNoise
from imucalib.core.references import KnownVector
from imucalib.posterior.odds import (
    AS_SET,
    BETWEEN,
    SETTINGS,
    WALK_MEMORIES,
    WALK_SIZES,
    WALKS,
)
from imucalib.posterior.search.problem import Problem
from imucalib.posterior.sheet.sheet import in_order

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: Name of the variance component that neighbours in the order of recording share.
NEIGHBOURS = "shared noise"
_JITTER = 1e-9
#: Numbers up to which one dense matrix is quicker than its blocks; numbers that a column of a block
#: holds at most; knots of a walk.
_FEW, _SHARED, _KNOTS = 240, 30, 64


@dataclass(frozen=True)
class NoiseHypothesis:
    """One noise: its log prior, and what multiplies each factor; sharing : how settings are
    shared; walk : (size, memory in rows) or None"""

    log_prior: float
    ratio: tuple[float, ...]
    sharing: int
    walk: tuple[float, float] | None


@dataclass(frozen=True)
class WideCovariance:
    """V = B + G Gᵀ of a B that is quickly solved and a G of few columns; V⁻¹ is never formed
    (Woodbury 1950).

    weigh : of columns (N, m) B⁻¹ times them; base_log_det : log|B|; wide : (N, k) G
    weighted : (N, k) B⁻¹ G; lower : (k, k) Cholesky factor of 1 + Gᵀ B⁻¹ G
    """

    weigh: Callable[[Array], Array]
    base_log_det: float
    wide: Array
    weighted: Array
    lower: Array

    @staticmethod
    def of(weigh: Callable[[Array], Array], base_log_det: float, wide: Array) -> WideCovariance:
        """By its two parts; wide : (N, k), k may be none."""
        weighted = weigh(wide) if wide.size else wide
        inner = np.eye(wide.shape[1]) + wide.T @ weighted
        lower = np.asarray(np.linalg.cholesky(inner))
        return WideCovariance(weigh, base_log_det, wide, weighted, lower)

    @property
    def log_det(self) -> float:
        """log|V|"""
        return float(self.base_log_det + 2.0 * np.log(np.diag(self.lower)).sum())

    def solve(self, columns: Array) -> Array:
        """(N, m) V⁻¹ times columns (N, m)."""
        from scipy.linalg import cho_solve

        found = self.weigh(columns)
        if self.wide.size:
            inside = cho_solve((self.lower, True), self.wide.T @ found, check_finite=False)
            found = found - self.weighted @ inside
        return np.asarray(found)


@dataclass(frozen=True)
class Factor:
    """few, many : (N, k) columns of a component that few numbers share, and that many"""

    few: csr_array
    many: Array


@dataclass(frozen=True)
class Terms:
    """sharings : of how settings may be shared, the factor of each component
    walks : memory -> (N, k) factor of a walk of unit size that forgets after so many rows
    axes : (N, K 3) share of each axis of K triads in a number's variance
    order : (N,) row of each number; points : all that are weighed
    base : (N, p + 1) the base model's columns and the misfit; known : (k, p + 1) what is known of
        them before the readings; dof : degrees of freedom beside the base model
    """

    sharings: tuple[tuple[Factor, ...], ...]
    walks: Mapping[float, Array]
    axes: Array
    order: Index
    points: tuple[NoiseHypothesis, ...]
    base: Array
    known: Array
    dof: float

    def covariance(self, point: NoiseHypothesis) -> WideCovariance:
        """V at a point: what few numbers share stands in blocks, beside what many do."""
        n, blocks = self.order.size, self._settings(point)
        wide = [size * factor for size, factor in self._wide(point) if size]
        if sum(m.shape[1] for m in wide) >= n:
            few = [f.few for f in self.sharings[point.sharing]]
            blocks = whitener((*few, *wide), (*point.ratio, *(1.0 for _ in wide)))
            wide = []
        every = np.column_stack([np.zeros((n, 0)), *wide])
        return WideCovariance.of(blocks.weigh, blocks.log_det, every)

    def evidence(
        self, points: Sequence[NoiseHypothesis], lacked: Array, power: Array | None = None
    ) -> Array:
        """(P,) log evidence of the base model at some points, but for priors of sizes.

        lacked : (N, m) factor of what may be there beside the noise; power : (K 3,) variance of
        each axis' noise over what is assumed
        """
        power = np.ones(self.axes.shape[1]) if power is None else power
        scale = np.sqrt(1.0 + self.axes @ (power - 1.0))[:, None]
        plain = bool(np.all(power == 1.0))
        logs = np.empty(len(points))
        for group in self._same_blocks(points):
            first = points[group[0]]
            blocks = self._settings(first, None if plain else scale[:, 0])
            sizes = np.array([[s for s, _ in self._wide(points[k])] for k in group])
            used = np.flatnonzero(sizes.any(axis=0))
            every = self._wide(first)
            wide = [every[j][1] for j in used]
            factors = [blocks(m / scale) for m in (*wide, lacked)]
            inside = _Inside.of(factors, blocks(self.base / scale))
            for k, own in zip(group, sizes[:, used], strict=True):
                log_det, rest = inside((*own, 1.0))
                log_det += blocks.log_det + 2.0 * float(np.log(scale).sum())
                flat = _flat_evidence(rest + self.known.T @ self.known, self.dof)
                logs[k] = points[k].log_prior - 0.5 * log_det + flat
        return logs

    def _settings(self, point: NoiseHypothesis, scale: Array | None = None) -> Whitener:
        """Of what few numbers share at a point; scale : (N,) that each number is divided by"""
        pairs = enumerate(zip(self.sharings[point.sharing], point.ratio, strict=True))
        used = tuple(c for c, (f, ratio) in pairs if ratio and f.few.nnz)
        key = point.sharing, used
        if used and key not in self._blocks:
            few = [self.sharings[point.sharing][c].few for c in used]
            self._blocks[key] = SettingBlocks.of(few)
        if not used:
            return Whitener((), 0.0)
        return self._blocks[key].whitener([point.ratio[c] for c in used], scale)

    @cached_property
    def _blocks(self) -> dict[tuple[int, tuple[int, ...]], SettingBlocks]:
        """Of settings that scatter, made when first asked for."""
        return {}

    def _same_blocks(self, points: Sequence[NoiseHypothesis]) -> Iterable[list[int]]:
        """Points by what few numbers share in them, which is whitened once."""
        groups = dict[tuple[float, ...], list[int]]()
        for k, point in enumerate(points):
            pairs = zip(self.sharings[point.sharing], point.ratio, strict=True)
            key = (point.sharing, *(ratio for f, ratio in pairs if f.few.nnz))
            groups.setdefault(key, []).append(k)
        return groups.values()

    def _wide(self, point: NoiseHypothesis) -> list[tuple[float, Array]]:
        """What many numbers share, (N, k) each, and its size at a point."""
        own = zip(point.ratio, (f.many for f in self.sharings[point.sharing]), strict=True)
        size, memory = point.walk or (0.0, 0.0)
        return [*own, *((size * (memory == m), factor) for m, factor in self.walks.items())]


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
        if self.products:
            whole = np.eye(len(self.free))
            for size, square in zip(sizes, self.products, strict=True):
                whole += size**2 * square
            lower = np.linalg.cholesky(whole)
            rest = below(lower, self.free)
            left = rest.T @ rest
        else:
            every = np.repeat(sizes, self.count)
            used, first = np.flatnonzero(every), every.size
            scale = every[used, None]
            inner = np.eye(used.size) + scale * self.gram[np.ix_(used, used)] * scale.T
            lower = np.linalg.cholesky(inner)
            removed = below(lower, scale * self.gram[used, first:])
            left = self.gram[first:, first:] - removed.T @ removed
        return 2.0 * float(np.log(np.diag(lower)).sum()), np.asarray(left)


def diagonal_logs(gram: Array, ridge: float) -> Array:
    """(..., p) logs of the diagonal of the Cholesky factor of products (..., p, p), scaled to one
    before a ridge is added, so that no unit matters."""
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 1e-24))
    inner = gram / scale[..., :, None] / scale[..., None, :]
    root = np.linalg.cholesky(inner + ridge * np.eye(scale.shape[-1]))
    return np.asarray(np.log(np.diagonal(root, axis1=-2, axis2=-1)) + np.log(scale))


def _flat_evidence(gram: Array, dof: float) -> float:
    """Log evidence of columns with flat priors and of the noise factor; gram : (p + 1, p + 1) their
    products and those with the readings, last"""
    size = diagonal_logs(gram, _JITTER)
    return -float(size[:-1].sum() + dof * size[-1])


def make_bias_walk(data: Observations, memory: float) -> SharedNoise:
    """The walk as a variance component of a fit, whose size the fit estimates.

    memory : observations, in their order, after which it forgets
    """
    order = np.argsort(np.argsort(data.context["order"], kind="stable")).astype(float)
    apart = np.abs(order[:, None] - order)
    correlation = np.exp(-apart / memory) + _JITTER * np.eye(data.n)
    return SharedNoise(NEIGHBOURS, np.linalg.cholesky(correlation), memory)


def terms_of(problem: Problem) -> Terms:
    """All noises that a problem's observations may have."""
    fit, numbers = problem.fit, len(problem.fit.at.owner)
    at, n, triads = fit.at, fit.observations.n, fit.at.sigma.shape[1] // 3
    each = np.eye(3 * triads).reshape(triads, 3, -1) * float(np.median(at.sigma))
    bias = at.columns(np.broadcast_to(each, (n, *each.shape)))
    sharings = tuple(_sharings(fit))
    points = tuple(_points(fit, len(sharings), n))
    memories = {p.walk[1] for p in points if p.walk}
    base = problem.columns[:, [*range(problem.base), -1]]
    return Terms(
        sharings=tuple(tuple(_part(m) for m in way) for way in sharings),
        walks={memory: _walk(at.owner, bias, memory) for memory in sorted(memories)},
        axes=bias**2,
        order=at.owner,
        points=points,
        base=base[:numbers],
        known=base[numbers:],
        dof=problem.numbers - problem.base,
    )


def _part(columns: Array) -> Factor:
    """Of few numbers all columns count as shared by many: there is nothing to gain."""
    from scipy.sparse import csr_array

    shared = (columns != 0.0).sum(axis=0) > (_SHARED if len(columns) > _FEW else 0)
    return Factor(csr_array(columns[:, ~shared]), columns[:, shared])


def _walk(order: Index, bias: Array, memory: float) -> Array:
    """(N, k) factor of K ∘ B Bᵀ. A walk is known between knots that are close beside its memory:
    the bridge between them is smaller than the noise (Quiñonero-Candela and Rasmussen 2005)."""
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
    values = [np.round(reference.inclination, 9), np.round(reference.tool_face, 9)]
    equal = [np.unique(v, return_inverse=True)[1].astype(np.intp) for v in values]
    seen = [tuple(map(bytes, (reference.inclination_setting, reference.tool_face_setting)))]
    for ids in (equal, [np.arange(reference.n)] * 2):
        if tuple(map(bytes, ids)) not in seen:
            seen.append(tuple(map(bytes, ids)))
            own = [
                column[:, None] * np.eye(int(i.max()) + 1)[i[at.owner]]
                for column, i in zip(each, ids, strict=True)
            ]
            yield (*own, *at.settings[at.free :])


def _points(fit: Fit, sharings: int, n: int) -> Iterator[NoiseHypothesis]:
    levels = [list(_levels(fit, c)) for c in range(len(fit.at.settings))]
    walks: list[tuple[tuple[float, float] | None, float]] = [(None, 1.0)]
    if "order" in fit.observations.context and n > 8:
        sizes = [(s, max(m * n, 1.5)) for s in WALK_SIZES for m in WALK_MEMORIES]
        walks = [(None, 1.0 - WALKS), *((w, WALKS / len(sizes)) for w in sizes)]
    shared = _sharing_prior(fit, sharings)
    for way in range(sharings):
        for picked in product(*levels):
            some = any(r for r, _ in picked[: fit.at.free])
            if way and not some:  # without scatter there is nothing to share
                continue
            for walk, share in walks:
                weight = np.log(share * (shared[way] if some else 1.0)) + sum(w for _, w in picked)
                yield NoiseHypothesis(float(weight), tuple(r for r, _ in picked), way, walk)


def between_temperatures(data: Observations) -> bool:
    """Whether sessions have temperatures, whose law may be what their biases differ by."""
    return bool(data.of_sessions) and "temperature" in data.context


def _sharing_prior(fit: Fit, sharings: int) -> Array:
    """(sharings,) prior of how settings are shared: as set, where the rows are in an order of work;
    else nobody knows."""
    reference = fit.observations.reference
    even = np.full(sharings, 1.0 / sharings)
    if sharings == 1 or not isinstance(reference, KnownVector):
        return even
    if not in_order(reference.inclination, reference.tool_face):
        return even
    return np.array([AS_SET, *np.full(sharings - 1, (1.0 - AS_SET) / (sharings - 1))])


def _levels(fit: Fit, component: int) -> Iterator[tuple[float, float]]:
    """(ratio, log prior) of one component: of a setting its largest effect on a reading in steps;
    of what sessions share as the base model has it, of a bias less where a law may be all of it."""
    at, prior = fit.at, fit.observations.noise_prior
    if component >= at.free:
        law = at.component[component] == BIAS and between_temperatures(fit.observations)
        shares = BETWEEN if law else BETWEEN[:1]
        for share in shares.tolist():
            yield share * fit.noise.ratio[component], -float(np.log(shares.size))
        return
    reach = float(np.abs(at.settings[component]).max(initial=0.0)) or 1.0
    ratios = np.array(SETTINGS) / reach
    mass = np.full(ratios.size, 1.0 / ratios.size)
    if prior is not None:
        edges = np.sqrt(ratios[1:] * np.maximum(ratios[:-1], ratios[1:] / 9.0))
        smaller = 2.0 / np.pi * np.arctan(edges * fit.noise.factor / prior.setting)
        mass = np.maximum(np.diff([0.0, *smaller, 1.0]), 1e-12)
    yield from zip(ratios.tolist(), np.log(mass).tolist(), strict=True)
