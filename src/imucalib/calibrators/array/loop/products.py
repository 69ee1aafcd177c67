"""The motion's products: of what is fitted, of all that may be missing, and of the readings.

    A = Zᵀ V⁻¹ Z,  Z = [positions and what the rests left open | components | y]

with the nine unknowns of every sample taken out. All is in absolute numbers: y is what the readings
would be off with everything at its prior's mean, so that products at two linearisations speak of
the same thing. Noise that neighbours share and tails lessen the weights before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.estimate.base import Base
from imucalib.calibrators.array.loop.declared import shared_by_neighbours
from imucalib.calibrators.array.loop.laws import Way, components_of
from imucalib.calibrators.array.loop.setup import looked_at
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.terms import typical_of
from imucalib.estimators.array.gram import Columns, gram, starts_of
from imucalib.estimators.array.reduced import inverse_root
from imucalib.estimators.array.samples import reweighed
from imucalib.loop.posterior.gram import Grams, Multiplied
from imucalib.loop.posterior.odds import FINE_SIZES
from imucalib.loop.posterior.problem import Choice, Contest
from imucalib.loop.posterior.space import Hypothesis, Pick, blocks_of


@dataclass(frozen=True, kw_only=True)
class MotionProblem(Contest):
    """What a motion may lack; what is fitted beside components is integrated out already.

    ways : of every choice
    missing : why effects could not be tried
    seen : (q,) squares of the columns beside the motion, and what free positions leave of them
    moves : (d, q) m by which each column moves free positions at typical size
    """

    ways: tuple[Way, ...]
    missing: dict[str, str]
    seen: tuple[Array, Array]
    moves: Array

    @property
    def sizes(self) -> Array:
        """Those of a component: a motion has thousands of readings."""
        return FINE_SIZES

    def named(self, name: str) -> bool:
        """Whether a way names a cause."""
        at = next(k for k, way in enumerate(self.ways) if way.name == name)
        return self.components[self.choices[at].component].named

    def shown(self, component: int) -> tuple[float, float, float]:
        """Of a component's first member at typical size: the share of its columns that free
        positions leave, their length in units of the noise, and the m rms by which it moves the
        positions."""
        at = next(c.at for c in self.choices if c.component == component)
        before, after = (float(one[at].sum()) for one in self.seen)
        moves = float(np.sqrt(np.sum(np.mean(self.moves[:, at] ** 2, axis=0))))
        return after / max(before, 1e-300), float(np.sqrt(max(after, 0.0))), moves

    def ways_of(self, hypothesis: Hypothesis) -> tuple[Way, ...]:
        """What a set takes into the model."""
        return tuple(self.ways[p.choice] for p in hypothesis.picks)

    def picks(self, state: ArrayState) -> tuple[Pick, ...]:
        """The effects of a state as a set, at their sizes."""
        at = {way.name: k for k, way in enumerate(self.ways)}
        return tuple(Pick(at[t.name], float(t.sd[0])) for t in state.found if t.name in at)

    def moved(self, grams: Grams, hypothesis: Hypothesis, component: int) -> Array:
        """(d,) m by which a component of a set moves the positions."""
        columns = np.concatenate([at for at, _ in blocks_of(self.choices, hypothesis.picks)])
        sizes = [np.full(at.size, s) for at, s in blocks_of(self.choices, hypothesis.picks)]
        rows = grams.rows(columns)[0]
        inner = rows[:, columns] + np.diag(np.concatenate(sizes) ** -2.0)
        value = np.linalg.solve(inner, rows[:, -1])
        own = [p.choice for p in hypothesis.picks if self.choices[p.choice].component == component]
        mine = np.isin(columns, self.choices[own[0]].at)
        return np.asarray(self.moves[:, columns[mine]] @ value[mine])


def products(
    state: ArrayState, left_out: frozenset[str], declared: Sequence[str] = ()
) -> tuple[MotionProblem, Grams]:
    """At a fitted state. left_out : names that are not tried; declared : terms that are no question
    of the search"""
    motion, setup = state.motion, state.setup
    rows = setup.inner[looked_at(setup)]
    asked = any(t.aged for t in state.found if t.name in declared)
    own = tuple(
        t for t in state.terms if t.name in declared or not (t.found or (t.aged and not asked))
    )
    every = components_of(motion.take(rows), state.terms, left_out.union(declared))
    base = Base(setup, state.sampled, motion, state.r, own)
    kappa = [shared_by_neighbours(state, gyro=gyro) for gyro in (False, True)]
    a, g = (n.information / k for n, k in zip(state.noise, kappa, strict=True))
    sampled = reweighed(state.sampled.take(rows), a, g)
    blocks = [Columns(b.basis[:, rows], b.gyro, b.shared) for b in base.blocks]
    found = base.free(gram(sampled, [*blocks, *every.columns], np.arange(len(rows))))
    b = len(base.prior)
    starts = starts_of(every.columns)
    theta = np.concatenate([base.pull / base.prior, np.zeros(starts[-1])])
    ways, choices = list[Way](), list[Choice]()
    for c, (component, mine) in enumerate(zip(every.components, every.ways, strict=True)):
        for way, member in zip(mine, component.members, strict=True):
            ways.append(way)
            choices.append(Choice(c, member, starts[way.block] + way.part, member.log_weight))
    phases = [t.value for t in state.terms if t.aged and not t.found]
    for term in state.found:
        for way, choice in zip(ways, choices, strict=True):
            if way.name == term.name:
                value = term.theta / typical_of(term.effect, len(term.theta))
                theta[b + choice.at] = np.concatenate([value, *(phases if term.aged else ())])
    toward = found.matrix @ theta
    along = found.along + toward
    power = found.power + 2.0 * float(theta @ found.along) + float(theta @ toward)
    whole = np.block([[found.matrix, along[:, None]], [along, np.array([power])]])
    half = inverse_root(whole[:b, :b] + np.diag(base.prior))
    across = half.T @ whole[:b, b:]
    matrix = whole[b:, b:] - across.T @ across
    loose = inverse_root(whole[:b, :b] + np.diag(base.rests))
    carried, square = loose.T @ found.matrix[:b, b:], np.diag(found.matrix)[b:]
    problem = MotionProblem(
        components=every.components,
        choices=tuple(choices),
        base=0,
        ways=tuple(ways),
        missing=every.missing,
        seen=(square, square - np.sum(carried**2, axis=0)),
        moves=loose[: state.positions] @ carried,
    )
    return problem, _grams(matrix, found.power)


def _grams(matrix: Array, numbers: float) -> Grams:
    """With as many numbers as their weights say."""
    return Grams(
        products=Multiplied(matrix[None]),
        removed=np.zeros((1, 0, len(matrix))),
        log_weight=np.zeros(1),
        numbers=numbers,
        points=(),
        spread=np.inf,
    )
