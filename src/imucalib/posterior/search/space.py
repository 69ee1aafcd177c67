"""The posterior over sets of components: every set near the best is opened and scored.

The evidence of a set is the sum over its members, their sizes and all noises, each with its prior:

    log L = -½ log|V| - ½ log|1 + τ² CᵀPC| - ν/2 log RSS

What other members and sizes of a component add to its best is carried along as one number, so that
the evidence of a set does not depend on the order in which it was built.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.eigen import eigen
from imucalib.posterior.odds import BEAMS, DEEPEST, OPEN, SHORT_LIST, WIDTH
from imucalib.posterior.search.catalogue import log_set_prior, log_size_prior
from imucalib.posterior.search.gram import Block, Grams, log_sum, marginalize
from imucalib.posterior.search.problem import Choice, Contest

#: Columns up to which a block is narrow.
NARROW = 20
#: Numbers of blocks that are worked on at once.
_AT_ONCE = 1 << 21
#: What rounding may take from the diagonal of a wide block.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Pick:
    """A member of a component and its size over the noise factor."""

    choice: int
    size: float


def blocks_of(choices: Sequence[Choice], picks: Sequence[Pick]) -> list[Block]:
    """The columns and the size of each pick."""
    return [(choices[p.choice].at, p.size) for p in picks]


@dataclass(frozen=True)
class Hypothesis:
    """A set of components.

    components : which, sorted; picks : its likeliest members and sizes
    evidence, prior : logs; added : of each pick, nats of the evidence that its prior and the other
        members and sizes of its component add
    """

    components: tuple[int, ...]
    picks: tuple[Pick, ...]
    evidence: float
    prior: float
    added: tuple[float, ...] = ()

    @property
    def log_posterior(self) -> float:
        return self.evidence + self.prior


@dataclass(frozen=True)
class Posterior:
    """hypotheses : likeliest first; probability : of each; grams : at the noises that count
    evidence : log of all that they explain together"""

    hypotheses: tuple[Hypothesis, ...]
    probability: Array
    grams: Grams
    dof: float
    evidence: float

    @property
    def weighed(self) -> list[tuple[Hypothesis, float]]:
        """Each set and its probability."""
        return list(zip(self.hypotheses, self.probability.tolist(), strict=True))

    @property
    def base(self) -> Hypothesis:
        """That nothing is missing."""
        return next(h for h in self.hypotheses if not h.components)


#: Sets by their components, each at its likeliest picks.
_Found = dict[tuple[int, ...], Hypothesis]


def search(
    problem: Contest, grams: Grams, *, beams: tuple[int, ...] = BEAMS, deepest: int = DEEPEST
) -> Posterior:
    """The posterior over sets of components by a beam search; beams : sets that are opened at each
    depth."""
    space = _Space(problem, grams)
    nothing = space.hypothesis((), (), space.base)
    found: _Found = {(): nothing}
    level = [nothing]
    for depth in range(deepest):
        born: _Found = {}
        for one in level:
            _keep(born, (h for h in space.expand(one) if h.components not in found))
        top = _likeliest_first(born)
        best = max(h.log_posterior for h in found.values())
        found.update({h.components: h for h in top[:SHORT_LIST]})
        if not top or top[0].log_posterior < best - OPEN / 3.0:
            break
        bar = max(best, top[0].log_posterior) - OPEN
        width = beams[min(depth, len(beams) - 1)]
        level = [h for h in top[:width] if h.log_posterior > bar]
    return space.posterior(found)


def hill_climb(problem: Contest, grams: Grams, start: Sequence[Pick] = ()) -> Posterior:
    """The posterior by opening the likeliest sets: everything beside each, and then everything in
    the place of each of its components, until none of the likeliest is new. Where sets are large, a
    beam from nothing goes a long way; start : picks of a set that is likely."""
    space, found, opened = _Space(problem, grams), _Found(), set[tuple[tuple[Pick, ...], bool]]()

    def keep(picks: tuple[Pick, ...], added: tuple[float, ...], *, open_it: bool) -> None:
        own = marginalize(space.base, *blocks_of(problem.choices, picks))
        one = space.hypothesis(picks, added, own)
        _keep(found, (one, *(space.expand(one, own) if open_it else ())))

    keep((), (), open_it=bool(start))
    if start:
        prior = log_size_prior(problem.sizes)
        level = [int(np.argmin(np.abs(np.log(problem.sizes / p.size)))) for p in start]
        weight = [problem.choices[p.choice].log_weight for p in start]
        added = tuple(float(prior[k]) + w for k, w in zip(level, weight, strict=True))
        keep(tuple(start), added, open_it=False)
    while True:
        top = _likeliest_first(found)[:WIDTH]
        steps = ((h, shorter) for h in top for shorter in (False, True))
        new = next(((h, s) for h, s in steps if (h.picks, s) not in opened), None)
        if new is None:
            return space.posterior(found)
        one, shorter = new
        opened.add((one.picks, shorter))
        # The whole set, or it without each of its components.
        for k in range(len(one.picks)) if shorter else (len(one.picks),):
            picks = one.picks[:k] + one.picks[k + 1 :]
            keep(picks, one.added[:k] + one.added[k + 1 :], open_it=True)


def _keep(found: _Found, some: Iterator[Hypothesis] | Sequence[Hypothesis]) -> None:
    """Of equal components the likelier picks stay."""
    for one in some:
        old = found.get(one.components)
        if old is None or one.evidence > old.evidence:
            found[one.components] = one


def _likeliest_first(found: Mapping[tuple[int, ...], Hypothesis]) -> list[Hypothesis]:
    return sorted(found.values(), key=lambda h: -h.log_posterior)


class _Space:
    """Sets of a problem's components at its products; base : these with the base integrated out."""

    def __init__(self, problem: Contest, grams: Grams) -> None:
        self.base = marginalize(grams, problem.flat)
        self._problem, self._grams = problem, grams
        self._dof = grams.numbers - problem.base
        self._component = np.array([c.component for c in problem.choices], dtype=int)
        self._weight = np.array([c.log_weight for c in problem.choices])
        # Members by the width of their columns: which, index (m, w), and the products of all data.
        widths = np.array([c.at.size for c in problem.choices], dtype=int)
        self._by_width = list[tuple[Index, Index, Array]]()
        for width in np.unique(widths):
            which = np.flatnonzero(widths == width)
            index = np.array([problem.choices[int(j)].at for j in which])
            self._by_width.append((which, index, grams.products.blocks(index)))

    def hypothesis(
        self, picks: tuple[Pick, ...], added: tuple[float, ...], own: Grams
    ) -> Hypothesis:
        """A set at its picks; own : the products beside them."""
        problem = self._problem
        key = tuple(sorted(problem.choices[p.choice].component for p in picks))
        prior = log_set_prior(problem.odds, key)
        return Hypothesis(key, picks, own.evidence(self._dof) + sum(added), prior, added)

    def expand(self, one: Hypothesis, own: Grams | None = None) -> Iterator[Hypothesis]:
        """Every set with one component more; own : the products beside this one, if there are."""
        problem = self._problem
        own = own or marginalize(self.base, *blocks_of(problem.choices, one.picks))
        score, raw = self._scores(own)
        for component in np.setdiff1d(self._component, one.components):
            rows = np.flatnonzero(self._component == component)
            total = float(log_sum(score[rows].ravel()))
            if not np.isfinite(total):
                continue
            a, b = np.unravel_index(np.argmax(score[rows]), (rows.size, problem.sizes.size))
            key = tuple(sorted((*one.components, int(component))))
            yield Hypothesis(
                components=key,
                picks=(*one.picks, Pick(int(rows[a]), float(problem.sizes[b]))),
                evidence=total + sum(one.added),
                prior=log_set_prior(problem.odds, key),
                added=(*one.added, total - float(raw[rows[a], b])),
            )

    def _scores(self, grams: Grams) -> tuple[Array, Array]:
        """(M, T) log evidence of each member at each size, over all noises, with the priors of
        member and size and without."""
        sizes = self._problem.sizes
        out = np.full((2, self._weight.size, sizes.size), -np.inf)
        for which, index, whole in self._by_width:
            logs, factor = block_logs(grams, index, sizes, self._dof, whole)
            weighed = log_sum(logs + log_size_prior(sizes * factor))
            out[0, which] = weighed + self._weight[which, None]
            out[1, which] = log_sum(logs)
        return out[0], out[1]

    def posterior(self, found: _Found) -> Posterior:
        """Of all sets that were found."""
        ranked = _likeliest_first(found)
        logs = np.array([h.log_posterior for h in ranked])
        whole = float(log_sum(logs))
        return Posterior(tuple(ranked), np.exp(logs - whole), self._grams, self._dof, whole)


def block_logs(
    grams: Grams, index: Index, size: Array, dof: float, whole: Array | None = None
) -> tuple[Array, Array]:
    """(E, m, T) log evidence of each block of columns index (m, w) at each size (T,) over the noise
    factor, and that factor; whole : the blocks' own products, where they are there."""
    by_factors = index.shape[1] > NARROW or size.size == 1
    logs, factor = np.empty((2, len(grams.log_weight), len(index), size.size))
    step = max(1, _AT_ONCE // (len(grams.log_weight) * index.shape[1] ** 2))
    for a in range(0, len(index), step):
        part = slice(a, a + step)
        inner = grams.blocks(index[part], None if whole is None else whole[:, part])
        own, explained = (_by_factors if by_factors else _by_values)(
            grams, inner, grams.along[:, index[part]], size
        )
        rest = np.maximum(grams.power[:, None, None] - explained, 1e-9)
        logs[:, part] = own + grams.log_weight[:, None, None] + grams.log_noise(rest, dof)
        factor[:, part] = np.sqrt(rest / dof)
    return logs, factor


def _by_values(grams: Grams, inner: Array, along: Array, size: Array) -> tuple[Array, Array]:
    """(E, m, T) -½ log|1 + τ² A| and aᵀ (A + 1/τ²)⁻¹ a of blocks A and products a with y, by the
    eigenvalues of A, which serve all sizes."""
    if inner.shape[2] == 1:
        values = inner[..., 0]
    else:
        values, vectors = eigen(inner)
        along = np.einsum("emij,emi->emj", vectors, along)
    values, square = np.maximum(values, 0.0), size**2
    explained = along[..., None] ** 2 / (values[..., None] + 1.0 / square)
    return -0.5 * np.log1p(values[..., None] * square).sum(axis=2), explained.sum(axis=2)


def _by_factors(grams: Grams, inner: Array, along: Array, size: Array) -> tuple[Array, Array]:
    """The same of wide blocks, or for one size, by Cholesky factors, which are quicker there."""
    e, m, w, _ = inner.shape
    logs, explained = np.empty((2, e, m, size.size))
    whole = np.empty((e, m, w + 1, w + 1))
    whole[..., :w, :w], whole[..., w, :w], whole[..., :w, w] = inner, along, along
    whole[..., w, w] = 2.0 * grams.power[:, None] + 1.0  # any number above what is explained serves
    some = np.arange(w)
    values = inner[..., some, some]
    for t, tau in enumerate(size):
        whole[..., some, some] = values * (1.0 + _ROUNDING) + tau**-2.0
        root = np.linalg.cholesky(whole)
        logs[..., t] = -np.log(root[..., some, some] * tau).sum(axis=2)
        explained[..., t] = np.sum(root[..., w, :w] ** 2, axis=2)
    return logs, explained
