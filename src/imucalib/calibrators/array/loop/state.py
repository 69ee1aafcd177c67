"""Where the array's loop stands: positions, terms, noise and motion, fitted together.

Positions and terms by Gauss-Newton with the motion of every sample taken out, weights by the noise,
which is estimated along. Every basis is taken at the fitted motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.estimate.base import Base
from imucalib.calibrators.array.loop.motion import BoardMotion
from imucalib.calibrators.array.loop.setup import Setup, motion_at
from imucalib.calibrators.array.loop.terms import Term, lagging, lost, sensed
from imucalib.estimators.array.followed import not_followed
from imucalib.estimators.array.gram import beside_motion, gradient, gram
from imucalib.estimators.array.noise import SensorNoise, Squares, chosen_noise, log_density, scaled
from imucalib.estimators.array.reduced import inverse_root
from imucalib.estimators.array.samples import Readings, Sampled, Weights, fit_samples

#: Newton steps at most, those before which the matrix is made again in any case, and the squared
#: steps at which a fit is settled: one in the search, which compares nats, and one that is stated.
_ROUNDS, _AGAIN, _NEAR, _CLOSE = 30, (0, 8, 16, 24), 0.4, 0.05
#: Change of the noise from which the matrix no longer serves.
_STALE = 0.1
#: Rounds of a motion with the weights that its residuals ask for, at one step of what is fitted.
_WEIGHED = 2
#: Of a lost fit: step of a position in its prior's sd, growth of a squared step; of a stray one.
_RUNAWAY, _GROWN, _AWAY = 10.0, 1e3, 2.0
#: Nats that may still come: squared steps, of which a quadratic has a half; and by other widths.
_AHEAD, _WIDTHS = 5.0, 30.0


class Behind(Exception):
    """A fit cannot have the density that it is asked for."""


@dataclass(frozen=True)
class ArrayState:
    """r : (K, 3) m, the first at zero; terms; noise of accelerometers and gyros; sampled : the
    fitted motion; motion : the same for effects; covariance : of positions and terms' coordinates;
    density : nats, of the data with positions and terms integrated out (Laplace)"""

    setup: Setup
    r: Array
    terms: tuple[Term, ...]
    noise: tuple[SensorNoise, SensorNoise]
    sampled: Sampled
    motion: BoardMotion
    covariance: Array
    density: float
    converged: bool

    @property
    def positions(self) -> int:
        return 3 * (self.setup.triads - 1)

    @cached_property
    def base(self) -> Base:
        return Base(self.setup, self.sampled, self.motion, self.r, self.terms)

    def measured(self, covariance: Array, density: float) -> ArrayState:
        """The same with these: nothing that its base stands on has moved."""
        same = replace(self, covariance=covariance, density=density)
        same.__dict__["base"] = self.base
        return same

    @property
    def found(self) -> tuple[Term, ...]:
        return tuple(term for term in self.terms if term.found)

    def squares(self, off: Readings | None = None) -> tuple[Squares, Squares, Array]:
        """Residuals of accelerometers and gyros at the inner samples as their noise is judged by,
        and the speed (inner,) rad/s; off : (T, K, 3) other residuals."""
        off, inner = off or self.sampled.off, self.setup.inner
        found = []
        for values, kept in zip((off.acceleration, off.rate), self.sampled.kept, strict=True):
            numbers = np.mean(kept.numbers[inner], axis=0)
            length = np.sum(values[inner] ** 2, axis=2) / kept.share[inner]
            found.append(Squares(length * (numbers / 3.0), numbers))
        return found[0], found[1], np.linalg.norm(self.sampled.rate, axis=1)[inner]

    def sd_of(self, term: Term) -> Array:
        """(p,) posterior standard deviations of a term's parameters."""
        return np.asarray(np.sqrt(np.diag(self.covariance_of(term))))

    def covariance_of(self, term: Term) -> Array:
        """(p, p) posterior covariance of a term's parameters."""
        at = self.positions
        for other in self.terms:
            if other.name == term.name:
                break
            at += len(other.value)
        part = self.covariance[at : at + len(term.value), at : at + len(term.value)]
        return np.asarray(term.live @ part @ term.live.T)


def settled(
    state: ArrayState, *, shaped: bool = True, lost: bool = False, least: float = -np.inf
) -> ArrayState:
    """The joint fit of everything, and the noise in the shape that held-out halves ask for.

    shaped : whether they are asked, or the shape is kept, as where the search is over; lost :
    whether a fit that does not converge is of no use, and nothing more is asked of it; least :
    density that it has to reach. Raises Behind where it is clear that it ends below.
    """
    state = _climbed(_with_scale(state), _NEAR if shaped else _CLOSE, least)
    if lost and not state.converged:
        return state
    if state.setup.robust and shaped:
        # Which shape only shows once the fit is near; the fit then moves a little with it.
        for _ in range(3):
            noise = _shaped(state)
            same = all(_alike(a, b) for a, b in zip(noise, state.noise, strict=True))
            state = replace(state, noise=noise)
            if same:
                break
            state = _climbed(state, _NEAR)
    return _measured(state)


def _alike(one: SensorNoise, two: SensorNoise) -> bool:
    # Growth is in units of the median speed, which moves a little with every fit.
    a, b = ((x.growth, *x.factor) for x in (one, two))
    return one.freedom == two.freedom and bool(np.allclose(a, b, rtol=_STALE, atol=0.0))


def _with_scale(state: ArrayState, off: Readings | None = None) -> ArrayState:
    a, g, speed = state.squares(off)
    one, two = state.noise
    return replace(state, noise=(scaled(one, a, speed), scaled(two, g, speed)))


def _shaped(state: ArrayState) -> tuple[SensorNoise, SensorNoise]:
    a, g, speed = state.squares()
    some = np.linspace(0, len(speed) - 1, min(len(speed), 250)).astype(np.intp)
    first, rows = state.setup.first[some], state.setup.inner[some]
    one, two = (chosen_noise(x[some], speed[some], first, robust=True) for x in (a, g))
    return scaled(one, a, speed), scaled(not_followed(two, state.sampled, rows), g, speed)


def _climbed(state: ArrayState, close: float, least: float = -np.inf) -> ArrayState:
    """Newton with the matrix of the start: what changes on the way is the residual."""
    converged, matrix, made, shortest = False, np.empty((0, 0)), np.zeros(2), np.inf
    base: Base | None = None
    off = state.sampled.off
    share = min(noise.information for noise in state.noise)
    for k in range(_ROUNDS):
        state = moved_motion(state, base, off)
        base = state.base
        sigma = np.array([noise.sigma for noise in state.noise])
        if k in _AGAIN or np.any(np.abs(made / sigma - 1.0) > _STALE):
            made = sigma
            matrix = base.free(gram(state.sampled, base.blocks, state.setup.inner)).matrix
        along = base.along(gradient(state.sampled, base.blocks, state.setup.inner))
        inner = matrix + np.diag(base.prior)
        pull = along - base.pull
        # Weights that follow residuals answer less than they say, so a step goes farther.
        step = np.linalg.solve(share * matrix + np.diag(base.prior), pull)
        if not float(np.abs(step[: state.positions]).max()) < _RUNAWAY * state.setup.board.prior_sd:
            break
        variance = np.sum(inverse_root(inner) ** 2, axis=1)
        # Weights go by the residuals after the step, not by those that led to it.
        change = beside_motion(state.sampled, base.reading(step, off.rate.shape), slice(None))
        off = state.sampled.off.less(change)
        state = _with_scale(_moved(state, step, variance), off)
        moved = np.array([noise.sigma for noise in state.noise]) / sigma - 1.0
        square = float(step @ inner @ step)
        converged = square < close and float(np.abs(moved).max()) < _STALE
        shortest = min(shortest, square)
        if converged or square > _GROWN * shortest:
            break
        if np.isfinite(least) and square <= _AWAY * shortest:
            ahead = _AHEAD * square + _WIDTHS - 0.5 * float(np.linalg.slogdet(inner)[1])
            if _of_values(state, off) + ahead < least:  # where the step leads
                raise Behind
    return replace(moved_motion(state, base, off), converged=converged)


def _measured(state: ArrayState) -> ArrayState:
    """With the covariance and the density of where it is."""
    one, two = state.base.halves
    covariance = state.base.solved(one + two).covariance
    density = _of_values(state) + 0.5 * float(np.linalg.slogdet(covariance)[1])
    return state.measured(covariance, density)


def _of_values(state: ArrayState, off: Readings | None = None) -> float:
    """Nats of the data and of the terms' values; off : other residuals than those of the state."""
    a, g, speed = state.squares(off)
    nats = sum(float(log_density(*x, speed).sum()) for x in zip(state.noise, (a, g), strict=True))
    for term in state.terms:
        nats -= 0.5 * float(np.sum((term.value / term.sd) ** 2) + 2.0 * np.log(term.sd).sum())
    return nats


def _moved(state: ArrayState, step: Array, variance: Array) -> ArrayState:
    at = state.positions
    r = state.r.copy()
    r[1:] += step[:at].reshape(-1, 3)
    terms = []
    for term in state.terms:
        part = slice(at, at + len(term.value))
        terms.append(term.moved(step[part], variance[part]))
        at = part.stop
    return replace(state, r=r, terms=tuple(terms))


def moved_motion(
    state: ArrayState, base: Base | None = None, off: Readings | None = None
) -> ArrayState:
    """The motion for the positions, terms and noise as they are.

    base : with the columns of the same terms at the same motion, where they are made already
    off : residuals that the weights go by, where they are foreseen
    """
    readings, sampled, off = corrected(state, base), state.sampled, off or state.sampled.off
    tailed = any(np.isfinite(noise.freedom) for noise in state.noise)
    for left in reversed(range(_WEIGHED if tailed else 1)):
        speed = np.linalg.norm(sampled.rate, axis=1)
        weights = Weights(
            state.noise[0].weight(np.sum(off.acceleration**2, axis=2), speed),
            state.noise[1].weight(np.sum(off.rate**2, axis=2), speed),
        )
        # With weights that are made anew at once, the motion need not be at its end.
        sampled = fit_samples(readings, weights, state.r, sampled, *([1] if left else []))
        off = sampled.off
    motion = motion_at(state.setup, sampled, state.motion.age, courses=bool(lagging(state.terms)))
    return replace(state, sampled=sampled, motion=sensed(state.terms, motion))


def followed(state: ArrayState, rounds: int) -> ArrayState:
    """The motion of every sample, with its weights, for positions, terms and noise that are held
    as they are."""
    for _ in range(rounds):
        state = moved_motion(state)
    return state


def corrected(state: ArrayState, base: Base | None = None) -> Readings:
    """The readings less what the terms add to them."""
    own = None if base is None else base.blocks[1:]
    acceleration = state.setup.readings.acceleration.copy()
    rate = state.setup.readings.rate.copy()
    apart = lagging(state.terms) if state.motion.courses is not None else ()
    if apart:
        force, turned = lost(apart, state.motion)
        acceleration += force
        rate += turned
    for k, term in enumerate(state.terms):
        if apart and term.effect.lagged:
            continue
        columns = own[k] if own is not None else term.columns(state.motion)
        target = rate if columns.gyro else acceleration
        target -= term.reading(columns)
    return Readings(acceleration, rate)
