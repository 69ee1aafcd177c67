"""Rivals that a recording cannot tell apart, and the observations that would.

Columns are in units of the noise and at typical sizes. With G the products of all of them, those
recorded and those planned, a truth a of size θ and a rival b,

    μ² = θᵀ (G_aa - G_ac G_cc⁻¹ G_ca) θ,   c = the base model and b

is what of a neither b nor the base model takes over. Log odds of a against b, alike beforehand, are
then about normal, with mean μ²/2 and standard deviation μ: a is given 95 % against b with
probability Φ(μ/2 - log 19 / μ). Sizes are those that the recording allows, were a the cause.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.balance import whitener
from imucalib.core.eigen import eigen
from imucalib.core.fit import Fit
from imucalib.effects import known, names_a_cause
from imucalib.effects.record_error import is_record_error
from imucalib.posterior.candidates import effect_columns
from imucalib.posterior.closed_loop.planning import Plan, grow_until
from imucalib.posterior.odds import ALIKE, CERTAIN, DRAWS, ENDED, PLANNED, RIVAL_SIZES, UNLUCKY
from imucalib.posterior.record_errors import drop_effects

#: How much of everything that could be recorded stands for any number of observations.
_ANY_NUMBER = 1e6


@dataclass(frozen=True)
class Ambiguity:
    """An effect that was added, and those that the data cannot tell from it.

    effect : its name; base : effects of the model without it; columns : (P,) parameters in order,
    the base's first; rivals : names that the data cannot tell apart, the effect itself first
    blocks : name -> columns of each rival
    gram : (P, P) products of all columns; along : (P,) with the data; power : of the data; numbers
    : how many they are
    """

    effect: str
    base: tuple[str, ...]
    columns: tuple[str, ...]
    rivals: tuple[str, ...]
    blocks: Mapping[str, Index]
    gram: Array
    along: Array
    power: float
    numbers: float

    @property
    def own(self) -> Index:
        """Columns of the base model."""
        return np.arange(min(int(at[0]) for at in self.blocks.values()))

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """(truth, rival), every one against every other."""
        return tuple((a, b) for a in self.rivals for b in self.rivals if a != b)

    @cached_property
    def sizes(self) -> Mapping[str, Array]:
        """(k, draws) of every rival: sizes that the recording allows, were it the truth."""
        rng = np.random.default_rng(0)
        return {name: self._draw(self.blocks[name], rng) for name in self.rivals}

    def _draw(self, at: Index, rng: np.random.Generator) -> Array:
        """With the base model taken out, along the axes of what is left of a rival."""
        last, dof = len(self.columns), self.numbers - self.own.size
        whole = np.block([[self.gram, self.along[:, None]], [self.along, np.array(self.power)]])
        rest = _drop(whole, self.own, np.append(at, last), _little(self.gram)[self.own])
        values, vectors = eigen(rest[:-1, :-1])
        seen = vectors.T @ rest[:-1, -1]
        # Of rounding a square may be left that is below zero.
        precision = np.maximum(values, 0.0) + np.array(RIVAL_SIZES)[:, None] ** -2.0
        left = np.maximum(rest[-1, -1] - np.sum(seen**2 / precision, axis=1), 1e-300)
        volume = np.sum(np.log(precision), axis=1) + 2.0 * at.size * np.log(RIVAL_SIZES)
        best = precision[int(np.argmin(volume + dof * np.log(left)))][:, None]
        noise = np.sqrt(dof / rng.chisquare(dof, DRAWS))  # as well known as the data leave it
        white = rng.standard_normal((at.size, DRAWS))
        return np.asarray(vectors @ (seen[:, None] / best / noise + white / np.sqrt(best)))

    def after_a_power_up(self, bias: Mapping[str, float], pool: Array) -> tuple[Ambiguity, Array]:
        """With columns before all others, and so the pool (c, P, P): what the bias of new data is
        off by, which the recording has not. bias : parameter -> precision of its offset, at typical
        size"""
        size, more = len(self.columns), len(bias)
        grown = np.zeros((size + more,) * 2)
        grown[:more, :more] = np.diag(list(bias.values()))
        grown[more:, more:] = self.gram
        later = replace(
            self,
            columns=(*(f"next_{name}" for name in bias), *self.columns),
            blocks={name: at + more for name, at in self.blocks.items()},
            gram=grown,
            along=np.concatenate([np.zeros(more), self.along]),
            numbers=self.numbers + more,  # what is known of an offset is a number too
        )
        turn = np.concatenate([np.eye(size)[[self.columns.index(n) for n in bias]], np.eye(size)])
        return later, np.asarray(turn @ pool @ turn.T)


def apart(one: Ambiguity, gram: Array) -> Array:
    """(..., pairs, draws) μ of every pair, at every size of its truth, with products of all columns
    (..., P, P)."""
    little = _little(gram)
    every = np.concatenate([one.blocks[name] for name in one.rivals])
    # The base is taken out once for all pairs.
    rest = _drop(gram, one.own, every, little[..., one.own])
    found = []
    for truth, other in one.pairs:
        a, b = np.searchsorted(every, one.blocks[truth]), np.searchsorted(every, one.blocks[other])
        square = _drop(rest, b, a, little[..., one.blocks[other]])
        size = one.sizes[truth]
        found.append(np.einsum("kd,...kl,ld->...d", size, square, size))
    return np.asarray(np.sqrt(np.maximum(np.stack(found, axis=-2), 0.0)))


def _little(gram: Array) -> Array:
    """(..., P) of each diagonal: columns that nothing tells apart must not end the computation."""
    return np.asarray(1e-10 * np.einsum("...ii->...i", gram) + 1e-12)


def _drop(gram: Array, out: Index, kept: Index, little: Array) -> Array:
    """(..., k, k) products of the kept columns with others taken out; little : (..., o) that is
    added to the diagonal of these"""
    inside = gram[..., out[:, None], out] + little[..., None] * np.eye(len(out))
    across = gram[..., out[:, None], kept]
    back = across.swapaxes(-1, -2) @ np.linalg.solve(inside, across)
    return np.asarray(gram[..., kept[:, None], kept] - back)


@dataclass(frozen=True)
class Separation:
    """A plan: candidates in the order of choosing.

    pairs : (truth, rival) that can be told apart; now, then : (pairs,) their μ without and with the
    plan; ends : rival -> probability that it is certain, were it the truth, against those that can
    be told from it; never : pairs that nothing which can be recorded tells apart
    """

    effect: str
    rivals: tuple[str, ...]
    plan: Plan
    pairs: tuple[tuple[str, str], ...]
    now: Array
    then: Array
    ends: Mapping[str, float]
    never: tuple[tuple[str, str], ...]

    @property
    def enough(self) -> bool:
        """Whether the plan ends the ambiguity, whichever rival is the truth."""
        ends = min(self.ends.values(), default=0.0) >= ENDED
        return bool(self.plan) and ends and not self.never


def separation(one: Ambiguity, pool: Array) -> Separation:
    """The fewest candidates, each as often as it pays, that end an ambiguity: added one by one
    where the pair that is separated worst gains most, then exchanged while that helps.

    pool : (c, P, P) products of each candidate, of what could be recorded
    """
    able = separable(one, pool)

    def worth(plan: Plan) -> Array:
        """(c,) the least μ that few sizes fall below, and a little of the others, so that a plan
        grows where one pair alone cannot."""
        each = _few(apart(one, one.gram + pool[list(plan)].sum(axis=0) + pool))[..., able]
        return np.asarray(each.min(axis=-1) + 0.05 * each.mean(axis=-1))

    def ends(plan: Plan) -> Mapping[str, float]:
        few = len(plan) < PLANNED[0]
        return {} if few else _ends(one, able, pool[list(plan)].sum(axis=0))

    plan: Plan = ()
    if able.any():
        plan = grow_until(worth, PLANNED[1], lambda p: min(ends(p).values(), default=0.0) >= ENDED)
    total = pool[list(plan)].sum(axis=0)
    return Separation(
        effect=one.effect,
        rivals=one.rivals,
        plan=plan,
        pairs=tuple(pair for pair, can in zip(one.pairs, able, strict=True) if can),
        now=_few(apart(one, one.gram))[able],
        then=_few(apart(one, one.gram + total))[able],
        ends=ends(plan),
        never=tuple(pair for pair, can in zip(one.pairs, able, strict=True) if not can),
    )


def separable(one: Ambiguity, pool: Array) -> Array:
    """(pairs,) bool, whether any number of candidates would tell the truth from its rival."""
    gram = one.gram + _ANY_NUMBER * pool.mean(axis=0)
    alone = _drop(gram, one.own, np.arange(len(gram)), np.zeros(one.own.size))
    size = {
        name: np.einsum("kd,kl,ld->d", drawn, alone[np.ix_(at, at)], drawn)
        for name, drawn in one.sizes.items()
        for at in [one.blocks[name]]
    }
    whole = np.sqrt(np.maximum([size[truth] for truth, _ in one.pairs], 0.0))
    return np.asarray(_few(apart(one, gram)) > ALIKE * _few(whole))


def _few(each: Array) -> Array:
    """(...) what few draws, the last axis, fall below."""
    return np.asarray(np.quantile(each, UNLUCKY, axis=-1))


def _ends(one: Ambiguity, able: Array, added: Array) -> Mapping[str, float]:
    """Of every truth the probability that it is certain against all that can be told from it."""
    from scipy.special import ndtr

    each = np.maximum(apart(one, one.gram + added), 1e-9)
    certain = ndtr(each / 2.0 - np.log(CERTAIN / (1.0 - CERTAIN)) / each)
    found = {}
    for truth in one.rivals:
        rows = [k for k, (a, _) in enumerate(one.pairs) if a == truth and able[k]]
        if rows:
            found[truth] = float(certain[rows].prod(axis=0).mean())
    return found


def ambiguities(
    fit: Fit, steps: Iterable[Sequence[str]], white: Callable[[Array], Array] | None = None
) -> tuple[Ambiguity, ...]:
    """Of every effect that was added to a fit where two causes or more would do as well.

    steps : of each, its name and those of its aliases
    white : of columns in units of the declared noise, where that is more than settings
    """
    found = (_of_step(fit, names, white) for names in steps)
    return tuple(one for one in found if one is not None)


def _of_step(
    fit: Fit, names: Sequence[str], white: Callable[[Array], Array] | None
) -> Ambiguity | None:
    causes = filter(names_a_cause, names)
    named = [e for name in causes if (e := known(name)) is not None]
    if len(named) < 2 or names[0] not in fit.model.names:
        return None
    without = drop_effects(fit, names[:1])
    context = without.observations.context
    effects = [e for e in named if e.name not in without.model.names and not e.missing(context)]
    if len(effects) < 2:
        return None
    held = replace(without, noise=fit.noise)
    blocks = [effect_columns(without, e) for e in effects]
    typical = np.array([p.typical for p in held.parameters])
    white = white or whitener(held.at.settings, held.noise.ratio)
    factor = held.noise.factor
    whole = white(held.at.jacobian * typical) / factor
    base, rest = _drop_records(held, whole)
    own = [p.name for p, kept in zip(held.parameters, base, strict=True) if kept]
    seen = rest(white(np.column_stack(blocks)) / factor)
    columns = np.column_stack([rest(whole)[:, base], seen])
    data = rest(white(held.at.residual)[:, None] / factor)[:, 0]
    ends = np.cumsum([len(own), *(b.shape[1] for b in blocks)])
    return Ambiguity(
        effect=names[0],
        base=tuple(n for n in without.model.names if not is_record_error(n)),
        columns=(*own, *(p.name for e in effects for p in e.parameters(context))),
        rivals=tuple(e.name for e in effects),
        blocks={e.name: np.arange(a, b) for e, a, b in zip(effects, ends, ends[1:], strict=False)},
        gram=columns.T @ columns,
        along=columns.T @ data,
        power=float(data @ data),
        numbers=float(data.size - base.size + np.count_nonzero(base)),
    )


def _drop_records(fit: Fit, seen: Array) -> tuple[Array, Callable[[Array], Array]]:
    """(p,) bool, which parameters are none of records that are set aside, and what takes those out
    of columns, for they are free; seen : (N, p) columns of all parameters"""
    kept = np.ones(seen.shape[1], bool)
    for name, part in fit.model.slices(fit.observations.context).items():
        kept[part] &= not is_record_error(name)
    basis = np.linalg.qr(seen[:, ~kept])[0]
    return kept, lambda columns: np.asarray(columns - basis @ (basis.T @ columns))
