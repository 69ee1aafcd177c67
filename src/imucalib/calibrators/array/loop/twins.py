"""Effects whose columns are the same to the first order, told apart by refits: delays and
low-passes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.catalogue import array_catalogue, twins_of
from imucalib.calibrators.array.loop.memory import shared_by_neighbours
from imucalib.calibrators.array.loop.state import ArrayState, settled
from imucalib.calibrators.array.loop.terms import Term
from imucalib.core.effect import Response
from imucalib.estimators.array.noise import log_density

#: Times that twins are told apart, where some have gone to another name.
_PASSES = 3


@dataclass(frozen=True)
class Apart:
    """state : with the likeliest of every effect's twins; shares : name in it -> (twin, share) of
    what may stand there, itself first"""

    state: ArrayState
    shares: Mapping[str, tuple[tuple[str, float], ...]]


def told_apart(state: ArrayState, left_out: Collection[str]) -> Apart:
    """Of a settled fit, every found effect that has twins against these, each fitted anew in its
    place; again where one has gone to a twin, for beside a wrong one another seems right.

    left_out : names that are not tried. A twin whose fit is lost keeps the share it had before:
    nothing is known against it.
    """
    for _ in range(_PASSES):
        shares = dict[str, tuple[tuple[str, float], ...]]()
        names = [t.name for t in state.found]
        for name in names:
            twins = [twin for twin in twins_of(name) if twin not in left_out]
            if twins:
                state, known = _against(state, name, twins)
                shares[known[0][0]] = known
        if names == [t.name for t in state.found]:
            break
    return Apart(state, shares)


def _against(
    state: ArrayState, name: str, twins: list[str]
) -> tuple[ArrayState, tuple[tuple[str, float], ...]]:
    """The fit with the likeliest of an effect and its twins, and the share of each."""
    possible = [twin for twin in twins if _possible(state, name, twin)]
    fits: dict[str, ArrayState | None] = {name: state}
    fits |= {twin: _in_place(state, name, twin) for twin in possible}
    level = _nats(state, name)
    nats = np.array([_nats(s, n) - level if s else 0.0 for n, s in fits.items()])
    share = np.exp(nats - nats.max())
    order = np.argsort(-share, kind="stable")
    names = [list(fits)[k] for k in order]
    known = zip(names, share[order] / share.sum(), strict=True)
    return fits[names[0]] or state, tuple((n, float(s)) for n, s in known)


def refitted(state: ArrayState) -> ArrayState | None:
    """The joint fit with the noise in the shape that it has; None where it runs away."""
    try:
        found = settled(state, shaped=False)
    except np.linalg.LinAlgError:
        return None
    return found if found.converged else None


def _in_place(state: ArrayState, name: str, twin: str) -> ArrayState | None:
    terms = (_as_twin(t, twin) if t.name == name else t for t in state.terms)
    return refitted(replace(state, terms=tuple(terms)))


def _possible(state: ArrayState, name: str, twin: str) -> bool:
    """Whether the values of an effect are those that its twin could have: no filter has a negative
    time."""
    term = next(t for t in state.terms if t.name == name)
    least = _each(_as_twin(term, twin), "least")
    return bool(np.all(_as_twin(term, twin).theta + 3.0 * state.sd_of(term) >= least))


def _each(term: Term, what: str) -> Array:
    return np.resize([getattr(p, what) for p in term.effect.each], len(term.theta))


def _effect(name: str) -> Response:
    return array_catalogue()[name.partition("@")[0]]


def _as_twin(term: Term, twin: str) -> Term:
    """With the effect of a twin: where one kind of sensor lags, the other leads."""
    effect = _effect(twin)
    sign = 1.0 if effect.channel == term.effect.channel else -1.0
    return replace(term, name=twin, effect=effect, value=sign * term.value)


def _nats(state: ArrayState, name: str) -> float:
    """Log density of the residuals, neighbours counted for what they are worth. A lag of single
    sensors shows against others of their kind: what neighbours' noise brings into dω/dt, other for
    each twin, is in the other kind's residuals, and was worth 36 nats for the wrong one."""
    effect = _effect(name)
    *squares, speed = state.squares()
    return sum(
        float(log_density(noise, square, speed).sum()) / shared_by_neighbours(state, gyro=gyro)
        for noise, square, gyro in zip(state.noise, squares, (False, True), strict=True)
        if effect.shared or gyro == (effect.channel == "angular_rate")
    )
