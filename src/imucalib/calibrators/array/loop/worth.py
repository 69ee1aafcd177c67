"""How large a term of the array's model is, what it is worth, what one more would be, and refits
with it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.candidates import Entry, typical_columns
from imucalib.calibrators.array.loop.catalogue import array_catalogue, twins_of
from imucalib.calibrators.array.loop.earlier import Earlier
from imucalib.calibrators.array.loop.setup import looked_at
from imucalib.calibrators.array.loop.state import ArrayState, settled
from imucalib.calibrators.array.loop.terms import Term
from imucalib.core.eigen import eigen
from imucalib.estimators.array.gram import gram
from imucalib.estimators.array.reduced import Alone, alone, reduced
from imucalib.significant_digits import plus_minus

_SURE = 3.0  # standard deviations beyond which a value is not the least that is believed
_DIVERGED = "its refit did not converge"
TAU = 10.0 ** np.arange(-3.0, 1.1, 0.5)
_APART = 0.2  # share of a curve's direction that the base must leave


def size_in_words(state: ArrayState, term: Term) -> str:
    """The one value with its deviation, or the rms of many."""
    parameters = term.parameters(state.setup.imus)
    sd = state.sd_of(term)
    units = {p.unit for p in parameters}
    if len(parameters) == 1:
        return plus_minus(float(term.theta[0]), float(sd[0]), parameters[0].unit)
    if len(parameters) <= 3:
        values = ", ".join(f"{v:.3g}" for v in term.theta)
        return f"{values} {parameters[0].unit}"
    rms = float(np.sqrt(np.mean(term.theta**2)))
    return f"{rms:.2g} {units.pop()} rms, {term.live.shape[1]} of {len(parameters)} determined"


def worth(state: ArrayState, term: Term) -> float:
    """Evidence (nats) of a term beside all others, from the joint covariance."""
    at = state.positions
    for other in state.terms:
        if other.name == term.name:
            break
        at += len(other.value)
    part = slice(at, at + len(term.value))
    precision = np.linalg.inv(state.covariance[part, part])
    log_ratio = np.linalg.slogdet(precision * np.outer(term.sd, term.sd))[1]
    return float(0.5 * term.value @ precision @ term.value - 0.5 * log_ratio)


@dataclass(frozen=True)
class Beside:
    """One candidate by itself, its columns with the base taken out: whole, over all samples that a
    search looks at, and over each held-out half. total : (p, p) before the base was taken out;
    carry : (d, p) positions per unit of each column"""

    whole: Alone
    halves: tuple[Alone, Alone]
    total: Array
    carry: Array

    @property
    def held_out(self) -> tuple[float, float]:
        """Nats that each half gains when the other has estimated the candidate and its size."""
        gains = []
        for one, two in (self.halves, self.halves[::-1]):
            value = _most_likely(one)
            gains.append(float(two.along @ value - 0.5 * value @ two.matrix @ value))
        return gains[0], gains[1]

    @property
    def moves(self) -> float:
        """m rms over the positions' coordinates: what taking it in would move them by."""
        return float(np.sqrt(np.mean((self.carry @ _most_likely(self.whole)) ** 2)))

    @property
    def apart(self) -> Array:
        """(p, q) orthonormal directions of which the positions and terms take little: in the others
        a curve would trade off against the answer, whatever its cause."""
        values, vectors = eigen(self.total)
        seen = values > 1e-9 * float(values[-1])
        white = vectors[:, seen] / np.sqrt(values[seen])
        share, turn = eigen(white.T @ self.whole.matrix @ white)
        return np.asarray(np.linalg.qr(white @ turn[:, share >= _APART])[0])


def beside(state: ArrayState, entry: Entry) -> Beside:
    """A candidate beside the fit, in typical sizes."""
    assert entry.effect is not None
    state = replace(state)  # the columns of its base go with it: of many IMUs they are large
    base, setup, some = state.base, state.setup, looked_at(state.setup)
    blocks = [*base.blocks, typical_columns(entry.effect, state.motion, entry.only)]
    first, b = setup.first[some], len(base.prior)
    one, two = (
        base.free(gram(state.sampled, blocks, setup.inner[some[rows]])) for rows in (first, ~first)
    )
    halves = alone(one, base.rests), alone(two, base.rests)
    both = one.added(two)
    total = both.matrix[b:, b:].copy()
    found = reduced(both, base.rests, base.pull * (base.rests > 0.0))
    whole = Alone(found.matrix.copy(), found.along)
    return Beside(whole, halves, total, found.carry[: state.positions].copy())


def _most_likely(found: Alone) -> Array:
    """Estimate of a block of columns under the size that its own evidence prefers."""
    values, vectors = eigen(found.matrix)
    values, seen = np.maximum(values, 0.0), vectors.T @ found.along
    shrunk = TAU[:, None] ** 2 / (1.0 + TAU[:, None] ** 2 * values)
    evidence = np.sum(shrunk * seen**2 - np.log1p(TAU[:, None] ** 2 * values), axis=1)
    return np.asarray(vectors @ (shrunk[np.argmax(evidence)] * seen))


@dataclass(frozen=True)
class Tried:
    """A refit with one term more, or why there is none; rivals : twins that would do as well, or
    whose own refit is lost."""

    state: ArrayState | None
    reason: str = ""
    rivals: tuple[str, ...] = ()


def best_of_twins(
    state: ArrayState, term: Term, earlier: Earlier, left_out: Collection[str], margin: float
) -> Tried:
    """The joint fit with one term more, or with the twin of it that fits better.

    left_out : effects that are not tried; margin : nats up to which another twin would do as well
    """
    twins = [twin for twin in twins_of(term.name) if twin not in left_out]
    trial = refitted(state, term, earlier)
    reason = _DIVERGED if trial is None else why_not(state, trial)
    if trial is not None and trial.converged:
        fits = _twins(trial, term.name, twins)
    else:
        fits = {twin: refitted(state, _as_twin(term, twin), earlier) for twin in twins}
    fits[term.name] = trial if trial is None or not twins else _as_near(trial)
    sound = {n: s for n, s in fits.items() if s is not None and not why_not(state, s)}
    if not sound:
        return Tried(None, reason)
    best, rivals = _nearest(sound, margin)
    return Tried(sound[best], "", (*rivals, *_open(fits)))


def told_apart(
    state: ArrayState, name: str, twins: Sequence[str], margin: float
) -> tuple[ArrayState, str, tuple[str, ...]]:
    """Of a joint fit, the term of this name or its twin that fits better: the fit with it, its
    name, and those that would do as well, or whose fit is lost."""
    fits = _twins(state, name, twins)
    sound = {n: s for n, s in fits.items() if s is not None and s.converged}
    sound = {n: s for n, s in sound.items() if not _implausible(s, n)} | {name: _as_near(state)}
    best, rivals = _nearest(sound, margin)
    return sound[best], best, (*rivals, *_open(fits))


def _twins(state: ArrayState, name: str, twins: Sequence[str]) -> dict[str, ArrayState | None]:
    """Joint fits with twins in the place of a term, begun at its values; not where these are none
    that the twin could have."""
    found: dict[str, ArrayState | None] = {}
    for twin in twins:
        terms = (_as_twin(t, twin) if t.name == name else t for t in state.terms)
        start = replace(state, terms=tuple(terms))
        if not _implausible(start, twin):
            found[twin] = _settled(start, shaped=False)
    return found


def _as_near(state: ArrayState) -> ArrayState:
    """A fit as near its end as those of its twins: the way that is left was worth five nats."""
    nearer = _settled(state, shaped=False)
    return nearer if nearer is not None and nearer.converged else state


def _open(fits: Mapping[str, ArrayState | None]) -> tuple[str, ...]:
    """Twins whose fit was lost: nothing is known against them."""
    return tuple(n for n, s in fits.items() if s is None or not s.converged)


def _settled(state: ArrayState, *, shaped: bool = True) -> ArrayState | None:
    """The joint fit; None where it runs away, as few IMUs allow."""
    try:
        return settled(state, shaped=shaped, lost=True)
    except np.linalg.LinAlgError:
        return None


def _as_twin(term: Term, twin: str) -> Term:
    """With the effect of a twin: where one kind of sensor lags, the other leads."""
    effect = array_catalogue()[twin.partition("@")[0]]
    sign = 1.0 if effect.channel == term.effect.channel else -1.0
    return replace(term, name=twin, effect=effect, value=sign * term.value)


def _nearest(fits: Mapping[str, ArrayState], margin: float) -> tuple[str, tuple[str, ...]]:
    """The name of the best fit of twins, and of those that do as well; where the one that a search
    has for all is among these, it stays."""
    bar = max(s.density for s in fits.values()) - margin
    near = sorted((n for n, s in fits.items() if s.density > bar), key=lambda n: -fits[n].density)
    plain = [n for n in near if not array_catalogue()[n.partition("@")[0]].twin]
    best = (plain or near)[0]
    return best, tuple(n for n in near if n != best)


def refitted(state: ArrayState, term: Term, earlier: Earlier) -> ArrayState | None:
    """The joint fit with one term more; None where it runs away."""
    found = _settled(earlier.begun(replace(state, terms=(*state.terms, term))))
    return earlier.kept(found) if found is not None and found.converged else found


def why_not(before: ArrayState, after: ArrayState) -> str:
    if len(after.terms[-1].value) == 0:
        return "these data determine none of its parameters"
    if not after.converged:
        return _DIVERGED
    implausible = _implausible(after, after.terms[-1].name)
    if implausible:
        return f"implausible size ({', '.join(implausible)})"
    if after.density <= before.density:
        return "the joint fit is not better with it"
    return ""


def _implausible(state: ArrayState, name: str) -> list[str]:
    """Sizes of a term that are not believed, in words."""
    term = next(t for t in state.terms if t.name == name)
    parameters, reach = term.parameters(state.setup.imus), _SURE * state.sd_of(term)
    return [
        f"{p.name} = {v:.3g} {p.unit}"
        for p, v, r in zip(parameters, term.theta, reach, strict=True)
        if abs(v) > p.plausible or v + r < p.least
    ]
