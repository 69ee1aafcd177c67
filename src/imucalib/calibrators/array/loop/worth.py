"""How large a term of the array's model is, what it is worth, what one more would be, and a refit
with it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.candidates import Entry, typical_columns
from imucalib.calibrators.array.loop.earlier import Earlier
from imucalib.calibrators.array.loop.noise_tests import shared_by_neighbours
from imucalib.calibrators.array.loop.setup import looked_at
from imucalib.calibrators.array.loop.state import ArrayState, settled
from imucalib.calibrators.array.loop.terms import Term
from imucalib.core.eigen import eigen
from imucalib.estimators.array.gram import beside_motion, gram
from imucalib.estimators.array.reduced import Alone, alone, reduced
from imucalib.loop.thresholds import BOTH_HALVES, ONE_HALF
from imucalib.significant_digits import plus_minus

_SURE = 3.0  # standard deviations beyond which a value is not the least that is believed
DIVERGED = "its refit did not converge"
TAU = 10.0 ** np.arange(-3.0, 1.1, 0.5)
#: Of what neighbours share, foreseen: on the measured logs within a hundredth of what the refit has
#: wherever that decides.
_SURELY = 0.95
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
    carry : (b, p) the base's coordinates per unit of each column; positions : the first of them"""

    whole: Alone
    halves: tuple[Alone, Alone]
    total: Array
    carry: Array
    positions: int

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
        return float(np.sqrt(np.mean((self.carry[: self.positions] @ self.value) ** 2)))

    @property
    def value(self) -> Array:
        """(p,) its estimate under the size that its own evidence prefers, in typical sizes."""
        return _most_likely(self.whole)

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
    return Beside(whole, halves, total, found.carry.copy(), state.positions)


def shared_ahead(state: ArrayState, entry: Entry, found: Beside) -> float:
    """How many times fewer samples noise that neighbours share would leave beside one candidate
    more, at the least: from the residuals that a refit has to first order, without it."""
    assert entry.effect is not None
    columns = typical_columns(entry.effect, state.motion, entry.only)
    change = state.base.reading(-found.carry @ found.value, state.sampled.off.rate.shape)
    target = change.rate if columns.gyro else change.acceleration
    target += columns.at(found.value)
    left = state.sampled.off.less(beside_motion(state.sampled, change, slice(None)))
    ahead = replace(state, sampled=replace(state.sampled, off=left))
    return max(_SURELY * shared_by_neighbours(ahead, gyro=columns.gyro), 1.0)


def _most_likely(found: Alone) -> Array:
    """Estimate of a block of columns under the size that its own evidence prefers."""
    values, vectors = eigen(found.matrix)
    values, seen = np.maximum(values, 0.0), vectors.T @ found.along
    shrunk = TAU[:, None] ** 2 / (1.0 + TAU[:, None] ** 2 * values)
    evidence = np.sum(shrunk * seen**2 - np.log1p(TAU[:, None] ** 2 * values), axis=1)
    return np.asarray(vectors @ (shrunk[np.argmax(evidence)] * seen))


def settled_or_lost(
    state: ArrayState, *, shaped: bool = True, least: float = -np.inf
) -> ArrayState | None:
    """The joint fit; None where it runs away, as few IMUs allow; least : as `settled` has it."""
    try:
        return settled(state, shaped=shaped, lost=True, least=least)
    except np.linalg.LinAlgError:
        return None


def refitted(state: ArrayState, earlier: Earlier, *more: Term) -> ArrayState | None:
    """The joint fit with more terms; None where it runs away."""
    found = settled_or_lost(earlier.begun(replace(state, terms=(*state.terms, *more))))
    return earlier.kept(found) if found is not None and found.converged else found


def why_not(before: ArrayState, after: ArrayState) -> str:
    if len(after.terms[-1].value) == 0:
        return "these data determine none of its parameters"
    if not after.converged:
        return DIVERGED
    found = implausible(after, after.terms[-1].name)
    if found:
        return f"implausible size ({', '.join(found)})"
    if after.density <= before.density:
        return "the joint fit is not better with it"
    return ""


def implausible(state: ArrayState, name: str) -> list[str]:
    """Sizes of a term that are not believed, in words."""
    term = next(t for t in state.terms if t.name == name)
    parameters, reach = term.parameters(state.setup.imus), _SURE * state.sd_of(term)
    return [
        f"{p.name} = {v:.3g} {p.unit}"
        for p, v, r in zip(parameters, term.theta, reach, strict=True)
        if abs(v) > p.plausible or v + r < p.least
    ]


def shared_noise(p: float) -> str:
    """Why what passes is refused all the same: with as many samples as are left it has this p."""
    return f"noise that neighbours share explains it as well (p {p:.2g})"


def not_held_out(gains: tuple[float, float]) -> str:
    """Why the halves of the motion contradict what gains so many nats in each, or nothing."""
    if min(gains) < ONE_HALF or sum(gains) < BOTH_HALVES:
        return f"it does not hold out: {gains[0]:+.1f} and {gains[1]:+.1f} nats on the other half"
    return ""
