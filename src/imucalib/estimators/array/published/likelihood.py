"""The likelihood of an array's positions of paper 001, with the motion integrated out.

y_kt = W_t r_k + s_t + e_kt with W_t = Ω(ω_t)² + Ω(dω_t/dt), r_1 = 0; gyros give ω_t (eqs. 4 and 5).
dω/dt and s_t are integrated out flat, which pulls the array's size to zero by 3 T times its
variance (T integrals, each worth |J|^-1/2). The determinant's exponent is 1/2: a Gaussian of
covariance M carries |2πM|^-1/2, and as the motion's prior widens |M| tends to a constant times
|HᵀLH|, with L the accelerometers' precision; (25) and (26) as printed lack the square root.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imucalib.arrays import Array


@dataclass(frozen=True)
class ArrayData:
    """Moving samples of an array.

    acceleration : (T, A, 3) m/s², calibrated triads in the array's frame
    sigma : (A,) m/s², standard deviation of each triad, the same on its three axes
    rate : (T, 3) rad/s, mean of the gyros; rate_precision : (T, 3, 3) (rad/s)^-2
    """

    acceleration: Array
    sigma: Array
    rate: Array
    rate_precision: Array

    @property
    def samples(self) -> int:
        return len(self.acceleration)

    @cached_property
    def weight(self) -> Array:
        """(A,) 1/σ²."""
        return np.asarray(self.sigma**-2.0)

    @cached_property
    def centred(self) -> Array:
        """(T, A, 3) acceleration less its weighted mean over the triads."""
        mean = np.einsum("tai,a->ti", self.acceleration, self.weight) / self.weight.sum()
        return np.asarray(self.acceleration - mean[:, None])


@dataclass(frozen=True)
class DrawnPrior:
    """Positions about the drawing. nominal : (A, 3) m, in the array's frame; sd : m, of each
    coordinate of triads 2 to A relative to triad 1"""

    nominal: Array
    sd: float = 3e-3

    @property
    def size(self) -> int:
        return 3 * (len(self.nominal) - 1)

    @property
    def mean(self) -> Array:
        """(size,) m."""
        return np.asarray((self.nominal[1:] - self.nominal[0]).ravel())


def log_likelihood(data: ArrayData, x: Array, rate: Array) -> Array:
    """(B, N, T) log density of every sample's accelerations at positions x (B, size), m, given
    rates (N, T, 3) rad/s: equation (23) in closed form over s and dω/dt.

    With N = Σ λ y rᵀ over triads about their weighted mean and J = Σ λ (|r|² I - r rᵀ), -2 log p is
    yᵀy - 2 ωᵀNω + 2 |ω|² tr N + |ω|² ωᵀJω - vᵀJ⁻¹v, v = vee(N) - ω x Jω, up to the determinants.
    """
    lam, a = data.weight, data.acceleration.shape[1]
    r = np.concatenate([np.zeros((len(x), 1, 3)), x.reshape(len(x), -1, 3)], axis=1)
    r = r - (lam / lam.sum() @ r)[:, None]
    spread = np.einsum("baj,bak,a->bjk", r, r, lam)
    inertia = np.trace(spread, axis1=1, axis2=2)[:, None, None] * np.eye(3) - spread
    moment = np.einsum("tai,baj,a->btij", data.centred, r, lam, optimize=True)
    skew = moment.swapaxes(2, 3) - moment
    torque = np.stack([skew[..., 1, 2], skew[..., 2, 0], skew[..., 0, 1]], axis=-1)[:, None]
    square = np.sum(rate * rate, axis=-1)
    jw = np.einsum("bij,ntj->bnti", inertia, rate)
    v = torque - np.cross(rate[None], jw)
    power = np.einsum("tai,tai,a->t", data.centred, data.centred, lam)
    trace = np.einsum("btii->bt", moment)
    value = power - 2.0 * np.einsum("nti,btij,ntj->bnt", rate, moment, rate, optimize=True)
    value = value + square * (2.0 * trace[:, None] + np.einsum("nti,bnti->bnt", rate, jw))
    value = value - np.einsum("bnti,bij,bntj->bnt", v, np.linalg.inv(inertia), v, optimize=True)
    level = -0.5 * (np.linalg.slogdet(inertia)[1] + 3.0 * np.log(lam.sum()))
    level = level + 1.5 * np.log(lam).sum() - 1.5 * (a - 2) * np.log(2.0 * np.pi)
    return np.asarray(level[:, None, None] - 0.5 * value)
