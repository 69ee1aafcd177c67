"""Log posterior of an array's positions with the motion integrated out, and its gradient.

ω̇ and s in closed form, ω by Laplace's method at its conditional mode. The determinant's exponent
is 1/2: a Gaussian of covariance M carries |2πM|^-1/2, and as the motion's prior widens |M| tends to
a constant times |HᵀLH|, with L the accelerometers' precision; (25) and (26) of paper 001 as printed
lack the square root.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.estimators.array.problem import ArrayData, ArrayPrior
from imucalib.estimators.array.rates import (
    Conditionals,
    Mode,
    cross,
    dot,
    local,
    modes,
    outer,
    root_of,
    skew,
    times,
)

_CHUNK = 4096  # (geometry, sample) pairs worked on at a time: what fits the cache


@dataclass(frozen=True)
class Geometry:
    """What B geometries make of the data. centred : (B, A, 3) m less the weighted mean;
    spread : (B, 3, 3) Σ λ r rᵀ; factor as in `ArrayPrior`; weight : (B,) factor on all λ;
    log_inertia : (B,) log |J + Σ^-1|."""

    centred: Array
    spread: Array
    factor: Array
    weight: Array
    log_inertia: Array


@dataclass(frozen=True)
class ArrayPosterior:
    """log p(positions, Σ, noise | data) up to a constant, batched.

    start : (3, T) rad/s where the search for the conditional modes begins; keeping it fixed makes
        the density a deterministic function
    moments : whether the gradient includes that of the Laplace determinant, exactly, by cubature
    """

    data: ArrayData
    prior: ArrayPrior
    start: Array
    moments: bool = True

    def value(self, x: Array) -> Array:
        """(B,) log posterior of unknowns (B, size)."""
        return self._all(x, slope=False)[0]

    def value_and_gradient(self, x: Array) -> tuple[Array, Array]:
        """(B,) log posterior and (B, size) its gradient."""
        return self._all(x, slope=True)

    def mode(self, x: Array) -> Mode:
        """Conditional modes of ω for unknowns (B, size)."""
        return modes(conditionals(self.data, self.prior, x)[0], self.start)

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
        mode = modes(given, self.start)
        with np.errstate(invalid="ignore", divide="ignore"):
            value = -np.sum(mode.here.value + 0.5 * np.log(mode.det), axis=1)
        value = np.where(mode.positive.all(axis=1), value, -np.inf)
        value = value + constants(self.data, self.prior, geometry)
        if not slope:
            return value, np.empty((len(x), 0))
        found = _averaged(given, mode) if self.moments else _moments(mode.rate, mode.here.spin)
        return value, _gradient(self.data, self.prior, given, geometry, *found)


def conditionals(data: ArrayData, prior: ArrayPrior, x: Array) -> tuple[Conditionals, Geometry]:
    """What the samples' conditionals need, for unknowns (B, size)."""
    r, b, t = prior.geometry(x), len(x), data.samples
    lam = data.weight
    centred = r - (lam / lam.sum() @ r)[:, None]
    weight = prior.noise_weight(x)
    heavy = centred * weight[:, None, None]
    spread = (heavy * lam[:, None]).transpose(0, 2, 1) @ centred
    inertia = np.trace(spread, axis1=1, axis2=2)[:, None, None] * np.eye(3) - spread
    factor = prior.factor(x)
    stiff = inertia + factor @ factor.transpose(0, 2, 1)
    sign, log_inertia = np.linalg.slogdet(stiff)
    flat = heavy.transpose(0, 2, 1).reshape(3 * b, -1) @ data.weighted.reshape(-1, 3 * t)
    moment = flat.reshape(b, 3, 3, t)  # Nᵀ
    trace = np.einsum("biit->bt", moment)
    bend = 2.0 * trace[:, None, None] * np.eye(3)[..., None] - moment - moment.swapaxes(1, 2)
    turned = moment.swapaxes(1, 2) - moment
    torque = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=1)
    given = Conditionals(
        bend=bend,
        torque=torque,
        inertia=inertia,
        gain=np.linalg.inv(stiff),
        power=data.power * weight[:, None],
        rate=data.rate.T,
        precision=data.precision,
    )
    log_inertia = np.where(sign > 0, log_inertia, np.inf)
    return given, Geometry(centred, spread, factor, weight, log_inertia)


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
    """Wᵀ (B, 3, 3, T), W = Ω(ω)² + Ω(ω̇), Σ WᵀW (B, 3, 3) and Σ ω̇ω̇ᵀ (B, 3, 3) over the samples."""
    turn = outer(w, w) - dot(w, w)[:, None, None] * np.eye(3)[..., None] - skew(spin)
    columns = turn.reshape(len(w), 3, -1)
    return turn, columns @ columns.transpose(0, 2, 1), spin @ spin.transpose(0, 2, 1)


def _averaged(given: Conditionals, mode: Mode) -> tuple[Array, Array, Array]:
    """The same, averaged over six points so that the Laplace determinant's slope is included.

    Points c ± √3 l_i, with l_i the columns of a root of the conditional covariance M and c the mode
    less M u/2, u the contraction of f's third derivative with M: the mean of any g over them is
    g + ½ tr(M ∇²g) - ½ uᵀM∇g at the mode, which is the derivative of f + ½ log|H| when g is that of
    f. f is of fourth degree, so ½ u is the mean of ∇f over the same points about the mode.
    """
    root = root_of(mode.covariance) * np.sqrt(3.0)
    offsets = [sign * root[:, :, k] for k in range(3) for sign in (1.0, -1.0)]
    slopes = (local(given, mode.rate + one, curvature=False).gradient for one in offsets)
    centre = mode.rate - times(mode.covariance, sum(slopes, np.zeros(())) / 6.0)
    turn, square, spins = (np.zeros(()) for _ in range(3))
    for offset in offsets:
        point = centre + offset
        spin = given.gain @ (given.torque - cross(point, given.inertia @ point))
        here = _moments(point, spin)
        turn, square, spins = turn + here[0], square + here[1], spins + here[2]
    return turn / 6.0, square / 6.0, spins / 6.0


def _gradient(
    data: ArrayData,
    prior: ArrayPrior,
    given: Conditionals,
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
    gain = given.gain
    trace = np.trace(gain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    pull = 2.0 * prior.exponent * t * (gain - trace)
    by_position = geometry.weight[:, None, None] * first
    by_position += lam * (geometry.centred @ (pull - square))
    parts = [by_position[:, 1:].reshape(b, -1)]
    if prior.motion == "learned":
        back = np.linalg.inv(geometry.factor)
        slope = 0.5 * t * (back.transpose(0, 2, 1) @ back - gain) - 0.5 * spins
        parts.append(prior.factor_gradient(geometry.factor, slope))
    if prior.estimate_noise:
        fitted = np.einsum("baj,baj->b", first, geometry.centred) * geometry.weight
        rest = 0.5 * geometry.weight * data.power.sum() - fitted
        rest += 0.5 * np.einsum("bij,bij->b", square, geometry.spread)
        by_log = 1.5 * t * a - 3.0 * prior.exponent * t - rest
        by_log = by_log - prior.exponent * t * np.einsum("bij,bij->b", gain, given.inertia)
        parts.append(-2.0 * by_log[:, None])
    return np.concatenate(parts, axis=1)
