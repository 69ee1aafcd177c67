"""An array's accelerometers from its rests: K triads that share one unknown direction a rest.

The model is the catalogue's: bias, scale and misalignment of every triad, and what the closed loop
finds beside them: a warm-up, a drift, a rest that does not belong to the others. The orientation of
the triads relative to each other is determined, that of the whole set is not: its mean over the
triads is the board's frame (paper 001, section IV-B, and its reference 18).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.frame import BASE, in_the_mean_frame
from imucalib.calibrators.array.gyros import gyro_drift
from imucalib.calibrators.array.loop.asked import NOTHING_ASKED, Asked
from imucalib.calibrators.array.observations import (
    base_model,
    observations_of,
    own_noise,
    rest_context,
    rounding,
    weighted,
)
from imucalib.core.effect import Effect, Response
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.core.truth import Truth
from imucalib.effects import catalogue, families
from imucalib.errors import NotConverged, Undetermined
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop.asked import Searched, searched
from imucalib.loop.found import FitLoop
from imucalib.loop.posterior.closed import close_loop
from imucalib.rests.segments import Segments

_AT_A_TIME = 128  # samples of which columns are held at once
_VAGUE = 0.02  # standard deviation of a gain entry above which the attitudes are too alike
_LOOSE = 0.2  # largest believable deviation of a triad's gain from a plain one
_FARTHEST = 1.2  # g: up to there a bend that rests show is undone


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

    @cached_property
    def gain_sd(self) -> Array:
        """(K, 3, 3)."""
        count = len(self.gain)
        every = self.covariance.reshape(12 * count, 12 * count)
        return np.sqrt(np.maximum(np.diag(every), 0.0)).reshape(count, 12)[:, :9].reshape(-1, 3, 3)

    def corrected(self, acceleration: Array, t: Array) -> Array:
        """Specific force (N, K, 3) m/s² in board axes, of readings in board axes."""
        own = np.einsum("kji,nkj->nki", self.rotations, acceleration) - self.offset(t)
        inverse = np.linalg.inv(self.gain)
        force = np.einsum("kij,nkj->nki", inverse, own)
        bent = tuple(
            e for e in self.fit.model.effects
            if isinstance(e, Response) and e.basis_dx is not None and e.name not in BASE
        )  # fmt: skip
        # Of as many rows as there are times: what a force adds may follow these.
        still, most = Truth(np.broadcast_to(0.0, force.shape)), _FARTHEST * self.gravity
        for _ in range(3 if bent else 0):
            # What bends at one g says nothing at six: a power may even turn back there. The
            # motion has its own say on larger forces.
            near = Truth(np.clip(force, -most, most))
            more = self._added(bent, near, t) - self._added(bent, still, t)
            force = np.einsum("kij,nkj->nki", inverse, own - more)
        return np.asarray(np.einsum("kij,nkj->nki", self.rotations, force))

    def offset(self, t: Array) -> Array:
        """(N, K, 3) m/s², what every triad reads without any force, in its own axes."""
        shape = (len(t), *self.gain.shape[:2])
        return self._added(self.fit.model.effects, Truth(np.zeros(shape)), t)

    def _added(self, effects: tuple[Effect, ...], truth: Truth, t: Array) -> Array:
        """(N, K, 3) m/s², what some effects add to the truth at times (N,) s."""
        data = self.fit.observations.context
        slices, total = self.fit.model.slices(data), np.zeros((len(t), *truth.shape[1:]))
        # An effect gives the columns of all triads beside it: a few samples at a time.
        for start in range(0, len(t), _AT_A_TIME):
            part = slice(start, start + _AT_A_TIME)
            some = Truth(truth.force[part])
            context = rest_context(t[part], self.start, self.stop, data.triads)
            for effect in effects:
                theta = self.fit.theta[slices[effect.name]]
                total[part] += effect.act(theta, some, context).delta
        return total

    def in_board_axes(self) -> tuple[Array, Array, Array]:
        """Gains (K, 3, 3), offsets (K, 3) m/s² at the end of the rests and their covariance
        (K, 12, 12), of readings and forces in board axes."""
        turn, count = self.rotations, len(self.gain)
        gain = turn @ self.gain @ turn.transpose(0, 2, 1)
        offset = (turn @ self.offset(np.array([self.stop]))[0][..., None])[..., 0]
        both = np.zeros((count, 12, 12))
        both[:, :9, :9] = np.einsum("kij,kab->kiajb", turn, turn).reshape(count, 9, 9)
        both[:, 9:, 9:] = turn
        own = self.covariance[np.arange(count), :, np.arange(count)]
        return gain, offset, np.asarray(both @ own @ both.transpose(0, 2, 1))

    def powers(self, t: Array) -> Array:
        """(N, order + 1) of the gyros' drift."""
        late = np.clip((t - self.stop) / (self.stop - self.start), -1.0, 0.0)
        return np.asarray(late[:, None] ** np.arange(len(self.gyro_bias)))

    def without_bias(self, rate: Array, t: Array) -> Array:
        """Angular rates (N, K, 3) rad/s in board axes less their offsets at rest."""
        return np.asarray(rate - np.einsum("no,oki->nki", self.powers(t), self.gyro_bias))


def fit_rests(
    segments: Segments, board: Board, order: list[int], gravity: float, *,
    asked: Asked = NOTHING_ASKED,
) -> RestFit:  # fmt: skip
    """Fit all triads and search for what is missing.

    order : the board's IMUs in the segments' triads. Raises Undetermined when there are too few or
    too similar rests, NotConverged.
    """
    unweighted = observations_of(segments, board, order, gravity)
    data, model = weighted(unweighted, own_noise(segments, order)), base_model()
    loop = _searched(model, data, asked) if asked.search else None
    fit = fit_model(model, data) if loop is None else loop.final
    if (fit if loop is None else loop.plain).null_directions:
        raise _too_alike()
    if not fit.converged:
        raise NotConverged("the fit of the rests did not settle", remedy="check the recording")
    gain, covariance = in_the_mean_frame(fit, board.rotations)
    _refuse_vague(gain, covariance, board)
    middle = data.context["time"]
    drift, drift_sd = _gyro_drift(segments, board, order, middle)
    return RestFit(
        fit=fit,
        loop=loop,
        gain=gain,
        covariance=covariance,
        noise=np.sqrt(np.mean(segments.noise[order] ** 2, axis=1)),
        gyro_noise=np.sqrt(np.mean(segments.rate_noise[order] ** 2, axis=1)),
        gyro_bias=drift,
        gyro_bias_sd=drift_sd,
        rotations=board.rotations,
        start=float(middle[0]),
        stop=float(middle[-1]),
    )


def _gyro_drift(
    segments: Segments, board: Board, order: list[int], t: Array
) -> tuple[Array, Array]:
    """As `gyro_drift` has it, in board axes; with what rounding leaves, the same in every rest."""
    turn = board.rotations
    drift, sd = gyro_drift(np.einsum("kij,nkj->nki", turn, segments.rate[:, order]), t)
    coarse = rounding(segments.rate_step[order], segments.rate_noise[order], alike=True)
    return drift, np.sqrt(sd**2 + np.einsum("kij,kj->ki", turn**2, coarse**2))


def _searched(model: Model, data: Observations, asked: Asked) -> FitLoop:
    """The closed loop over what a rest can show; names of single IMUs are the motion's affair."""
    known = {*catalogue(), *families()}
    only = tuple(n for n in asked.only if n in known)
    without = tuple(n for n in asked.without if n in known)
    wanted = searched(only, without, {}, lambda e: e.stage == "sensor" and e.name not in BASE)
    effects = {} if asked.only and not only else wanted.effects
    scans = () if asked.only else wanted.families
    return close_loop(model, data, Searched(effects, scans)).loop


def _too_alike() -> Undetermined:
    return Undetermined(
        "the attitudes of the rests are too alike to tell scale, misalignment and bias apart",
        remedy="turn the board so that each axis points up, down and sideways at least once",
    )


def _refuse_vague(gain: Array, covariance: Array, board: Board) -> None:
    count = board.count
    sd = np.sqrt(np.maximum(np.diag(covariance.reshape(12 * count, -1)), 0.0)).reshape(count, 12)
    if float(sd[:, :9].max()) > _VAGUE:
        raise _too_alike()
    worst = np.abs(gain - np.eye(3)).max(axis=(1, 2))
    if float(worst.max()) > _LOOSE:
        raise Undetermined(
            f"{board.imus[int(np.argmax(worst))]} differs from the board's drawing by "
            f"{100 * worst.max():.0f} % of gravity",
            remedy="check its mounting axes in the board file, and the unit of the recording",
        )
