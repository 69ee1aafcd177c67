"""Evidence of every candidate beside a model, and what the best of them reaches by chance.

    evidence = max over (walk, size) of L(with the candidate) - max over walks of L(without it)

so that a candidate may bring a smaller noise of its own. Chance is measured on data drawn from the
fitted noise, its walk included, through the same two maxima.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import Effect
from imucalib.estimators.contest import best_evidence, directions_of
from imucalib.loop.wander.bank import Bank, Mask
from imucalib.loop.wander.likelihood import Terms, levels
from imucalib.loop.wander.noise import REACH
from imucalib.loop.wander.projected import (
    CURVE_SIZE,
    CURVE_TERMS,
    Null,
    View,
    gains,
    projected,
    turned,
)
from imucalib.loop.wander.walk import whitened

#: Prior sizes that are tried, in typical ones.
SIZES = (0.1, 0.3, 1.0, 3.0, 10.0)

#: Nats that two values with the same columns may differ by.
_ROUNDING = 1e-6

_TIME = ("order", "time", "time_of_day")
_BEFORE = ("previous", "approach")
#: Families whose members are free functions of the response: of an axis, of the whole posture.
_FREE = {"converter": "curve", "posture": "posture"}


def kind_of(effect: Effect) -> str:
    """What drives an effect: "time", "temperature", "history", "posture", "curve" or "shape"."""
    if any(n in _TIME for n in effect.needs):
        return "time"
    if any(n.startswith("temperature") for n in effect.needs):
        return "temperature"
    if any(n.startswith(_BEFORE) for n in effect.needs):
        return "history"
    return _FREE.get(effect.name.partition("@")[0], "shape")


@dataclass(frozen=True)
class Entry:
    """A candidate: columns : where they are in the bank; family : the scan that it is a value of;
    kind : what drives it; wide : whether it holds all that it is held against"""

    name: str
    family: str
    kind: str
    columns: Index
    wide: bool = False

    @property
    def timed(self) -> bool:
        """Whether time drives it."""
        return self.kind == "time"

    @property
    def of_response(self) -> bool:
        """Whether the force itself drives it, alone."""
        return self.kind in ("shape", "curve", "posture")

    @property
    def free(self) -> bool:
        """Whether it may have any form: of an axis, of the posture, of the temperature."""
        named = self.kind in ("curve", "posture") or self.name.startswith("curve@")
        return named or self.wide


@dataclass(frozen=True)
class Scored:
    """evidence (nats), with the walk and the prior size that give it; left : share of the columns
    that the model does not absorb; strength : λ at typical size; share : of the power; near :
    walks under which it comes near that evidence"""

    entry: Entry
    evidence: float
    walk: int
    size: float
    left: float
    strength: float
    share: float
    near: tuple[int, ...] = ()


def scored(
    bank: Bank, terms: Terms, keep: Mask, entries: Sequence[Entry], walks: Sequence[int],
    null: Null | None = None, *, told: bool = True,
) -> tuple[tuple[Scored, ...], Array]:  # fmt: skip
    """Every candidate, best first, and on every draw of the null the best (2, draws) of those that
    nothing in time drives and of those that time does.

    A long walk looks like a drift now and then, never like a temperature: each has its own chance.
    told : whether somebody reads what is left of the columns, their strength and share
    """
    draws = 0 if null is None else null.draws
    if not entries:
        return (), np.zeros((2, draws))
    base = levels(bank, terms, keep)
    freedom = base[0].freedom
    best = np.full((len(entries), 1 + draws), -np.inf)
    under = np.full((len(entries), len(bank.walks)), -np.inf)
    without = np.full((1 + draws), -np.inf)
    where, views = np.zeros((len(entries), 2), dtype=int), dict[int, View]()
    for walk in range(len(bank.walks)):
        if walk not in walks if null is None else walk not in null.power:
            without[0] = max(without[0], base[walk].nats)
            continue
        view = views[walk] = projected(bank, terms, keep, walk, null)
        plain = base[walk].nats - 0.5 * freedom * np.log(view.power / view.power[0])
        without = np.maximum(without, plain)
        if walk not in walks:
            continue
        for k, gain in enumerate(plain + _of_every_size(view, entries, freedom)):
            where[gain[:, 0] > best[:, 0]] = walk, k
            best = np.maximum(best, gain)
            under[:, walk] = np.maximum(under[:, walk], gain[:, 0])
    evidence = np.maximum(best - without, 0.0)
    found = [
        Scored(entry, nats, walk, SIZES[size], *_facts(views[walk], entry, told), _near(own))
        for entry, nats, (walk, size), own in zip(
            entries, evidence[:, 0].tolist(), where.tolist(), under, strict=True
        )
    ]
    timed = np.array([e.timed for e in entries])
    chance = [evidence[timed == one, 1:].max(axis=0, initial=0.0) for one in (False, True)]
    return tuple(sorted(found, key=lambda s: -s.evidence)), np.array(chance)


def _near(nats: Array) -> tuple[int, ...]:
    """Walks whose likelihood with a candidate (walks,) comes near its best."""
    return tuple(np.flatnonzero(nats > nats.max() - REACH).tolist())


def _of_every_size(view: View, entries: Sequence[Entry], freedom: int) -> Array:
    """(sizes, k, 1 + draws) nats."""
    blocks = [e.columns for e in entries]
    if view.power.size == 1:
        return gains(view, blocks, freedom, SIZES)[:, :, None]
    starts = np.cumsum([0] + [columns.size for columns in blocks])
    size, own = turned(view, blocks)
    each = (view.power, size, starts[:-1], freedom)
    found = np.stack([best_evidence(own, *each, np.array([factor])) for factor in SIZES])
    curve = np.array([columns.size >= CURVE_TERMS for columns in blocks])
    found[np.ix_(np.array(SIZES) > CURVE_SIZE, curve)] = -np.inf
    return found


def finest(
    bank: Bank, terms: Terms, keep: Mask, found: Scored, finer: Sequence[tuple[str, Array]]
) -> tuple[Bank, Scored]:
    """The best of the values near the one that a scan found, under its walk and at its size; its
    columns join the bank."""
    gain = beside(bank, terms, keep, found.walk, [c for _, c in finer], (found.size,))[:, 0]
    name, columns = finer[middle_of_best(gain)]
    return joined(bank, found, name, columns)


def middle_of_best(nats: Array) -> int:
    """Of neighbouring values of a scan the best one, or the middle of those that are as good but
    for rounding: without a block of time no moment in it is better than another."""
    alike = np.flatnonzero(nats >= nats.max() - _ROUNDING)
    return int(alike[alike.size // 2])


def joined(bank: Bank, found: Scored, name: str, columns: Array) -> tuple[Bank, Scored]:
    """The bank with the columns (n, c) behind all others, and the score under their name."""
    at = np.arange(bank.columns.shape[1], bank.columns.shape[1] + columns.shape[1])
    return bank.plus(columns), replace(found, entry=replace(found.entry, name=name, columns=at))


def beside(
    bank: Bank, terms: Terms, keep: Mask, walk: int, blocks: Sequence[Array], sizes: Sequence[float]
) -> Array:
    """(blocks, sizes) nats that columns (n, c) which are not in the bank gain beside a model."""
    rows = keep[bank.course.part]
    every = np.concatenate(blocks, axis=1)
    white, _ = whitened(bank.course, bank.walks, every, slice(walk, walk + 1))
    base = bank.white(walk, np.append(terms.columns, bank.data))[rows]
    x, y, z = base[:, :-1], base[:, -1], white[0][rows]
    precise = x.T @ x + np.diag(terms.precision)
    shared = x.T @ z
    solved = np.linalg.solve(precise, np.column_stack([shared, x.T @ y]))
    along = z.T @ y - shared.T @ solved[:, -1]
    power = np.array([float(y @ y - (x.T @ y) @ solved[:, -1])])
    ends = np.cumsum([0] + [columns.shape[1] for columns in blocks])
    entries = [slice(int(a), int(b)) for a, b in pairwise(ends)]
    # Of each block alone: what one has with another takes no part, and most of the time.
    size, turns = directions_of(
        [z[:, e].T @ z[:, e] - shared[:, e].T @ solved[:, e] for e in entries]
    )
    own = np.concatenate([t.T @ along[e] for e, t in zip(entries, turns, strict=True)]) ** 2
    freedom = int(rows.sum()) - terms.base
    tried = (np.array([size_]) for size_ in sizes)
    gains = [best_evidence(own[:, None], power, size, ends[:-1], freedom, t)[:, 0] for t in tried]
    return np.stack(gains, axis=1)


def _facts(view: View, entry: Entry, told: bool) -> tuple[float, float, float]:
    """Share left, λ at typical size, share of the power explained; nothing where nobody asks."""
    if not told:
        return 0.0, 0.0, 0.0
    size, own = turned(view, [entry.columns])
    kept, whole = float(size.sum()), view.columns.size(entry.columns)
    share = float(own[:, 0].sum() / view.power[0])
    return kept / max(whole, 1e-300), kept**0.5, share
