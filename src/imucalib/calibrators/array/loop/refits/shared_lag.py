"""A lag of each sensor, held against one that all share beside one that few have.

A delay of all gyros beside a low-pass of one accelerometer is, to the first order, a delay of every
accelerometer: the best that one step can say, and a wrong name in most of them.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from imucalib.calibrators.array.loop.catalogue import array_catalogue, twins_of
from imucalib.calibrators.array.loop.earlier import Earlier
from imucalib.calibrators.array.loop.refits.twins import Tried, best_of_twins
from imucalib.calibrators.array.loop.search import Search
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.terms import Term, lagging, typical_of
from imucalib.calibrators.array.loop.worth import not_held_out, settled_or_lost
from imucalib.loop.evidence import Score
from imucalib.loop.found import LoopSettings

#: Standard deviations of the lag that most share, from which it may be one of its own; share of it
#: by which a sensor's lag may differ from it and still be that one.
_CLEAR, _ALIKE = 3.0, 0.25


def with_shared_first(
    found: Search, chosen: Score, earlier: Earlier, left_out: Collection[str], rules: LoopSettings
) -> tuple[Score, Tried]:
    """The step and its refit: of the chosen one, or of a lag that all share before those of each.

    left_out : effects that are not tried
    """

    def refits(name: str) -> Tried:
        return best_of_twins(found.state, found.term(name), earlier, left_out, rules.margin)

    own = refits(chosen.name)
    if own.state is None or not _of_each(own.state.terms[-1]):
        return chosen, own  # before chance is drawn: what passes is asked for nothing else
    asked = _common().difference(left_out, (t.name for t in lagging(own.state.terms)))
    first = next((s for s in found.passing(rules.alpha) if s.name in asked), None)
    if first is None:
        return chosen, own
    gain = _gain(found, own.state, first.name)
    if gain <= -rules.margin:
        return chosen, own
    if gain > rules.margin and not not_held_out(found.held_out(first.name)):
        common = refits(first.name)
        if common.state is not None:
            return first, common
    return chosen, replace(own, rivals=(*own.rivals, first.name))


def _common() -> set[str]:
    """Lags that all sensors share, of which no other stands for."""
    return {
        name
        for name, effect in array_catalogue().items()
        if effect.lagged and effect.shared and not effect.twin and effect.needs == ("spin",)
    }


def _of_each(term: Term) -> bool:
    """Whether it is a lag of each sensor, as one that all share may seem beside a few."""
    return term.effect.lagged is not None and not term.effect.shared and term.only is None


def _gain(found: Search, fitted: ArrayState, common: str) -> float:
    """Nats by which a lag that all share, and that of the few which differ from it, fit better than
    the lags of each, the last term; in the same shape of the noise."""
    parts = _parts(found, fitted, common)
    if parts is None:
        return -np.inf
    shared, few = parts
    best = -np.inf
    for name in (few.name, *twins_of(few.name)):
        effect = array_catalogue()[name.partition("@")[0]]
        if effect.channel != few.effect.channel:
            continue
        own = replace(few, name=name, effect=effect)
        trial = settled_or_lost(
            replace(fitted, terms=(*fitted.terms[:-1], shared, own)), shaped=False
        )
        if trial is not None and trial.converged:
            best = max(best, trial.density)
    return best - fitted.density


def _parts(found: Search, fitted: ArrayState, common: str) -> tuple[Term, Term] | None:
    """The lag that most share as a term of all, and what is left as one of one IMU or of each; None
    where most do not share one."""
    term = fitted.terms[-1]
    theta, sd = term.theta, fitted.sd_of(term)
    middle = float(np.median(theta))
    few = np.flatnonzero(np.abs(theta - middle) > _ALIKE * abs(middle))
    if abs(middle) < _CLEAR * float(np.median(sd)) or not 0 < len(few) < len(theta) / 2.0:
        return None
    entry = found.entries[common]
    assert entry.effect is not None
    sign = 1.0 if entry.effect.channel == term.effect.channel else -1.0
    live = typical_of(entry.effect, 1)[:, None]
    shared = Term(common, entry.effect, None, live, sign * middle / live[0], np.ones(1))
    own = typical_of(term.effect, 1)[:, None]
    if len(few) > 1:
        return shared, replace(
            term, value=term.value - np.linalg.pinv(term.live) @ np.full_like(theta, middle)
        )
    k = int(few[0])
    name = f"{term.effect.name}@{fitted.setup.imus[k]}"
    return shared, Term(name, term.effect, k, own, (theta[few] - middle) / own[0], np.ones(1))
