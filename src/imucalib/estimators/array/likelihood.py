"""Log posterior of an array's positions with the motion integrated out, and its gradient.

ω̇ and s in closed form, ω by Laplace's method at its conditional mode. The determinant's exponent
is 1/2: a Gaussian of covariance M carries |2πM|^-1/2, and as the motion's prior widens |M| tends to
a constant times |HᵀLH|, with L the accelerometers' precision; (25) and (26) of paper 001 as printed
lack the square root.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.estimators.array.problem import ArrayData, ArrayPrior
from imucalib.estimators.array.rates import Lean, Mode, cholesky_last, modes
from imucalib.estimators.array.rotation import (
    CYCLES,
    SIX,
    Conditionals,
    Prepared,
    cross,
    local,
    products,
    times,
)

_STEP = 0.1  # standard deviations, of a difference
_CHUNK = 4096  # (geometry, sample) pairs worked on at a time: what fits the cache


@dataclass(frozen=True)
class Geometry:
    """What B geometries make of the data. centred : (B, A, 3) m less the weighted mean;
    spread : (B, 3, 3) Σ λ r rᵀ; inertia, gain, factor as in `Conditionals` and `ArrayPrior`;
    weight : (B,) factor on all λ; log_inertia : (B,) log |J + Σ^-1|."""

    centred: Array
    spread: Array
    inertia: Array
    gain: Array
    factor: Array
    weight: Array
    log_inertia: Array


@dataclass(frozen=True)
class ArrayPosterior:
    """log p(positions, Σ, noise | data) up to a constant, batched.

    start : (3, T) rad/s where the search for the conditional modes begins; keeping it fixed makes
        the density a deterministic function
    lean : how it follows the unknowns, where that is known
    moments : whether the gradient includes that of the Laplace determinant, exactly, by cubature
    metric : (6, T) conditional covariances near the start, where they are known
    """

    data: ArrayData
    prior: ArrayPrior
    start: Array
    moments: bool = True
    metric: Array | None = None
    lean: Lean | None = None

    def at(self, x: Array) -> ArrayPosterior:
        """The same density with the conditional search beginning at the modes of x (size,)."""
        mode = self._mode(x[None])
        return replace(self, start=mode.rate[0], metric=mode.covariance[0], lean=None)

    def leaning(self, x: Array, root: Array) -> ArrayPosterior:
        """The same density, the modes of x (size,) being its start, with how they follow the
        unknowns, by differences along the columns of `root` (size, size)."""
        assert self.metric is not None
        points = np.vstack([x, x + _STEP * root.T])
        size = max(1, _CHUNK // max(self.data.samples, 1))
        slopes = []
        for k in range(0, len(points), size):
            given = conditionals(self.data, self.prior, points[k : k + size])[0]
            w = np.broadcast_to(self.start, (len(given.inertia), *self.start.shape))
            slopes.append(local(given, w, curvature=False).gradient)
        rise = np.concatenate(slopes)
        moved = times(self.metric, rise[0] - rise[1:]).reshape(len(root), -1)
        slope = np.asarray(np.linalg.solve(_STEP * root.T, moved), np.float64)
        return replace(self, lean=Lean(x, slope))

    def value(self, x: Array) -> Array:
        """(B,) log posterior of unknowns (B, size)."""
        return self._all(x, slope=False)[0]

    def value_and_gradient(self, x: Array) -> tuple[Array, Array]:
        """(B,) log posterior and (B, size) its gradient."""
        return self._all(x, slope=True)

    def modes(self, x: Array) -> Array:
        """(B, 3, T) conditional modes of ω, rad/s."""
        return self._mode(x).rate

    def _mode(self, x: Array) -> Mode:
        return self._modes(conditionals(self.data, self.prior, x)[0], x)

    def _modes(self, given: Prepared, x: Array) -> Mode:
        if self.lean is None:
            return modes(given, self.start, self.metric)
        return modes(given, self.start + self.lean.rates(x))

    def _all(self, x: Array, *, slope: bool) -> tuple[Array, Array]:
        size = max(1, _CHUNK // max(self.data.samples, 1))
        parts = [self._chunk(x[k : k + size], slope=slope) for k in range(0, len(x), size)]
        value = np.concatenate([p[0] for p in parts])
        gradient = np.concatenate([p[1] for p in parts]) if slope else np.empty((0, 0))
        off = (x - self.prior.mean_vector) / self.prior.sd_vector
        value = value - 0.5 * np.sum(off * off, axis=1)
        return value, gradient - off / self.prior.sd_vector if slope else gradient

    def _chunk(self, x: Array, *, slope: bool) -> tuple[Array, Array]:
        given, geometry = conditionals(self.data, self.prior, x)
        mode = self._modes(given, x)
        with np.errstate(invalid="ignore", divide="ignore"):
            value = -np.sum(mode.here.value + 0.5 * np.log(mode.det), axis=1)
        value = np.where(mode.positive.all(axis=1), value, -np.inf)
        value = value + constants(self.data, self.prior, geometry)
        if not slope:
            return value, np.empty((len(x), 0))
        if self.moments:
            turn, square, spin = _averaged(given, mode)
        else:
            turn, square, spin = _moments(mode.rate, mode.here.spin)
        return value, _gradient(
            data=self.data,
            prior=self.prior,
            given=given,
            geometry=geometry,
            turn=turn,
            square=square,
            spins=spin,
        )


def conditionals(data: ArrayData, prior: ArrayPrior, x: Array) -> tuple[Prepared, Geometry]:
    """What the samples' conditionals need, for unknowns (B, size)."""
    r = prior.geometry(x)
    lam = data.weight
    centred = r - (lam / lam.sum() @ r)[:, None]
    weight = prior.noise_weight(x)
    heavy = centred * weight[:, None, None]
    spread = (heavy * lam[:, None]).transpose(0, 2, 1) @ centred
    inertia = np.trace(spread, axis1=1, axis2=2)[:, None, None] * np.eye(3) - spread
    factor = prior.factor(x)
    stiff = inertia + factor @ factor.transpose(0, 2, 1)
    sign, log_inertia = np.linalg.slogdet(stiff)
    b, a, t = len(x), data.triads, data.samples
    flat = heavy.transpose(0, 2, 1).reshape(3 * b, a) @ data.weighted.reshape(a, 3 * t)
    moment = flat.reshape(b, 3, 3, t).transpose(0, 2, 1, 3)
    given = Conditionals(
        moment,
        inertia,
        np.linalg.inv(stiff),
        data.power * weight[:, None],
        data.rate.T,
        data.precision,
    ).prepared()
    log_inertia = np.where(sign > 0, log_inertia, np.inf)
    return given, Geometry(
        centred=centred,
        spread=spread,
        inertia=inertia,
        gain=given.gain,
        factor=factor,
        weight=weight,
        log_inertia=log_inertia,
    )


def constants(data: ArrayData, prior: ArrayPrior, geometry: Geometry) -> Array:
    """(B,) all of the log likelihood that does not depend on ω."""
    t, a = data.samples, data.triads
    log_weight = np.log(geometry.weight)
    value = -prior.exponent * t * (geometry.log_inertia + 3.0 * np.log(data.weight.sum()))
    value = value + 1.5 * t * (a * log_weight + np.log(data.weight).sum())
    value = value - 3.0 * prior.exponent * t * log_weight + 0.5 * data.log_precision
    value = value - 1.5 * t * (a - 1) * np.log(2.0 * np.pi)
    if prior.motion == "learned":
        diagonal = np.log(np.abs(np.einsum("bii->bi", geometry.factor)))
        return np.asarray(value + t * diagonal.sum(axis=1))
    return np.asarray(value + 1.5 * t * np.log(2.0 * np.pi))


def _moments(w: Array, spin: Array) -> tuple[Array, Array, Array]:
    """W = Ω(ω)² + Ω(ω̇) (B, 3, 3, T), Σ WᵀW (B, 3, 3) and Σ ω̇ω̇ᵀ (B, 3, 3) over the samples."""
    b, _, t = w.shape
    ww = products(w)
    turn = np.empty((b, 3, 3, t))  # [.., j, i, ..] is element (i, j)
    for i, j, k in CYCLES:
        np.add(ww[:, i], ww[:, j], out=turn[:, k, k])
        np.negative(turn[:, k, k], out=turn[:, k, k])
    for s, (i, j) in enumerate(SIX[3:], 3):
        k, up = 3 - i - j, (j - i) % 3 == 1
        np.add(ww[:, s], spin[:, k], out=turn[:, i if up else j, j if up else i])
        np.subtract(ww[:, s], spin[:, k], out=turn[:, j if up else i, i if up else j])
    columns = turn.reshape(b, 3, -1)
    return turn, columns @ columns.transpose(0, 2, 1), spin @ spin.transpose(0, 2, 1)


def _averaged(given: Prepared, mode: Mode) -> tuple[Array, Array, Array]:
    """The same, averaged over six points so that the Laplace determinant's slope is included.

    Points c ± √3 l_i, with l_i the columns of a root of the conditional covariance M and c the mode
    less M u/2, u the contraction of f's third derivative with M: the mean of any g over them is
    g + ½ tr(M ∇²g) - ½ uᵀM∇g at the mode, which is the derivative of f + ½ log|H| when g is that of
    f. f is of fourth degree, so ½ u is the mean of ∇f over the same points about the mode.
    """
    w = mode.rate
    root = cholesky_last(mode.covariance) * np.sqrt(3.0)
    offsets = [s * root[:, :, k] for k in range(3) for s in (1.0, -1.0)]
    half_u = np.zeros_like(w)
    for offset in offsets:
        half_u += local(given, w + offset, curvature=False).gradient
    centre = w - times(mode.covariance, half_u / 6.0)
    total: tuple[Array, Array, Array] | None = None
    for offset in offsets:
        point = centre + offset
        spin = given.gain @ (given.torque - cross(point, given.inertia @ point))
        here = _moments(point, spin)
        total = (
            here if total is None else (total[0] + here[0], total[1] + here[1], total[2] + here[2])
        )
    assert total is not None
    return total[0] / 6.0, total[1] / 6.0, total[2] / 6.0


def _gradient(
    data: ArrayData,
    prior: ArrayPrior,
    given: Prepared,
    geometry: Geometry,
    turn: Array,
    square: Array,
    spins: Array,
) -> Array:
    """(B, size) gradient of the log likelihood from the averaged moments."""
    b, a, t = len(turn), data.triads, data.samples
    flat = turn.reshape(3 * b, 3 * t)
    first = (flat @ data.weighted.reshape(a, 3 * t).T).reshape(b, 3, a).transpose(0, 2, 1)
    lam = data.weight[:, None] * geometry.weight[:, None, None]
    gain = geometry.gain
    trace = np.trace(gain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    pull = 2.0 * prior.exponent * t * (gain - trace)
    by_position = geometry.weight[:, None, None] * first
    by_position += lam * (geometry.centred @ (pull - square))
    parts = [by_position[:, 1:].reshape(b, -1)]
    if prior.motion == "learned":
        covariance = _from_factor(geometry.factor)
        slope = 0.5 * t * (covariance - gain) - 0.5 * spins
        parts.append(prior.factor_gradient(geometry.factor, slope))
    if prior.estimate_noise:
        fitted = np.einsum("baj,baj->b", first, geometry.centred) * geometry.weight
        left = 0.5 * geometry.weight * data.power.sum() - fitted
        left += 0.5 * np.einsum("bij,bij->b", square, geometry.spread)
        by_log = 1.5 * t * a - 3.0 * prior.exponent * t - left
        by_log = by_log - prior.exponent * t * np.einsum("bij,bij->b", gain, geometry.inertia)
        parts.append(-2.0 * by_log[:, None])
    return np.concatenate(parts, axis=1)


def _from_factor(factor: Array) -> Array:
    """Σ (B, 3, 3) from the lower factor of its inverse."""
    back = np.linalg.inv(factor)
    return np.asarray(back.transpose(0, 2, 1) @ back)
