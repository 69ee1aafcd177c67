"""Noise of a recording: scatter of a run, heavy tails by weights, and walks that go on through all.

    n ~ N(0, s² V),   V = diag(d) + Σ_j r_j² K ∘ h_j h_jᵀ,   d = f² (1 + known / s²),
    K(t, t') = exp(-|t - t'| / memory)

h_j is what a bias of one axis does to each run's number; sizes r and memory are points over which
every evidence is summed. The weights f of runs that are unlike the others (Huber 1964) come from
what remains beside the smoothed walk, so that what jumps or drifts does not make a run an outlier.

Ornstein-Uhlenbeck walks are Markov: Kalman's filter gives L⁻¹ of the Cholesky factor L of V at a
cost linear in n (Kalman 1960; Harvey 1989, 3.4), here for a block of rows at a time, whose own
factor is dense. Rows that are left out stand nowhere in V: the walk goes on through the gap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.balance import Noise
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.estimators.least_squares import evaluate
from imucalib.posterior.closed_loop.found import BiasWalk
from imucalib.posterior.odds import (
    DEEPEST,
    HEARD,
    OPEN,
    ROUNDS,
    SIZES,
    UNLIKE,
    WALK_MEMORY,
    WALK_SIZE,
    WANDERS,
)
from imucalib.posterior.search.catalogue import Member
from imucalib.posterior.search.gram import Grams, Unmultiplied, log_sum, marginalize
from imucalib.posterior.search.noise import diagonal_logs
from imucalib.posterior.search.problem import Choice, Problem
from imucalib.posterior.search.space import NARROW, block_logs
from imucalib.units import MG

#: Rows that are whitened at once, and numbers.
_BLOCK, _AT_ONCE = 16, 1 << 20
#: One over the median absolute deviation of a normal number.
_MAD = 1.4826


@dataclass(frozen=True)
class WalkWhitener:
    """L⁻¹ at E noises, by blocks of b rows, the last filled up with rows of nothing.

    inverse : (blocks, E, b, b) L⁻¹ of a block given the rows before; seen : (blocks, E, b, q) what
    the walks at the end of the block before do to it; keep : (blocks, E) of these walks; gain :
    (blocks, E, q, b) by which the white rows move them; log_det : (E,) log|V|
    """

    inverse: Array
    seen: Array
    keep: Array
    gain: Array
    log_det: Array

    @property
    def noises(self) -> int:
        """E"""
        return self.log_det.size

    def of(self, noises: Index | slice) -> WalkWhitener:
        """At some of the noises."""
        return WalkWhitener(
            self.inverse[:, noises],
            self.seen[:, noises],
            self.keep[:, noises],
            self.gain[:, noises],
            self.log_det[noises],
        )

    def __call__(self, columns: Array) -> Array:
        """(E, n, m) L⁻¹ columns, of columns (n, m)."""
        n, m = columns.shape
        out = np.empty((self.log_det.size, len(self.keep) * _BLOCK, m))
        state = np.zeros((self.log_det.size, self.gain.shape[2], m))
        for k in range(len(self.keep)):
            rows = slice(k * _BLOCK, (k + 1) * _BLOCK)
            own = columns[rows]
            # One product for all noises.
            whole = self.inverse[k, :, :, : len(own)].reshape(-1, len(own)) @ own
            white = whole.reshape(self.log_det.size, _BLOCK, m)
            white -= self.seen[k] @ state
            out[:, rows] = white
            state = self.keep[k][:, None, None] * state + self.gain[k] @ white
        return out[:, :n]

    def back(self, white: Array) -> Array:
        """(E, n, m) L⁻ᵀ of columns (E, n, m)."""
        e, n, m = white.shape
        own = np.zeros((e, len(self.keep) * _BLOCK, m))
        own[:, :n] = white
        state = np.zeros((e, self.gain.shape[2], m))
        for k in reversed(range(len(self.keep))):
            rows = slice(k * _BLOCK, (k + 1) * _BLOCK)
            moved = own[:, rows] + self.gain[k].swapaxes(1, 2) @ state
            own[:, rows] = self.inverse[k].swapaxes(1, 2) @ moved
            state = self.keep[k][:, None, None] * state - self.seen[k].swapaxes(1, 2) @ moved
        return own[:, :n]


def whitener(time: Array, variance: Array, shares: Array, memory: Array) -> WalkWhitener:
    """At E noises. time : (n,) s, increasing; variance : (E, n) d; shares : (E, n, q) the h_j, or
    one for all noises; memory : (E,) s"""
    (e, n), q = variance.shape, shares.shape[2]
    blocks = -(-n // _BLOCK)
    rows = np.minimum(np.arange(blocks * _BLOCK), n - 1).reshape(blocks, _BLOCK)
    real = (np.arange(blocks * _BLOCK) < n).reshape(blocks, 1, _BLOCK)
    at = time[rows]
    before = time[np.maximum(rows[:, 0] - 1, 0)]
    near = np.exp(-np.abs(at[:, None, :, None] - at[:, None, None]) / memory[:, None, None])
    keep = np.exp(-(at - before[:, None])[:, None] / memory[:, None])
    h = np.broadcast_to(shares, (e, n, q))[:, rows].swapaxes(0, 1) * real[..., None]
    whole = near * (h @ h.swapaxes(2, 3))
    diagonal = np.arange(_BLOCK)
    whole[..., diagonal, diagonal] += np.where(real, variance[:, rows].swapaxes(0, 1), 1.0)
    kept = keep[..., None] * h
    last = near[..., -1:] * h
    inverse = np.empty((blocks, e, _BLOCK, _BLOCK))
    gain = np.empty((blocks, e, q, _BLOCK))
    off, log_det = np.zeros((e, q, q)), np.zeros(e)
    for k in range(blocks):
        on = keep[k, :, -1, None, None]
        lower = np.linalg.cholesky(whole[k] + kept[k] @ off @ kept[k].swapaxes(1, 2))
        log_det += 2.0 * np.log(lower[:, diagonal, diagonal]).sum(axis=1)
        inverse[k] = np.linalg.inv(lower)
        gain[k] = (inverse[k] @ (last[k] + on * kept[k] @ off)).swapaxes(1, 2)
        off = on**2 * off - gain[k] @ gain[k].swapaxes(1, 2)
    return WalkWhitener(inverse, inverse @ kept, keep[:, :, -1], gain, log_det)


@dataclass(frozen=True)
class WalkNoise:
    """size : (q,) of the walk of each share, over the scatter; memory : s; log_prior : of it"""

    size: Array
    memory: float
    log_prior: float


@dataclass(frozen=True)
class RunCourse:
    """Runs in order of time, and what their noise may be.

    scatter : m/s², the unit; time : (n,) s; variance : (n,) d; shares : (n, q) h of unit walks
    walks : that are weighed, none first; likeliest : of them beside a fit; light : how many runs
    count less
    """

    scatter: float
    time: Array
    variance: Array
    shares: Array
    walks: tuple[WalkNoise, ...]
    likeliest: WalkNoise
    light: int = 0

    def whitener(self, walks: tuple[WalkNoise, ...]) -> WalkWhitener:
        """Of some walks."""
        shares = np.array([self.shares * w.size for w in walks])
        variance = np.broadcast_to(self.variance, (len(walks), self.time.size))
        return whitener(self.time, variance, shares, np.array([w.memory for w in walks]))

    def white(self, unit: Array) -> Callable[[Array], Array]:
        """What whitens columns (n, m) in units (n,) m/s², under the likeliest walk."""
        whitens = self.whitener((self.likeliest,))
        return lambda columns: whitens(
            (columns.T * (unit / self.scatter)).T.reshape(len(unit), -1)
        )[0].reshape(columns.shape)

    def multiply(self, columns: Array) -> tuple[Array, Array]:
        """(E, q, q) products of columns (n, q) under every walk, and (E,) log prior less half of
        log |V|."""
        white = self.whitener(self.walks)
        gram = np.empty((len(self.walks), columns.shape[1], columns.shape[1]))
        step = max(1, _AT_ONCE // columns.size)
        for k in range(0, len(gram), step):
            own = white.of(slice(k, k + step))(columns)
            np.matmul(own.swapaxes(1, 2), own, out=gram[k : k + step])
        return gram, self.log_weight(white)

    def log_weight(self, white: WalkWhitener) -> Array:
        """(E,) log prior less half of log |V| under every walk."""
        return np.array([w.log_prior for w in self.walks]) - 0.5 * white.log_det


def fit_at(model: Model, data: Observations, theta: Array, covariance: Array) -> Fit:
    """A model at parameters that were found, each run turned as it is corrected there."""
    eta = data.reference.start(model.correct(theta, data.reading, data.context))
    return replace(evaluate(model, data, theta, covariance, eta=eta), noise=Noise(1.0))


def course_of(
    fit: Fit, known: Array, before: RunCourse | None = None
) -> tuple[RunCourse, BiasWalk]:
    """The noise beside a fitted model, and the likeliest walk in words.

    known : (n,) m²/s⁴, the part of each run's variance that its windows and the resolution explain
    before : the noise beside another model, from which it settles in fewer rounds
    """
    at, data = fit.at, fit.observations
    unit = at.sigma[:, 0]
    misfit, columns = at.residual * unit, at.jacobian * unit[:, None]
    columns = columns / np.maximum(np.abs(columns).max(axis=0), 1e-300)
    walks = _walks(data.context["time"])
    axes = np.broadcast_to(np.eye(3), (data.n, 1, 3, 3))
    course = before or RunCourse(
        scatter=max(_MAD * float(np.median(np.abs(misfit))), 1e-3 * MG),
        time=data.context["time"],
        variance=np.ones(data.n),
        shares=at.columns(axes) * at.sigma[:, :1],
        walks=walks,
        likeliest=walks[0],
    )
    for _ in range(ROUNDS // 2 if before else ROUNDS):
        every = np.column_stack([columns, misfit]) / course.scatter
        course, drift = _settle(course, every, known)
    return course, drift


def _walks(time: Array) -> tuple[WalkNoise, ...]:
    """None, and walks of the bias of each axis."""
    span = float(np.ptp(time))
    some = [(np.full(3, size), memory * span) for size in WALK_SIZE for memory in WALK_MEMORY]
    none = WalkNoise(np.zeros(3), span, float(np.log(1.0 - WANDERS)))
    return (none, *(WalkNoise(s, m, float(np.log(WANDERS / len(some)))) for s, m in some))


def _settle(course: RunCourse, every: Array, known: Array) -> tuple[RunCourse, BiasWalk]:
    """Weights, scatter and walk once more; every : (n, p + 1) columns and the misfit over the
    scatter."""
    gram, weight = course.multiply(every)
    sizes = diagonal_logs(gram, 1e-12)
    dof = len(every) - every.shape[1] + 1
    logs = weight - sizes[:, :-1].sum(axis=1) - dof * sizes[:, -1]
    # Walks stand together against none.
    together = float(log_sum(logs[1:]))
    best = 1 + int(np.argmax(logs[1:])) if together > logs[0] else 0
    walk, factor = course.walks[best], float(np.exp(sizes[best, -1])) / np.sqrt(dof)
    # The misfit less its columns by generalised least squares, and less the smoothed walk.
    whitens = course.whitener((walk,))
    white = whitens(every)[0]
    theta = np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=1e-10)[0]
    alone = every[:, -1] - every[:, :-1] @ theta
    rest = course.variance * whitens.back(whitens(alone[:, None]))[0, :, 0]
    scatter = factor * course.scatter
    drift = BiasWalk(
        size=float(np.sqrt(np.mean((alone - rest) ** 2))) * course.scatter / MG,
        hours=walk.memory / 3600.0,
        scatter=scatter / MG,
        evidence=together - float(logs[0]) if best else 0.0,
        sd=scatter / MG * float(walk.size[0]),
    )
    size = np.abs(rest) / np.sqrt(1.0 + known / course.scatter**2)
    far = np.maximum(1.0, size / max(_MAD * float(np.median(size)), 1e-12) / UNLIKE)
    variance = far * (1.0 + known / scatter**2)
    light = int((far > 1.0).sum())
    return replace(course, scatter=scatter, variance=variance, likeliest=walk, light=light), drift


def multiply_course(problem: Problem, course: RunCourse) -> Grams:
    """At all walks of a course, which go on through runs that are left out."""
    white = course.whitener(course.walks)

    def inverse(walk: WalkNoise) -> Callable[[Array], Array]:
        own = course.whitener((walk,))
        return lambda columns: own.back(own(columns))[0]

    return Grams(
        products=Unmultiplied(problem.columns, white),
        removed=np.zeros((len(course.walks), 0, problem.columns.shape[1])),
        log_weight=course.log_weight(white),
        numbers=problem.numbers,
        points=course.walks,
        spread=np.inf,
        columns=problem.columns,
        inverse=inverse,
    )


def score_walks(
    problem: Problem, grams: Grams, chosen: Sequence[tuple[Member, float]] = ()
) -> tuple[Index, dict[str, list[str]]]:
    """One look at every narrow member under every walk. chosen : members and their sizes

    Returns the walks that the data do not exclude, be the base complete, lack what is chosen, or
    any one thing more, since what a model lacks looks like a walk; and by component the values of
    scans that lead the base far under some walk: what jumps under one is a walk under another.
    """
    place = {c.member.free: c.at for c in problem.choices}
    blocks = [(place[m.free], size) for m, size in chosen if m.free in place]
    base = marginalize(grams, problem.flat)
    found, values = np.zeros(len(grams.points), bool), dict[str, list[str]]()
    every = _narrow(problem)
    wholes = [grams.products.blocks(_columns(problem, some)) for some in every]
    for one in (base, marginalize(base, *blocks)) if blocks else (base,):
        logs = _profiles(problem, one, every, wholes)
        likely = logs.max(axis=0) > logs.max() - HEARD
        found |= (logs[:, likely] > logs[:, likely].max(axis=0) - HEARD).any(axis=1)
        lead = (logs[:, 1:] - logs[:, :1]).max(axis=0)
        best = dict[str, tuple[float, Member]]()
        for k, nats in zip(np.concatenate([*every, np.zeros(0, np.intp)]), lead, strict=True):
            name = problem.components[problem.choices[k].component].name
            if name.endswith("@") and (name not in best or nats > best[name][0]):
                best[name] = nats, problem.choices[k].member
        for name, (nats, member) in best.items():
            if nats > OPEN:
                values.setdefault(name, []).extend(member.values(name))
    return np.flatnonzero(found), values


def with_jumps(problem: Problem, grams: Grams) -> Problem:
    """With members of scans that act several times: what leads beside those before it, one after
    the other, where nothing walks. A walk swallows each jump by itself, and not all together."""
    still, dof = grams.of(np.zeros(1, np.intp)), grams.numbers - problem.base
    more = list[Choice]()
    for k, component in enumerate(problem.components):
        if component.kind != "name" or not component.name.endswith("@"):
            continue
        every = [c for c in problem.choices if c.component == k]
        index, taken = np.array([c.at for c in every]), list[Choice]()
        own, whole = marginalize(still, problem.flat), still.products.blocks(index)
        while len(taken) < DEEPEST:
            logs = block_logs(own, index, SIZES, dof, whole)[0][0]
            at, size = np.unravel_index(np.argmax(logs), logs.shape)
            if any(c is every[at] for c in taken) or logs[at, size] < own.evidence(dof) + OPEN:
                break
            taken.append(every[at])
            own = marginalize(own, (every[at].at, float(SIZES[size])))
            if len(taken) > 1:
                more.append(_join(taken, float(problem.odds[k])))
    return replace(problem, choices=(*problem.choices, *more))


def _join(taken: Sequence[Choice], odds: float) -> Choice:
    """Members of one component as one; odds : log prior odds of each after the first."""
    effects = tuple(effect for c in taken for effect in c.member.effects)
    weight = sum(c.log_weight for c in taken) + odds * (len(taken) - 1)
    at = np.concatenate([c.at for c in taken])
    return Choice(taken[0].component, Member(effects, weight), at, weight)


def _narrow(problem: Problem) -> list[Index]:
    """Choices that are narrow, by their widths."""
    width = np.array([c.at.size for c in problem.choices], dtype=int)
    return [np.flatnonzero(width == w) for w in np.unique(width[width <= NARROW])]


def _columns(problem: Problem, some: Index) -> Index:
    """(m, w) columns of some choices of one width."""
    return np.array([problem.choices[k].at for k in some])


def _profiles(
    problem: Problem, grams: Grams, every: Sequence[Index], wholes: Sequence[Array]
) -> Array:
    """(E, 1 + m) log evidence under every walk of what is there and of each narrow choice beside it
    at its likeliest size. wholes : the products of each width's blocks"""
    dof = grams.numbers - problem.base
    logs = [(grams.log_weight + grams.log_noise(grams.power, dof))[:, None]]
    for some, whole in zip(every, wholes, strict=True):
        index = _columns(problem, some)
        logs.append(block_logs(grams, index, SIZES, dof, whole)[0].max(axis=2))
    return np.hstack(logs)
