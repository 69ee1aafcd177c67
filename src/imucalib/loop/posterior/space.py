"""The posterior over sets of components: every set near the best is opened and scored.

The evidence of a set is the sum over its members, their sizes and all noises, each with its prior:

    log L = -½ log|V| - ½ log|1 + τ² CᵀPC| - ν/2 log RSS

What other members and sizes of a component add to its best is carried along as one number, so that
the evidence of a set does not depend on the order in which it was built.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.eigen import eigen
from imucalib.loop.posterior.catalogue import log_set_prior, log_size_prior
from imucalib.loop.posterior.gram import Grams, beside, log_sum, swept
from imucalib.loop.posterior.odds import BEAMS, DEEPEST, OPEN, WIDTH
from imucalib.loop.posterior.problem import Choice, Contest

#: Sets of one depth that are kept.
_KEPT = 60
#: Columns up to which a block is narrow.
NARROW = 20
#: What rounding may take from the diagonal of a wide block.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Pick:
    """A member of a component and its size over the noise factor."""

    choice: int
    size: float


def blocks_of(choices: Sequence[Choice], picks: Sequence[Pick]) -> list[tuple[Index, float]]:
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
    def best(self) -> Hypothesis:
        return self.hypotheses[0]

    @property
    def base(self) -> Hypothesis:
        """That nothing is missing."""
        return next(h for h in self.hypotheses if not h.components)


@dataclass(frozen=True)
class _State:
    """A hypothesis that is opened, with its own Grams."""

    hypothesis: Hypothesis
    grams: Grams


@dataclass(frozen=True)
class _Blocks:
    """Blocks of columns by their width: which of `count`, index (m, w), and those of all data."""

    count: int
    by_width: tuple[tuple[Index, Index, Array], ...]


def _blocks(grams: Grams, columns: Sequence[Index]) -> _Blocks:
    widths = np.array([c.size for c in columns])
    every = []
    for width in np.unique(widths):
        which = np.flatnonzero(widths == width)
        index = np.array([columns[int(j)] for j in which])
        every.append((which, index, grams.products.blocks(index)))
    return _Blocks(len(columns), tuple(every))


def search(
    problem: Contest,
    grams: Grams,
    choices: tuple[Choice, ...] | None = None,
    *,
    beams: tuple[int, ...] = BEAMS,
    deepest: int = DEEPEST,
) -> Posterior:
    """The posterior over sets of components by a beam search; choices : those of the problem by
    default, with their columns in these Grams; beams : sets that are opened at each depth."""
    every = problem.choices if choices is None else choices
    dof = grams.numbers - problem.base
    base = swept(grams, *problem.flat)
    nothing = Hypothesis((), (), base.evidence(dof), 0.0)
    found: dict[tuple[int, ...], Hypothesis] = {(): nothing}
    level = [_State(nothing, base)]
    blocks = _blocks(grams, [c.at for c in every])
    for depth in range(deepest):
        born: dict[tuple[int, ...], tuple[Hypothesis, _State]] = {}
        for state in level:
            for one in _opened(problem, state, every, blocks, dof):
                key = one.components
                if key not in found and (key not in born or one.evidence > born[key][0].evidence):
                    born[key] = one, state
        best = max(h.log_posterior for h in found.values())
        top = sorted(born.values(), key=lambda b: -b[0].log_posterior)
        found.update({h.components: h for h, _ in top[:_KEPT]})
        if not top or top[0][0].log_posterior < best - OPEN / 3.0:
            break
        bar = max(best, top[0][0].log_posterior) - OPEN
        width = beams[min(depth, len(beams) - 1)]
        level = [_state(h, s, every) for h, s in top[:width] if h.log_posterior > bar]
    return _ranked(found, grams, dof)


def climbed(problem: Contest, grams: Grams, start: Sequence[Pick] = ()) -> Posterior:
    """The posterior by opening the likeliest sets: everything beside each, and then everything in
    the place of each of its components, until none of the likeliest is new. Where sets are large, a
    beam from nothing goes a long way; start : picks of a set that is likely."""
    every, dof = problem.choices, grams.numbers - problem.base
    base = swept(grams, *problem.flat)
    blocks = _blocks(grams, [c.at for c in every])
    found: dict[tuple[int, ...], Hypothesis] = {}
    opened = set[tuple[tuple[Pick, ...], bool]]()

    def at(picks: tuple[Pick, ...], added: tuple[float, ...]) -> _State:
        own = beside(base, blocks_of(every, picks))
        key = tuple(sorted(every[p.choice].component for p in picks))
        evidence = own.evidence(dof) + sum(added)
        return _State(
            Hypothesis(key, picks, evidence, log_set_prior(problem.odds, key), added), own
        )

    def keep(state: _State, *, open_it: bool = True) -> None:
        more = _opened(problem, state, every, blocks, dof) if open_it else ()
        for one in (state.hypothesis, *more):
            old = found.get(one.components)
            if old is None or one.evidence > old.evidence:
                found[one.components] = one

    keep(at((), ()), open_it=bool(start))
    if start:
        prior = log_size_prior(problem.sizes)
        level = [int(np.argmin(np.abs(np.log(problem.sizes / p.size)))) for p in start]
        weight = [every[p.choice].log_weight for p in start]
        added = tuple(float(prior[k]) + w for k, w in zip(level, weight, strict=True))
        keep(at(tuple(start), added), open_it=False)
    while True:
        top = sorted(found.values(), key=lambda h: -h.log_posterior)[:WIDTH]
        steps = ((h, aside) for h in top for aside in (False, True))
        new = next(((h, a) for h, a in steps if (h.picks, a) not in opened), None)
        if new is None:
            return _ranked(found, grams, dof)
        opened.add((new[0].picks, new[1]))
        for state in _aside(*new, at):
            keep(state)


def _aside(
    one: Hypothesis, aside: bool, at: Callable[[tuple[Pick, ...], tuple[float, ...]], _State]
) -> Iterator[_State]:
    """A set, or it without each of its components."""
    if not aside:
        yield at(one.picks, one.added)
        return
    for k in range(len(one.picks)):
        yield at(one.picks[:k] + one.picks[k + 1 :], one.added[:k] + one.added[k + 1 :])


def _ranked(found: dict[tuple[int, ...], Hypothesis], grams: Grams, dof: float) -> Posterior:
    ranked = sorted(found.values(), key=lambda h: -h.log_posterior)
    logs = np.array([h.log_posterior for h in ranked])
    whole = float(log_sum(logs))
    return Posterior(tuple(ranked), np.exp(logs - whole), grams, dof, whole)


def _state(hypothesis: Hypothesis, source: _State, choices: tuple[Choice, ...]) -> _State:
    pick = hypothesis.picks[-1]
    return _State(hypothesis, swept(source.grams, choices[pick.choice].at, pick.size))


def _opened(
    problem: Contest, state: _State, choices: tuple[Choice, ...], blocks: _Blocks, dof: float
) -> list[Hypothesis]:
    """Every set with one component more."""
    own = state.hypothesis
    score, raw = _scores(state, blocks, problem.sizes, dof)
    score = score + np.array([c.log_weight for c in choices])[:, None]
    of = np.array([c.component for c in choices])
    found = []
    for component in np.setdiff1d(of, own.components):
        rows = np.flatnonzero(of == component)
        part = score[rows]
        total = float(log_sum(part.ravel()))
        if not np.isfinite(total):
            continue
        a, b = np.unravel_index(np.argmax(part), part.shape)
        key = tuple(sorted((*own.components, int(component))))
        found.append(
            Hypothesis(
                components=key,
                picks=(*own.picks, Pick(int(rows[a]), float(problem.sizes[b]))),
                evidence=total + sum(own.added),
                prior=log_set_prior(problem.odds, key),
                added=(*own.added, total - float(raw[rows[a], b])),
            )
        )
    return found


def _scores(state: _State, opened: _Blocks, sizes: Array, dof: float) -> tuple[Array, Array]:
    """(M, T) log evidence of each block at each size, over all noises, with the prior of the size
    and without."""
    out = np.full((2, opened.count, sizes.size), -np.inf)
    for which, index, whole in opened.by_width:
        logs, factor = block_logs(state.grams, index, sizes, dof, whole)
        out[0, which] = log_sum(logs + log_size_prior(sizes * factor))
        out[1, which] = log_sum(logs)
    return out[0], out[1]


def block_logs(
    grams: Grams, index: Index, size: Array, dof: float, whole: Array | None = None
) -> tuple[Array, Array]:
    """(E, m, T) log evidence of each block of columns index (m, w) at each size (T,) over the noise
    factor, and that factor; whole : the blocks' own products, where they are there."""
    inner, along = grams.blocks(index, whole), grams.along[:, index]
    logs, taken = (_by_factors if index.shape[1] > NARROW else _by_values)(
        grams, inner, along, size
    )
    rest = np.maximum(grams.power[:, None, None] - taken, 1e-9)
    logs = logs + grams.log_weight[:, None, None] + grams.log_noise(rest, dof)
    return logs, np.sqrt(rest / dof)


def _by_values(grams: Grams, inner: Array, along: Array, size: Array) -> tuple[Array, Array]:
    """(E, m, T) -½ log|1 + τ² A| and aᵀ (A + 1/τ²)⁻¹ a of blocks A and products a with y, by the
    eigenvalues of A, which serve all sizes."""
    if inner.shape[2] == 1:
        values = inner[..., 0]
    else:
        values, vectors = eigen(inner)
        along = np.einsum("emij,emi->emj", vectors, along)
    values, square = np.maximum(values, 0.0), size**2
    taken = along[..., None] ** 2 / (values[..., None] + 1.0 / square)
    return -0.5 * np.log1p(values[..., None] * square).sum(axis=2), taken.sum(axis=2)


def _by_factors(grams: Grams, inner: Array, along: Array, size: Array) -> tuple[Array, Array]:
    """The same of wide blocks by a Cholesky factor of each size, a below it, which is quicker."""
    e, m, w, _ = inner.shape
    logs, taken = np.empty((2, e, m, size.size))
    whole = np.empty((e, m, w + 1, w + 1))
    whole[..., :w, :w], whole[..., w, :w], whole[..., :w, w] = inner, along, along
    whole[..., w, w] = 2.0 * grams.power[:, None] + 1.0  # any number above what is taken serves
    some = np.arange(w)
    values = inner[..., some, some]
    for t, tau in enumerate(size):
        whole[..., some, some] = values * (1.0 + _ROUNDING) + tau**-2.0
        root = np.linalg.cholesky(whole)
        logs[..., t] = -np.log(root[..., some, some] * tau).sum(axis=2)
        taken[..., t] = np.sum(root[..., w, :w] ** 2, axis=2)
    return logs, taken
