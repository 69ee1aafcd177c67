"""Of an array's finished search: the motion that would end each of its ambiguities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.loop.catalogue import array_catalogue, twins_of
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.loop.motion import BoardMotion, board_motion
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.terms import Term, columns_of, typical_of
from imucalib.calibrators.array.separate.menu import SECONDS, MenuMotion, Motion, menu, times
from imucalib.core.effect import Response
from imucalib.estimators.array.gram import Columns, gram
from imucalib.estimators.array.reduced import Gram
from imucalib.estimators.array.samples import Readings, Weights, fit_samples
from imucalib.loop.found import Step
from imucalib.loop.separation.choice import Pool
from imucalib.loop.separation.plan import Separation
from imucalib.loop.separation.products import Ambiguity, Products
from imucalib.loop.separation.repeated import repeated

#: Samples of the recording that stand for all, times IMUs.
_READINGS, _FEWEST = 2400, 96
#: After the recording, in its own lengths: when drifts are judged.
_LATER = 1.05

#: rad/s, what a hand or a drill gives at most.
_FASTEST = 35.0

Rival = tuple[str, Response, int | None]


@dataclass(frozen=True)
class MotionPlan:
    """separation : how far one motion of the menu tells rivals apart; motion : that motion, None
    where none does; seconds : how long it takes"""

    separation: Separation
    motion: MenuMotion | None
    seconds: float


def motion_plans(loop: MotionLoop, rng: np.random.Generator) -> tuple[MotionPlan, ...]:
    """Of every named effect with rivals."""
    plans = [_of_step(loop, step, rng) for step in loop.named if step.aliases]
    return tuple(one for one in plans if one is not None)


def _of_step(loop: MotionLoop, step: Step, rng: np.random.Generator) -> MotionPlan | None:
    state = loop.final
    term = next((t for t in state.terms if t.name == step.effect), None)
    # Twins have the same columns in every motion: how fast it is tells them apart, not which.
    names = [n for n in (step.effect, *step.aliases) if n not in twins_of(step.effect)]
    rivals = [r for name in names if (r := _rival(state, name)) is not None]
    if term is None or len(rivals) < 2 or rivals[0][0] != step.effect:
        return None
    without = replace(state, terms=tuple(t for t in state.terms if t is not term))
    nats = {s.name: s.evidence for s in loop.first_scores} | {step.effect: step.evidence}
    ambiguity = _ambiguity(without, term, rivals, loop.dispersion)
    ambiguity = replace(ambiguity, nats={n: float(nats.get(n, np.nan)) for n, _, _ in rivals})
    motions = menu(min(state.setup.board.gyroscope_range, _FASTEST))
    t = times(state.setup.interval)
    grams = [_products(_moved(without, one.at(t), t, rng), rivals, None) for one in motions]
    # Of the samples of a piece those that were looked at stand for all.
    often = SECONDS / state.setup.interval / len(t) / loop.dispersion
    pool = Pool(np.stack([often * g.matrix for g in grams]), often * float(grams[0].numbers))
    made = repeated(ambiguity, pool, rng)
    chosen = motions[made.plan[0]] if made.plan else None
    return MotionPlan(made, chosen, SECONDS * len(made.plan))


def _rival(state: ArrayState, name: str) -> Rival | None:
    effect, at, imu = name.partition("@")
    found = array_catalogue().get(effect)
    if found is None or (at and imu not in state.setup.imus):
        return None
    return name, found, state.setup.imus.index(imu) if at else None


def _columns(rivals: Sequence[Rival], motion: BoardMotion) -> list[Columns]:
    found = []
    for _, effect, only in rivals:
        columns = columns_of(effect, motion, only)
        typical = np.array([p.typical for p in effect.each])
        found.append(Columns(columns.basis * typical, columns.gyro, columns.shared))
    return found


def _products(state: ArrayState, rivals: Sequence[Rival], rows: Index | None) -> Gram:
    """Of the base's free coordinates and the rivals' columns."""
    base = state.base
    some = np.arange(len(state.sampled.rate)) if rows is None else rows
    blocks = [*base.blocks, *_columns(rivals, state.motion)]
    return base.free(gram(state.sampled, blocks, some.astype(np.intp)))


def _ambiguity(
    state: ArrayState, term: Term, rivals: Sequence[Rival], dispersion: float
) -> Ambiguity:
    """state : without the term, whose part is put back into what is left"""
    most = max(_READINGS // state.setup.triads, _FEWEST)
    inner = state.setup.inner
    rows = inner[np.linspace(0, len(inner) - 1, min(most, len(inner))).astype(np.intp)]
    found = _products(state, rivals, rows)
    often = len(inner) / len(rows) / dispersion
    b = len(found.matrix) - sum(c.size for c in _columns(rivals, state.motion))
    ends = b + np.cumsum([0, *(c.size for c in _columns(rivals, state.motion))])
    theta = np.zeros(len(found.matrix))
    own = slice(ends[0], ends[1])
    theta[own] = term.theta / typical_of(term.effect, ends[1] - ends[0])
    along, back = found.along * often, found.matrix @ theta * often
    matrix = found.matrix * often
    matrix[range(b), range(b)] += state.base.prior
    power = found.power * often + 2.0 * float(theta @ along) + float(theta @ back)
    names = [name for name, _, _ in rivals]
    return Ambiguity(
        effect=term.name,
        base=(),
        columns=tuple(str(k) for k in range(len(matrix))),
        rivals=tuple(names),
        blocks={n: np.arange(a, z) for n, a, z in zip(names, ends, ends[1:], strict=False)},
        nats={},
        products=Products(matrix, along + back, power, found.numbers * often),
        dof=max(found.numbers * often - b, 1.0),
    )


def _moved(state: ArrayState, planned: Motion, t: Array, rng: np.random.Generator) -> ArrayState:
    """The state in another motion, read without noise."""
    k, n = state.setup.triads, len(t)
    spin = _cross(planned.spin) + _cross(planned.rate) @ _cross(planned.rate)
    force = planned.force[:, None] + np.einsum("tij,kj->tki", spin, state.r)
    rate = np.repeat(planned.rate[:, None], k, axis=1)
    speed, nothing = np.linalg.norm(planned.rate, axis=1), np.zeros((n, k))
    weights = Weights(*(noise.weight(nothing, speed) for noise in state.noise))
    sampled = fit_samples(Readings(force, rate), weights, state.r, planned.rate)
    jerk = np.gradient(force, axis=0) / np.gradient(t)[:, None, None]
    age = None if state.motion.age is None else rng.uniform(-0.5, 0.5, (n, k))
    motion = board_motion(
        imus=state.setup.imus, rotations=state.setup.board.rotations, t=t,
        order=np.full(n, _LATER), rate=sampled.rate, spin=sampled.spin, force=sampled.force,
        jerk=jerk, age=age,
    )  # fmt: skip
    return replace(state, sampled=sampled, motion=motion)


def _cross(v: Array) -> Array:
    out = np.zeros((*v.shape[:-1], 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i, j], out[..., j, i] = -v[..., k], v[..., k]
    return out
