"""Effects whose columns are the same, told apart by refits: delays and low-passes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from imucalib.calibrators.array.loop.catalogue import array_catalogue, twins_of
from imucalib.calibrators.array.loop.earlier import Earlier
from imucalib.calibrators.array.loop.state import ArrayState, Behind
from imucalib.calibrators.array.loop.terms import Term
from imucalib.calibrators.array.loop.worth import (
    DIVERGED,
    implausible,
    refitted,
    settled_or_lost,
    why_not,
)
from imucalib.core.effect import Response
from imucalib.estimators.array.noise import log_density


@dataclass(frozen=True)
class Tried:
    """A refit with one term more, or why there is none; rivals : twins that would do as well, or
    whose own refit is lost; lost : those of the latter"""

    state: ArrayState | None
    reason: str = ""
    rivals: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()


def best_of_twins(
    state: ArrayState, term: Term, earlier: Earlier, left_out: Collection[str], margin: float
) -> Tried:
    """The joint fit with one term more, or with the twin of it that fits better.

    left_out : effects that are not tried; margin : nats up to which another twin would do as well
    """
    twins = [twin for twin in twins_of(term.name) if twin not in left_out]
    trial = refitted(state, earlier, term)
    reason = DIVERGED if trial is None else why_not(state, trial)
    if trial is not None and trial.converged:
        fits = _twins(trial, term.name, twins, margin)
    else:
        fits = {twin: refitted(state, earlier, _as_twin(term, twin)) for twin in twins}
    fits[term.name] = trial
    if trial is not None and twins:
        fits[term.name] = _as_near(trial, term.name, fits, margin)
    sound = {n: s for n, s in fits.items() if s is not None and not why_not(state, s)}
    if not sound:
        return Tried(None, reason)
    best, rivals = nearest(sound, margin)
    lost = open_twins(fits)
    return Tried(sound[best], "", (*rivals, *lost), lost)


def told_apart(
    state: ArrayState, name: str, twins: Sequence[str], margin: float
) -> tuple[ArrayState, str, tuple[str, ...]]:
    """Of a joint fit, the term of this name or its twin that fits better: the fit with it, its
    name, and those that would do as well, or whose fit is lost."""
    fits = _twins(state, name, twins, margin)
    # What was found after a wrong twin is what that has left, and no place to begin at.
    fits |= _twins(_before_later(state, name), name, open_twins(fits), margin)
    sound = {n: s for n, s in fits.items() if s is not None and s.converged}
    sound = {n: s for n, s in sound.items() if not implausible(s, n)}
    sound[name] = _as_near(state, name, sound, margin)
    best, rivals = nearest(sound, margin)
    return sound[best], best, (*rivals, *open_twins(fits))


def _twins(
    state: ArrayState, name: str, twins: Sequence[str], margin: float
) -> dict[str, ArrayState | None]:
    """Joint fits with twins in the place of a term, begun at its values; not where these are none
    that the twin could have, and of those that all sensors share, which are compared by the
    density, none that cannot come within the margin."""
    found: dict[str, ArrayState | None] = {}
    for twin in twins:
        terms = (_as_twin(t, twin) if t.name == name else t for t in state.terms)
        start = replace(state, terms=tuple(terms))
        if implausible(start, twin):
            continue
        least = state.density - margin if _effect(twin).shared else -np.inf
        with suppress(Behind):
            found[twin] = settled_or_lost(start, shaped=False, least=least)
    return found


def _before_later(state: ArrayState, name: str) -> ArrayState:
    """With the terms after that of a name at zero."""
    at = [t.name for t in state.terms].index(name) + 1
    later = (replace(t, value=0.0 * t.value) for t in state.terms[at:])
    return replace(state, terms=(*state.terms[:at], *later))


def _effect(name: str) -> Response:
    return array_catalogue()[name.partition("@")[0]]


def _as_near(
    state: ArrayState, name: str, fits: Mapping[str, ArrayState | None], margin: float
) -> ArrayState:
    """A fit as near its end as those of its twins: the way that was left was worth five nats. Where
    it leads already, the way would only add to that."""
    others = [_nats(s, n) for n, s in fits.items() if s is not None and s.converged and n != name]
    if _nats(state, name) > max(others, default=-np.inf) + margin:
        return state
    nearer = settled_or_lost(state, shaped=False)
    return nearer if nearer is not None and nearer.converged else state


def open_twins(fits: Mapping[str, ArrayState | None]) -> tuple[str, ...]:
    """Twins whose fit was lost: nothing is known against them."""
    return tuple(n for n, s in fits.items() if s is None or not s.converged)


def _as_twin(term: Term, twin: str) -> Term:
    """With the effect of a twin: where one kind of sensor lags, the other leads."""
    effect = _effect(twin)
    sign = 1.0 if effect.channel == term.effect.channel else -1.0
    return replace(term, name=twin, effect=effect, value=sign * term.value)


def nearest(fits: Mapping[str, ArrayState], margin: float) -> tuple[str, tuple[str, ...]]:
    """The name of the best fit of twins, and of those that do as well; where the one that a search
    has for all is among these, it stays."""
    nats = {name: _nats(state, name) for name, state in fits.items()}
    bar = max(nats.values()) - margin
    near = sorted((n for n in fits if nats[n] > bar), key=lambda n: -nats[n])
    plain = [n for n in near if not _effect(n).twin]
    best = (plain or near)[0]
    return best, tuple(n for n in near if n != best)


def _nats(state: ArrayState, name: str) -> float:
    """What a fit is worth beside those of its twins. A lag of single sensors shows against others
    of their kind: what neighbours' noise brings into dω/dt, other for each twin, is in the other
    kind's residuals, and was worth 36 nats for the wrong one."""
    effect = _effect(name)
    if effect.shared:
        return state.density
    a, g, speed = state.squares()
    gyro = effect.channel == "angular_rate"
    return float(log_density(state.noise[gyro], g if gyro else a, speed).sum())
