"""The array's model as fitted: positions, terms, noise and motion together.

Positions and terms by Gauss-Newton with the motion of every sample taken out, weights by the noise,
which is estimated along. Every basis is taken at the fitted motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.motion.setup import Setup, set_up
from imucalib.calibrators.array.motion.terms import (
    BoardMotion,
    Term,
    board_motion,
    evaluate_lags,
    lag_motion,
    select_lagging,
)
from imucalib.estimators.array.noise import (
    MotionNoise,
    Squares,
    choose_noise,
    not_followed,
    rescale,
    weigh,
)
from imucalib.estimators.array.sample_age import SampleAge
from imucalib.estimators.array.samples import (
    Columns,
    Gram,
    Pair,
    Sampled,
    fit_samples,
    gradient,
    gram,
    inverse_root,
    project_out_motion,
)
from imucalib.posterior.closed_loop.found import Unexplained
from imucalib.posterior.odds import CERTAIN
from imucalib.significant_digits import plus_minus

#: Coordinates that a drawing's stated deviation counts as.
_STATED = 3.0
#: Newton steps at most, those before which the matrix is made again in any case, and the squared
#: steps at which a fit is settled: one in the search, which compares nats, and one that is stated.
_ROUNDS, _AGAIN, _ROUGH, _CLOSE = 30, (0, 8, 16, 24), 0.4, 0.03
#: Change of the noise from which the matrix no longer serves.
_STALE = 0.1
#: Rounds of a motion with the weights that its residuals ask for, at one step of what is fitted.
_WEIGHED = 2
#: Growth of a squared step of a lost fit.
_GROWN = 1e3
#: Samples from which the shape of the noise is chosen.
_SHAPED_BY = 250
_FOLLOWED = 1  # round of the motion at new samples, so that a fit there begins with its noise
#: Samples over which a sum of residuals is taken, and the farthest neighbours that are compared.
_RUN, _FAR = 16, 6
#: Pairs of neighbours below which nothing is known of what they share, and standard deviations of
#: chance below which it is nothing.
_FEWEST, _CHANCE = 50, 2.0


def drawing_precision(off: Array, sd: float) -> float:
    """1/m², of each coordinate about its drawing, where the drawing's stated sd (m) may itself be
    wrong by a factor that all coordinates share: a multivariate t, whose weight follows from what
    they are off (d,) m (Lange, Little, Taylor 1989, JASA 84, equation 5)."""
    return (_STATED + off.size) / (_STATED * sd**2 + float(off @ off))


class PositionBase:
    """What a joint fit has as unknowns at a fitted motion.

    blocks : columns of the positions and of each term; turn : (R, q) these R raw columns by the q
    coordinates that are free; prior : (q,) inverse variances, rests : of them those that no data
    lift, since what positions absorb is absorbed for good; pull : (q,) prior times value
    """

    def __init__(self, state: ArrayState, terms: Sequence[Term]) -> None:
        """terms : those of the state that are unknowns, beside its positions."""
        from scipy.linalg import block_diag

        board, turn = state.setup.board, state.sampled.turn
        each = np.asarray(np.broadcast_to(turn, (board.count, *turn.shape)))
        places = Columns(each, gyro=False, shared=False)
        self.blocks = [places, *(term.columns(state.motion) for term in terms)]
        self.turn: Array = block_diag(np.eye(3 * board.count)[:, 3:], *(t.live for t in terms))
        off = (state.r - board.drawn)[1:].ravel()
        flat = np.full(off.size, drawing_precision(off, board.prior_sd))
        self.prior = np.concatenate([flat, *(term.sd**-2.0 for term in terms)])
        held = [term.sd**-2.0 * (not term.found) for term in terms]
        self.rests = np.concatenate([0.0 * flat, *held])
        self.pull = self.prior * np.concatenate([off, *(term.value for term in terms)])

    def multiply(self, sampled: Sampled, rows: Index, more: Sequence[Columns] = ()) -> Gram:
        """Products of the free coordinates, and of more columns after them, over some samples; made
        in place of those of the raw columns: of many IMUs a copy would be large."""
        found, turn = gram(sampled, [*self.blocks, *more], rows), self.turn
        raw, n = turn.shape
        own, beside = turn.T @ found.matrix[:raw, :raw] @ turn, turn.T @ found.matrix[:raw, raw:]
        matrix = found.matrix[raw - n :, raw - n :]
        matrix[:n, :n], matrix[:n, n:], matrix[n:, :n] = own, beside, beside.T
        along = np.concatenate([turn.T @ found.along[:raw], found.along[raw:]])
        return Gram(matrix, along, found.power)

    def reading(self, step: Array, shape: tuple[int, ...]) -> Pair:
        """What a step of the free coordinates adds to the readings; shape : (T, K, 3) of each."""
        added = Pair(np.zeros(shape), np.zeros(shape))
        ends = np.cumsum([block.size for block in self.blocks])[:-1]
        for block, part in zip(self.blocks, np.split(self.turn @ step, ends), strict=True):
            added[block.gyro][...] += block.at(part)
        return added


@dataclass(frozen=True)
class ArrayState:
    """r : (K, 3) m, the first at zero; terms; noise of accelerometers and gyros; sampled : the
    fitted motion; motion : the same for effects; covariance : of positions and terms' coordinates;
    by_noise : the same if the noise is what was fitted, where that is known; clock : of the gyros,
    where one shows"""

    setup: Setup
    r: Array
    terms: tuple[Term, ...]
    noise: tuple[MotionNoise, MotionNoise]
    sampled: Sampled
    motion: BoardMotion
    covariance: Array
    converged: bool
    by_noise: Array | None = None
    clock: SampleAge | None = None

    @property
    def positions(self) -> int:
        """How many coordinates are free."""
        return 3 * (self.setup.board.count - 1)

    @cached_property
    def base(self) -> PositionBase:
        return PositionBase(self, self.terms)

    @property
    def found(self) -> tuple[Term, ...]:
        return tuple(term for term in self.terms if term.found)

    @property
    def slices(self) -> list[slice]:
        """Of each term, its coordinates among all that are free."""
        ends = self.positions + np.cumsum([0, *(len(term.value) for term in self.terms)])
        return [slice(int(a), int(b)) for a, b in pairwise(ends)]

    def squares(self, off: Pair | None = None) -> tuple[Squares, Squares, Array]:
        """Residuals of accelerometers and gyros at the inner samples as their noise is judged by,
        and the speed (inner,) rad/s; off : (T, K, 3) other residuals."""
        off, inner = off or self.sampled.off, self.setup.inner
        found = []
        for values, kept in zip(off, self.sampled.kept, strict=True):
            numbers = np.mean(kept.numbers[inner], axis=0)
            length = np.sum(values[inner] ** 2, axis=2) / kept.share[inner]
            found.append(Squares(length * (numbers / 3.0), numbers))
        return found[0], found[1], np.linalg.norm(self.sampled.rate, axis=1)[inner]

    def sd_of(self, term: Term) -> Array:
        """(p,) posterior standard deviations of a term's parameters."""
        return np.asarray(np.sqrt(np.diag(self.covariance_of(term))))

    def covariance_of(self, term: Term) -> Array:
        """(p, p) posterior covariance of a term's parameters."""
        own = self.slices[[other.name for other in self.terms].index(term.name)]
        return np.asarray(term.live @ self.covariance[own, own] @ term.live.T)


def size_in_words(state: ArrayState, term: Term) -> str:
    """The one value with its deviation, or the rms of many."""
    parameters = term.parameters(state.setup.board.imus)
    unit = parameters[0].unit
    if len(parameters) == 1:
        return plus_minus(float(term.theta[0]), float(state.sd_of(term)[0]), unit)
    if len(parameters) <= 3:
        return f"{', '.join(f'{v:.3g}' for v in term.theta)} {unit}"
    rms = float(np.sqrt(np.mean(term.theta**2)))
    return f"{rms:.2g} {unit} rms, {term.live.shape[1]} of {len(parameters)} determined"


def start_state(setup: Setup, terms: tuple[Term, ...]) -> ArrayState:
    """Fitted with the drawing and plain noise as the start."""
    one = np.ones(setup.board.count)
    noise = MotionNoise(0.2, 0.0, np.inf, one), MotionNoise(5e-3, 0.0, np.inf, one)
    sampled = fit_motion_at(setup, setup.board.drawn, noise)
    drawn = ArrayState(
        setup=setup,
        r=setup.board.drawn,
        terms=terms,
        noise=noise,
        sampled=sampled,
        motion=motion_at(setup, sampled, None),
        covariance=np.empty((0, 0)),
        converged=False,
    )
    return fit_jointly(drawn)


def motion_at(
    setup: Setup, sampled: Sampled, age: Array | None, *, courses: bool = False
) -> BoardMotion:
    """The fitted motion as effects have it. courses : whether sensors may lag"""
    jerk = sampled.jerk(setup.t, setup.sides)
    found = board_motion(
        setup.board,
        setup.t,
        order=setup.order,
        rate=sampled.rate,
        spin=sampled.spin,
        force=sampled.force,
        jerk=jerk,
        age=age,
    )
    return found.set_courses(setup.sides) if courses else found


def fit_motion_at(setup: Setup, r: Array, noise: tuple[MotionNoise, MotionNoise]) -> Sampled:
    """The motion of samples for positions alone, each kind of sensor weighted by its size."""
    ones = np.ones((len(setup.rows), setup.board.count))
    weights = Pair(ones / noise[0].sigma ** 2, ones / noise[1].sigma ** 2)
    return fit_samples(setup.readings, weights, r, np.median(setup.readings.rate, axis=1))


def fit_jointly(state: ArrayState, *, shaped: bool = True) -> ArrayState:
    """The joint fit of everything, and the noise in the shape that held-out halves ask for.

    shaped : whether these choose it, or it keeps its shape, as where the search is over
    """
    state = _newton(_with_scale(state), _ROUGH if shaped else _CLOSE)
    if shaped:
        # Which shape only shows once the fit is close; the fit then moves a little with it.
        for _ in range(3):
            noise = _shape(state)
            same = all(_same(a, b) for a, b in zip(noise, state.noise, strict=True))
            state = replace(state, noise=noise)
            if same:
                break
            state = _newton(state, _ROUGH)
    base = state.base
    known = base.multiply(state.sampled, state.setup.inner).matrix
    root = inverse_root(known + np.diag(base.prior))
    return replace(state, covariance=root @ root.T)


def _same(one: MotionNoise, two: MotionNoise) -> bool:
    # Growth is in units of the median speed, which moves a little with every fit.
    a, b = ((x.growth, *x.factor) for x in (one, two))
    return one.freedom == two.freedom and bool(np.allclose(a, b, rtol=_STALE, atol=0.0))


def _with_scale(state: ArrayState, off: Pair | None = None) -> ArrayState:
    a, g, speed = state.squares(off)
    one, two = state.noise
    return replace(state, noise=(rescale(one, a, speed), rescale(two, g, speed)))


def _shape(state: ArrayState) -> tuple[MotionNoise, MotionNoise]:
    a, g, speed = state.squares()
    some = np.linspace(0, len(speed) - 1, min(len(speed), _SHAPED_BY)).astype(np.intp)
    first, rows = state.setup.first[some], state.setup.inner[some]
    one, two = (choose_noise(x[some], speed[some], first) for x in (a, g))
    return rescale(one, a, speed), rescale(not_followed(two, state.sampled, rows), g, speed)


def _newton(state: ArrayState, close: float) -> ArrayState:
    """Newton with the matrix of the start: what changes on the way is the residual."""
    converged, matrix, made, shortest = False, np.empty((0, 0)), np.zeros(2), np.inf
    base: PositionBase | None = None
    off = state.sampled.off
    share = min(noise.information for noise in state.noise)
    wide = float(np.abs(state.setup.board.drawn).max())  # no place moves by more than the board is
    for k in range(_ROUNDS):
        state = update_motion(state, base, off)
        base = state.base
        sigma = np.array([noise.sigma for noise in state.noise])
        if k in _AGAIN or np.any(np.abs(made / sigma - 1.0) > _STALE):
            made = sigma
            matrix = base.multiply(state.sampled, state.setup.inner).matrix
        along = gradient(state.sampled, base.blocks, state.setup.inner) @ base.turn
        inner = matrix + np.diag(base.prior)
        # Weights that follow residuals answer less than they say, so a step goes farther.
        step = np.linalg.solve(share * matrix + np.diag(base.prior), along - base.pull)
        if not float(np.abs(step[: state.positions]).max()) < wide:
            break
        variance = np.sum(inverse_root(inner) ** 2, axis=1)
        # Weights go by the residuals after the step, not by those that led to it.
        change = project_out_motion(state.sampled, base.reading(step, off.rate.shape))
        off = state.sampled.off.less(change)
        state = _with_scale(_move(state, step, variance), off)
        moved = np.array([noise.sigma for noise in state.noise]) / sigma - 1.0
        square = float(step @ inner @ step)
        converged = square < close and float(np.abs(moved).max()) < _STALE
        shortest = min(shortest, square)
        if converged or square > _GROWN * shortest:
            break
    return replace(update_motion(state, base, off), converged=converged)


def _move(state: ArrayState, step: Array, variance: Array) -> ArrayState:
    r = state.r.copy()
    r[1:] += step[: state.positions].reshape(-1, 3)
    own = zip(state.terms, state.slices, strict=True)
    return replace(state, r=r, terms=tuple(t.move(step[at], variance[at]) for t, at in own))


def update_motion(
    state: ArrayState, base: PositionBase | None = None, off: Pair | None = None
) -> ArrayState:
    """The motion for the positions, terms and noise as they are.

    base : with the columns of the same terms at the same motion, where they are made already
    off : residuals that the weights go by, where they are foreseen
    """
    readings, sampled, off = subtract_terms(state, base), state.sampled, off or state.sampled.off
    tailed = any(np.isfinite(noise.freedom) for noise in state.noise)
    for more in reversed(range(_WEIGHED if tailed else 1)):
        weights = weigh(state.noise, off, sampled.rate)
        # With weights that are made anew at once, the motion need not be at its end.
        sampled = fit_samples(readings, weights, state.r, sampled, *([1] if more else []))
        off = sampled.off
    motion = motion_at(
        state.setup, sampled, state.motion.age, courses=bool(select_lagging(state.terms))
    )
    return replace(state, sampled=sampled, motion=lag_motion(state.terms, motion))


def refit_motion(state: ArrayState, rounds: int) -> ArrayState:
    """The motion of every sample, with its weights, for positions, terms and noise that are held
    as they are."""
    for _ in range(rounds):
        state = update_motion(state)
    return state


def subtract_terms(state: ArrayState, base: PositionBase | None = None) -> Pair:
    """The readings less what the terms add to them."""
    late = select_lagging(state.terms) if state.motion.courses is not None else ()
    readings = state.setup.readings
    late_by = evaluate_lags(late, state.motion) if late else Pair(*map(np.zeros_like, readings))
    left = readings.less(late_by)
    for k, term in enumerate(state.terms):
        if late and term.effect.lagged:
            continue
        columns = term.columns(state.motion) if base is None else base.blocks[1 + k]
        left[columns.gyro][...] -= columns.at(term.theta)
    return left


def on_all(state: ArrayState, most: int) -> ArrayState:
    """The state at `most` of all informative samples, not settled there. Samples without
    neighbours serve unless a term needs the force's derivative."""
    neighbours, setup = any("jerk" in t.effect.needs for t in state.terms), state.setup
    return transfer_to(state, set_up(setup.moving, setup.board, most, neighbours=neighbours))


def fit_all_samples(state: ArrayState, most: int) -> ArrayState:
    """The joint fit at `most` of all informative samples, with the noise in the shape it has."""
    return settle_there(on_all(state, most))


def settle_there(state: ArrayState) -> ArrayState:
    """The joint fit at samples that the state was moved to, with the noise in the shape it has."""
    return fit_jointly(refit_motion(state, _FOLLOWED), shaped=False)


def transfer_to(state: ArrayState, setup: Setup) -> ArrayState:
    """What was found, at other samples; to be settled there."""
    sampled = fit_motion_at(setup, state.r, state.noise)
    motion = motion_at(setup, sampled, None, courses=bool(select_lagging(state.terms)))
    return replace(state, setup=setup, sampled=sampled, motion=motion)


def _correlate(state: ArrayState, *, gyro: bool) -> Iterator[tuple[float, float]]:
    """Correlation of the weighted residuals of samples 1, 2, ... apart, and how many independent
    products it is the mean of; until there are few."""
    setup, sampled = state.setup, state.sampled
    root = np.sqrt(sampled.weights[gyro])[..., None]
    white = (sampled.off[gyro] * root)[setup.inner]
    follows = np.diff(setup.rows[setup.inner]) == 1
    power = float(np.mean(white**2))
    # The motion has its share of the numbers of every sample.
    numbers = max(3 * white.shape[1] - (3 if gyro else 6), 1)
    for k in range(1, _FAR + 1):
        together = np.convolve(follows, np.ones(k), "valid") == k
        if together.sum() < _FEWEST or power == 0.0:
            return
        product = float(np.mean((white[:-k] * white[k:])[together]))
        yield product / power, float(together.sum() * numbers)


def measure_dispersion(state: ArrayState, *, gyro: bool) -> float:
    """How many times fewer samples noise with memory is worth: the variance of a sum over a run
    of samples over that of independent ones, 1 + 2 Σ ρ_k (1 - k / run), up to the first neighbour
    that shares nothing beyond chance."""
    factor = 1.0
    for k, (rho, n) in enumerate(_correlate(state, gyro=gyro), 1):
        if rho * np.sqrt(n) < _CHANCE:
            break
        factor += 2.0 * rho * (1.0 - k / _RUN)
    return factor


def find_memory(state: ArrayState) -> Iterator[Unexplained]:
    """Sensors whose noise follows its own past, where noise without memory is unlikely at even odds
    (Schwarz 1978): something goes on from sample to sample that the model does not have."""
    for sensor, gyro in (("accelerometer", False), ("gyroscope", True)):
        rho, n = next(_correlate(state, gyro=gyro), (0.0, 1.0))
        nats = 0.5 * n * max(rho, 0.0) ** 2 - 0.5 * float(np.log(n))
        p = 1.0 / (1.0 + float(np.exp(min(nats, 700.0))))
        if p < 1.0 - CERTAIN:
            name = f"{sensor} noise correlated in time"
            yield Unexplained(name, "time", "noise", 1.0 - p, nats)
