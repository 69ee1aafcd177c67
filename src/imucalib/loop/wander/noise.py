"""The noise of a fitted model: scatter of a run, walk of the bias, and how strange each run is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.balance import Balanced
from imucalib.core.fit import Fit
from imucalib.loop.found import Wander
from imucalib.loop.wander.bank import Bank, bank_of, walks_of
from imucalib.loop.wander.held_blocks import solved
from imucalib.loop.wander.likelihood import Level, Terms, levels
from imucalib.loop.wander.walk import Course, Walk, beside
from imucalib.units import MG

#: Residual over its scatter from which a run counts less (Huber 1964), and 1 / the MAD of a normal.
_FAR, _MAD = 2.5, 1.4826
_ROUNDS = 4
#: Share of the fitted walk up to which an effect may bring its own, and nats behind the likeliest
#: from which a larger walk is out of the question.
ROOM, _BEHIND = 3.5, 40.0
#: Nats behind the likeliest after two rounds from which a walk is not tried again: weights move it
#: no more.
_LOST = 100.0
#: Nats behind the likeliest from which on a walk decides nothing: neither on data drawn from the
#: likeliest ones, nor without one block of twelve, where the day on the wrist moved it by 16.
REACH = 60.0


@dataclass(frozen=True)
class Noise:
    """scatter : mg, of a run beside its windows' noise; course : times, postures and variances in
    units of scatter²; walk : the fitted one; evidence : nats of that walk over none
    wander : mg, rms of what the smoothed walk does to |a|; light : how many runs count less
    walks : that may be the noise of this recording, or of a part of it, the white one first"""

    scatter: float
    course: Course
    walk: Walk
    evidence: float
    wander: float
    light: int
    walks: tuple[Walk, ...]

    @property
    def wandering(self) -> Wander:
        """The walk as it is told."""
        sd = self.scatter * float(np.sqrt(self.walk.rho))
        return Wander(self.wander, self.walk.tau / 3600.0, self.scatter, self.evidence, sd)

    @property
    def sigma(self) -> Array:
        """(n,) mg, the standard deviation of each run without the walk."""
        return np.asarray(self.scatter * np.sqrt(self.course.variance))


def natural(fit: Fit) -> tuple[Array, Array, Array]:
    """Of every row the misfit (n,) and the model's columns (n, p) at typical size, in mg, and what
    it sees of the walks, (n, 4)."""
    unit = fit.at.sigma[:, 0] / MG
    typical = np.array([p.typical for p in fit.parameters])
    return (
        fit.at.residual * unit,
        fit.at.jacobian * unit[:, None] * typical,
        (walk_columns(fit.at, fit.observations.reading)),
    )


def walk_columns(at: Balanced, reading: Array) -> Array:
    """(n, 4) columns of the bias of each axis (1 mg) and of a common scale (1 mg/g), in mg."""
    n = len(reading)
    block = np.broadcast_to(MG * np.eye(3), (n, 1, 3, 3))
    bias = at.columns(block) * at.sigma[:, :1] / MG
    # The normal's sign is that of the linearisation; a larger scale makes every norm larger.
    outward = np.sign(np.einsum("ni,ni->n", bias, reading[:, 0]))
    return np.column_stack([bias, outward])


def noise_of(
    fit: Fit, known: Array, part: Index, precision: Array | None = None, free: int | None = None
) -> Noise:
    """Estimate the noise beside a fitted model.

    known : (n,) mg², the part of each run's variance that its windows and the resolution explain
    precision : (p,) of the parameters' priors in typical sizes, 1 each by default
    free : parameters that no prior holds, which cost a freedom each; all by default
    """
    misfit, columns, seen = natural(fit)
    theta = fit.theta / np.array([p.typical for p in fit.parameters])
    whole = misfit + columns @ theta
    n, p = columns.shape
    precise = np.ones(p) if precision is None else precision
    terms = Terms(np.arange(p), precise, p if free is None else free)
    keep = np.ones(int(part[-1]) + 1, dtype=bool)
    walks = walks_of(fit.observations.context["time"])
    scatter, far = max(_MAD * float(np.median(np.abs(misfit))), 1e-3), np.ones(n)
    tried = walks
    for turn in range(_ROUNDS):
        variance = far**2 * (1.0 + known / scatter**2)
        course = Course(fit.observations.context["time"], seen, variance, part)
        bank = bank_of(course, tried, np.column_stack([columns, whole]) / scatter)
        every = levels(bank, terms, keep)
        best = max(every, key=lambda level: level.nats)
        left = (whole - columns @ solved(bank, terms, best.walk, keep)) / scatter
        white = beside(course, tried[best.walk], left)
        wander = scatter * float(np.sqrt(np.mean((left - white) ** 2)))
        scatter = scatter * float(np.sqrt(best.variance))
        alone = white / np.sqrt(variance) * far
        size = _MAD * float(np.median(np.abs(alone)))
        far = np.sqrt(np.maximum(1.0, np.abs(alone) / max(size, 1e-12) / _FAR))
        nats, walk = {tried[k]: level.nats for k, level in enumerate(every)}, tried[best.walk]
        if turn:  # the first is white, which the walk is held against
            tried = tuple(w for w in tried if w.rho == 0.0 or nats[w] > best.nats - _LOST)
    course = replace(course, variance=far**2 * (1.0 + known / scatter**2))
    gained = best.nats - every[0].nats
    # A smaller noise may come with an effect; a larger one so far behind stays there in every fold.
    likely = tuple(
        one
        for one in walks
        if one.rho <= ROOM * walk.rho or nats.get(one, -np.inf) > best.nats - _BEHIND
    )
    return Noise(
        scatter=scatter, course=course, walk=walk, evidence=gained, wander=wander,
        light=int((far > 1.0).sum()), walks=likely,
    )  # fmt: skip


def usable_walks(bank: Bank, fitted: Level, *, same_tau: bool) -> tuple[int, ...]:
    """Walks that a candidate may bring: up to a little more than the fitted one; `same_tau`: of
    that one's memory only (inside folds, where everything is done many times)."""
    now = bank.walks[fitted.walk]
    return tuple(
        k
        for k, walk in enumerate(bank.walks)
        if walk.rho <= ROOM * now.rho and (not same_tau or walk.rho == 0 or walk.tau == now.tau)
    )


def likely_walks(every: Sequence[Level]) -> tuple[int, ...]:
    """Walks that data like these may come from."""
    most = max(level.nats for level in every)
    return tuple(level.walk for level in every if level.nats > most - REACH)
