"""An array's accelerometers from its rests: K triads that share one unknown direction a rest.

The model is the catalogue's: bias, scale and misalignment of every triad, and what the closed loop
finds beside them: a warm-up, a drift, a rest that does not belong to the others. The orientation of
the triads relative to each other is determined, that of the whole set is not: its mean over the
triads is the board's frame (paper 001, section IV-B, and its reference 18).

A rest's mean is as good as its samples are many, down to what a chip's offset does from rest to
rest. A rest of one second between rests of half a minute is five times as noisy, and an error of
the model that is only its noise would be searched for.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.board.board import Board
from imucalib.calibrators.request import Request
from imucalib.core.balance import Noise, balance
from imucalib.core.effect import Action, Context, Effect, Parameter, Response, Truth, cross_matrix
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.effects import catalogue, families, named
from imucalib.errors import NotConverged, Undetermined
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.estimators.rounding import rounding_sd
from imucalib.estimators.variance import estimate_noise
from imucalib.posterior.candidates import SearchedEffects, effects_to_search
from imucalib.posterior.closed_loop.closed import close_loop
from imucalib.posterior.closed_loop.found import FitLoop
from imucalib.rests.segments import Segments
from imucalib.units import DEG, MG

FEWEST_POSES = 9
#: Rests from which they contradict an effect, and times their scatter that it would make of it.
ATTITUDES, _WORSE = 4, 1.2
#: What differs from rest to rest beside the averaged noise, in units of that of a median rest, as
#: tried.
_BETWEEN = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
#: Share of the median axis' noise below which rounding, which does not average, is all there is.
_QUIET = 0.1
#: What is fitted before anything is searched for.
BASE = ("bias", "scale", "accelerometer_misalignment")
#: Misalignments of the first triad that stand for the frame: xy, xz, yz.
_FIRST = (0, 1, 3)
#: Samples of which columns are held at once.
_AT_A_TIME = 128
#: Standard deviation of a gain entry above which the attitudes are too alike.
_VAGUE = 0.02
#: Largest believable deviation of a triad's gain from a plain one.
_LOOSE = 0.2
#: A package's turn on the board: sd, and how many degrees of freedom that belief is worth.
_MOUNTED, _BELIEF = 0.3 * DEG, 1.0
#: g: up to there a bend that rests show is undone.
_FARTHEST = 1.2


def base_model() -> Model:
    """Bias, scale and misalignment of every triad, in the frame that is their mean."""
    return Model((named("bias"), named("scale"), frame_misalignment()))


def describe_rests(t: Array, start: float, stop: float, triads: tuple[str, ...]) -> Context:
    """What effects know at times (N,) s: the order runs from 0 at the first rest to 1 at the last,
    and no further. No record is one of the rests'."""
    order = np.clip((t - start) / max(stop - start, 1e-9), 0.0, 1.0)
    covariates = {"order": order, "time": t, "record": np.full(len(t), -1.0)}
    return Context(len(t), covariates, triads)


def observations_of(segments: Segments, board: Board, gravity: float) -> Observations:
    """One observation a rest, in order of time; sigma is that of no weights yet, 1 mg for all.

    Raises Undetermined where there are too few, or where an IMU reads another unit.
    """
    n = segments.n
    if n < FEWEST_POSES:
        raise Undetermined(
            f"{n} rests found, at least {FEWEST_POSES} are needed to calibrate the accelerometers",
            remedy="hold the board still in nine or more attitudes; `imucal inspect FILE --rests` "
            "lists what counts as a rest and what was refused",
        )
    reading = segments.mean
    ratio = np.median(np.linalg.norm(reading, axis=2), axis=0) / gravity
    worst = int(np.argmax(np.abs(np.log(np.maximum(ratio, 1e-9)))))
    if not 0.5 < ratio[worst] < 2.0:  # offsets do not double or halve gravity
        raise Undetermined(
            f"{board.imus[worst]} reads {ratio[worst]:.2g} times gravity at rest",
            remedy="its unit is not what the recording or its mapping says (g against m/s²: 9.81)",
        )
    middle = 0.5 * (segments.start + segments.stop)
    known = describe_rests(middle, float(middle[0]), float(middle[-1]), board.imus)
    covariates = {**known.covariates, "record": np.arange(float(n))}
    return Observations(
        reading,
        np.full(reading.shape, MG),
        KnownNorm(n, gravity, board.rotations),
        replace(known, covariates=covariates, attitude=board.rotations),
        np.arange(n),
        tuple(f"rest {k + 1} ({t:.0f} s)" for k, t in enumerate(middle)),
    )


def estimate_own_noise(segments: Segments) -> Array:
    """(n, K, 3) m/s², what its samples' noise and their rounding leave of each rest's mean."""
    noise = np.maximum(segments.noise, _QUIET * np.median(segments.noise))
    averaged = noise / np.sqrt(segments.samples)[..., None]
    return np.hypot(averaged, rounding_sd(segments.noise, segments.step))


def weigh_rests(data: Observations, own: Array) -> Observations:
    """The same observations with sigma² = own² + between², up to the factor that every fit has.

    own : (n, K, 3) m/s². `between` is the likeliest of a few sizes (restricted likelihood of the
    model at its fit) beside a warm-up, whose misfit all rests share and which would pass for it.
    """
    found = fit_model(Model((*base_model().effects, named("warm_up"))), data)

    def likelihood(sigma: Array) -> float:
        at = balance(found.model, found.theta, found.eta, replace(data, sigma=sigma))
        noise = estimate_noise(at, Noise(1.0, at.component, ()), fixed=False)
        # What is left of a rest's numbers has two fewer directions: those of gravity.
        turned = np.log(np.mean(sigma**-2.0, axis=(1, 2)))
        return noise.log_likelihood - float(np.log(sigma).sum() + turned.sum())

    sizes = (size * float(np.median(own)) for size in _BETWEEN)
    return replace(data, sigma=max((np.hypot(own, size) for size in sizes), key=likelihood))


class _Framed(Response):
    """Misalignment of every triad, the first one's axes being the frame of all: x along its x,
    y in its x-y plane, so that no rotation of the whole set is left open."""

    def parameters(self, context: Context) -> tuple[Parameter, ...]:
        every = super().parameters(context)
        return tuple(p for k, p in enumerate(every) if k not in _FIRST)

    def act(self, theta: Array, truth: Truth, context: Context) -> Action:
        action = super().act(np.insert(theta, [0, 0, 1], 0.0), truth, context)
        return replace(action, d_theta=np.delete(action.d_theta, _FIRST, axis=3))


def frame_misalignment() -> Effect:
    """The catalogue's misalignment at the size that uncalibrated triads have."""
    plain = named("accelerometer_misalignment")
    assert isinstance(plain, Response)
    own = {f.name: getattr(plain, f.name) for f in fields(plain)}
    each = tuple(replace(p, typical=2.0, plausible=20.0) for p in plain.each)
    return _Framed(**{**own, "each": each})


def turn_to_mean_frame(fit: Fit, rotations: Array, *, last: bool) -> tuple[Array, Array]:
    """Gains (K, 3, 3) and the covariance (K, 12, K, 12) of gains and offsets, turned so that the
    gains' mean rotation, in board axes, is none.

    last : whether the offsets are those at the last rest, or the mean over all
    """
    context, count = fit.observations.context, len(rotations)
    slices = fit.model.slices(context)
    some = context.take(np.arange(context.n - 1 if last else 0, context.n))
    when = replace(some, covariates={**some.covariates, "record": -np.ones(some.n)})
    linear = np.zeros((count, 12, fit.theta.size))

    def columns(effect: Effect, force: Array) -> Array:
        zero = np.zeros(slices[effect.name].stop - slices[effect.name].start)
        truth = Truth(np.broadcast_to(force, (when.n, count, 3)))
        return np.asarray(effect.act(zero, truth, when).d_theta.mean(axis=0))

    for effect in fit.model.effects:
        part = slices[effect.name]
        if effect.name in BASE[1:]:
            for axis in range(3):
                linear[:, axis:9:3, part] += columns(effect, np.eye(3)[axis])
        else:
            linear[:, 9:, part] += columns(effect, np.zeros(3))
    gain = np.eye(3) + (linear @ fit.theta)[:, :9].reshape(count, 3, 3)
    back = rotations.transpose(0, 2, 1)
    one, _, two = np.linalg.svd(np.mean(rotations @ gain @ back, axis=0))
    gain = gain @ back @ (one @ two).T @ rotations
    linear[:, :9] = _drop_rotation(linear[:, :9].reshape(9 * count, -1), gain, rotations)
    flat = linear.reshape(12 * count, -1)
    return gain, (flat @ fit.covariance @ flat.T).reshape(count, 12, count, 12)


def _drop_rotation(changes: Array, gain: Array, rotations: Array) -> Array:
    """(K, 9, n) small changes (9 K, n) of all gains, in which their mean does not turn."""
    crosses = cross_matrix(np.eye(3))[:, None]
    own = rotations.transpose(0, 2, 1) @ crosses @ rotations  # (3 axes, K, 3, 3)
    moved, held = (gain @ own).reshape(3, -1), own.reshape(3, -1)
    kept = changes - moved.T @ np.linalg.solve(held @ moved.T, held @ changes)
    return np.asarray(kept.reshape(len(gain), 9, -1))


@dataclass(frozen=True)
class RestFit:
    """Triads in their own axes, in the frame that is their mean.

    fit : the final model; loop : what the search found, or None where there was none
    gain : (K, 3, 3) of reading = gain · force + offset; covariance : (K, 12, K, 12) of every
        triad's gain (rows first) and offset at the end of the rests (m/s²)
    noise : (K,) m/s² of one sample; gyro_noise : (K,) rad/s
    gyro_bias : (order + 1, K, 3) rad/s, coefficients of powers of the rests' time from -1 at the
        first to 0 at the last; gyro_bias_sd : (K, 3) rad/s at the end of the rests
    rotations : (K, 3, 3) package axes to board axes; start, stop : s, middles of first and last
        rest
    """

    fit: Fit
    loop: FitLoop | None
    gain: Array
    covariance: Array
    noise: Array
    gyro_noise: Array
    gyro_bias: Array
    gyro_bias_sd: Array
    rotations: Array
    start: float
    stop: float

    @property
    def imus(self) -> tuple[str, ...]:
        return self.fit.observations.context.triads

    @property
    def poses(self) -> int:
        return self.fit.observations.n

    @property
    def gravity(self) -> float:
        reference = self.fit.observations.reference
        assert isinstance(reference, KnownNorm)
        return reference.gravity

    @property
    def residual(self) -> float:
        """m/s², rms of a component per degree of freedom, in a rest of median length."""
        return self.fit.noise.factor * float(np.median(self.fit.observations.sigma))

    @property
    def before(self) -> float:
        """The same of the model before the search."""
        plain = self.fit if self.loop is None else self.loop.plain
        return plain.noise.factor * float(np.median(plain.observations.sigma))

    def correct(self, acceleration: Array, t: Array) -> Array:
        """Specific force (N, K, 3) m/s² in board axes, of readings in board axes."""
        own = np.einsum("kji,nkj->nki", self.rotations, acceleration) - self.offset(t)
        inverse = np.linalg.inv(self.gain)
        force = np.einsum("kij,nkj->nki", inverse, own)
        bent = tuple(
            e
            for e in self.fit.model.effects
            if isinstance(e, Response) and e.basis_dx is not None and e.name not in BASE
        )
        # Of as many rows as there are times: what a force adds may follow these.
        still, most = Truth(np.broadcast_to(0.0, force.shape)), _FARTHEST * self.gravity
        for _ in range(3 if bent else 0):
            # What bends at one g says nothing at six: a power may even turn back there. The
            # motion has its own say on larger forces.
            near = Truth(np.clip(force, -most, most))
            more = self._evaluate(bent, near, t) - self._evaluate(bent, still, t)
            force = np.einsum("kij,nkj->nki", inverse, own - more)
        return np.asarray(np.einsum("kij,nkj->nki", self.rotations, force))

    def offset(self, t: Array) -> Array:
        """(N, K, 3) m/s², what every triad reads without any force, in its own axes."""
        shape = (len(t), *self.gain.shape[:2])
        return self._evaluate(self.fit.model.effects, Truth(np.zeros(shape)), t)

    def _evaluate(self, effects: tuple[Effect, ...], truth: Truth, t: Array) -> Array:
        """(N, K, 3) m/s², what some effects add to the truth at times (N,) s."""
        data = self.fit.observations.context
        slices, total = self.fit.model.slices(data), np.zeros((len(t), *truth.shape[1:]))
        # An effect gives the columns of all triads beside it: a few samples at a time.
        for start in range(0, len(t), _AT_A_TIME):
            part = slice(start, start + _AT_A_TIME)
            some = Truth(truth.force[part])
            context = describe_rests(t[part], self.start, self.stop, data.triads)
            for effect in effects:
                theta = self.fit.theta[slices[effect.name]]
                total[part] += effect.act(theta, some, context).delta
        return total

    def away(self, t: Array) -> Array:
        """(N, K, 3) m/s², by how much the offsets differ at times (N,) s from their mean over the
        rests, in the triads' own axes."""
        return np.asarray(self.offset(t) - self.bias)

    @property
    def bias(self) -> Array:
        """(K, 3) m/s², the offsets' mean over the rests, in the triads' own axes: what another
        recording of theirs, which has its own drift, is nearest to."""
        return np.asarray(self.offset(self.fit.observations.context["time"]).mean(axis=0))

    def in_board_axes(self) -> tuple[Array, Array, Array]:
        """Gains (K, 3, 3), the offsets' mean over the rests (K, 3) m/s² and their covariance
        (K, 12, 12), of readings and forces in board axes; what the offsets drifted by is doubt of
        them."""
        turn, count = self.rotations, len(self.gain)
        gain = turn @ self.gain @ turn.transpose(0, 2, 1)
        offset = np.einsum("kij,kj->ki", turn, self.bias)
        both = np.zeros((count, 12, 12))
        both[:, :9, :9] = np.einsum("kij,kab->kiajb", turn, turn).reshape(count, 9, 9)
        both[:, 9:, 9:] = turn
        _, covariance = turn_to_mean_frame(self.fit, turn, last=False)
        own = covariance[np.arange(count), :, np.arange(count)]
        away = self.away(self.fit.observations.context["time"])
        own[:, 9:, 9:] += np.einsum("nki,nkj->kij", away, away) / len(away)
        return gain, offset, np.asarray(both @ own @ both.transpose(0, 2, 1))

    @property
    def frame_sd(self) -> float:
        """rad about each axis, of the triads' mean axes against the board's: what the triads' own
        turns scatter, over the root of how many there are."""
        gain, _, _ = self.in_board_axes()
        turn = 0.5 * (gain - gain.transpose(0, 2, 1))
        angles = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        count = len(angles)
        square = float(np.sum((angles - angles.mean(axis=0)) ** 2)) + _BELIEF * _MOUNTED**2
        return float(np.sqrt(square / (3.0 * (count - 1) + _BELIEF) / count))

    def powers(self, t: Array) -> Array:
        """(N, order + 1) of the gyros' drift."""
        late = np.clip((t - self.stop) / (self.stop - self.start), -1.0, 0.0)
        return np.asarray(late[:, None] ** np.arange(len(self.gyro_bias)))

    def subtract_bias(self, rate: Array, t: Array) -> Array:
        """Angular rates (N, K, 3) rad/s in board axes less their offsets at rest."""
        return np.asarray(rate - np.einsum("no,oki->nki", self.powers(t), self.gyro_bias))


def fit_rests(segments: Segments, board: Board, request: Request) -> RestFit:
    """Fit all triads and search for what is missing.

    segments : of the board's IMUs, in its order; request : gravity, and what to search for
    Raises Undetermined when there are too few or too similar rests, NotConverged.
    """
    unweighted = observations_of(segments, board, request.gravity)
    data, model = weigh_rests(unweighted, estimate_own_noise(segments)), base_model()
    fit = fit_model(model, data)
    if fit.null_directions:
        raise _too_similar()
    loop = _search(fit, request) if request.loop else None
    fit = fit if loop is None else loop.final
    if not fit.converged:
        raise NotConverged("the fit of the rests did not settle", remedy="check the recording")
    gain, covariance = turn_to_mean_frame(fit, board.rotations, last=True)
    _refuse_vague(gain, covariance, board)
    middle = data.context["time"]
    turn = board.rotations
    drift, sd = gyro_drift(np.einsum("kij,nkj->nki", turn, segments.rate), middle)
    # What rounding leaves of the gyros is the same in every rest.
    coarse = rounding_sd(segments.rate_noise, segments.rate_step, alike=True)
    return RestFit(
        fit=fit,
        loop=loop,
        gain=gain,
        covariance=covariance,
        noise=np.sqrt(np.mean(segments.noise**2, axis=1)),
        gyro_noise=np.sqrt(np.mean(segments.rate_noise**2, axis=1)),
        gyro_bias=drift,
        gyro_bias_sd=np.sqrt(sd**2 + np.einsum("kij,kj->ki", turn**2, coarse**2)),
        rotations=turn,
        start=float(middle[0]),
        stop=float(middle[-1]),
    )


def _search(plain: Fit, request: Request) -> FitLoop:
    """The closed loop over what a rest can show; names of single IMUs are the motion's affair."""
    known = {*catalogue(), *families()}
    only = tuple(n for n in request.only if n in known)
    without = tuple(n for n in request.without if n in known)
    wanted = effects_to_search(
        only, without, {}, lambda e: e.stage == "sensor" and e.name not in BASE
    )
    effects = {} if request.only and not only else wanted.effects
    scans = () if request.only else wanted.families
    tried = SearchedEffects(effects, scans)
    return close_loop(plain.model, plain.observations, tried, plain.theta).loop


def _too_similar() -> Undetermined:
    return Undetermined(
        "the attitudes of the rests are too alike to tell scale, misalignment and bias apart",
        remedy="turn the board so that each axis points up, down and sideways at least once",
    )


def _refuse_vague(gain: Array, covariance: Array, board: Board) -> None:
    count = board.count
    sd = np.sqrt(np.maximum(np.diag(covariance.reshape(12 * count, -1)), 0.0)).reshape(count, 12)
    if float(sd[:, :9].max()) > _VAGUE:
        raise _too_similar()
    worst = np.abs(gain - np.eye(3)).max(axis=(1, 2))
    if float(worst.max()) > _LOOSE:
        raise Undetermined(
            f"{board.imus[int(np.argmax(worst))]} differs from the board's drawing by "
            f"{100 * worst.max():.0f} % of gravity",
            remedy="check its mounting axes in the board file, and the unit of the recording",
        )


def is_contradicted(rate: Array, made: Array) -> bool:
    """Whether what an effect adds to gyros at rest makes the rests scatter more.

    rate, made : (n, K, 3) rad/s at n rests, as read and as the effect has it
    """
    return bool(np.mean(np.var(rate - made, axis=0)) > _WORSE**2 * np.mean(np.var(rate, axis=0)))


def gyro_drift(rate: Array, t: Array) -> tuple[Array, Array]:
    """Coefficients (order + 1, K, 3) rad/s of the gyros' offsets at rest, of powers of a time that
    runs from -1 at the first rest to 0 at the last, and their standard deviation (K, 3) there; the
    order by the Bayesian information criterion.

    rate : (n, K, 3) rad/s at n rests; t : (n,) s
    """
    values = rate.reshape(len(rate), -1)
    late = (t - t[-1]) / max(float(np.ptp(t)), 1e-9)
    tries = []
    for order in range(3):
        powers = late[:, None] ** np.arange(order + 1)
        found = np.linalg.lstsq(powers, values, rcond=None)[0]
        rest = values - powers @ found
        size = values.shape[1]
        cost = values.size * np.log(max(float(np.mean(rest**2)), 1e-300))
        tries.append((cost + np.log(values.size) * size * (order + 1), found, powers, rest))
    _, found, powers, rest = min(tries, key=lambda t: t[0])
    freedom = max(len(rest) - powers.shape[1], 1)
    leverage = float(np.linalg.inv(powers.T @ powers)[0, 0])
    sd = np.sqrt(leverage * np.sum(rest**2, axis=0) / freedom)
    return found.reshape(-1, *rate.shape[1:]), np.asarray(sd.reshape(rate.shape[1:]))
