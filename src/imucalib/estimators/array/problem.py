"""The array's unknowns and data: what the marginal likelihood of the positions is made of.

y_kt = W_t r_k + s_t + e_kt with W_t = Ω(ω_t)² + Ω(ω̇_t), r_1 = 0; gyros give ω_t (paper 001, eqs.
4 and 5). s_t is integrated out flat. ω̇_t is either flat, as in the paper, or N(0, Σ) with Σ
learned together with the positions: flat, it pulls the array's size to zero, by 3 T times the
variance of the size (T integrals, each worth |J|^-1/2).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UsageError

MotionPrior = Literal["learned", "flat"]
HYPER_SD = 2.0  # of each of the six numbers of Σ^-1's Cholesky factor, around the starting scale
NOISE_SD = 1.0  # of the logarithm of the accelerometers' standard deviation around the declared


@dataclass(frozen=True)
class ArrayData:
    """Moving samples of an array.

    acceleration : (T, A, 3) m/s², calibrated triads in the array's frame
    sigma : (A,) m/s², standard deviation of each triad, the same on its three axes
    rate : (T, 3) rad/s, mean of the gyros; rate_precision : (3, 3) or (T, 3, 3), (rad/s)^-2
    """

    acceleration: Array
    sigma: Array
    rate: Array
    rate_precision: Array

    def __post_init__(self) -> None:
        t, a, three = self.acceleration.shape
        fits = three == 3 and self.sigma.shape == (a,) and self.rate.shape == (t, 3)
        if not fits or self.rate_precision.shape not in ((3, 3), (t, 3, 3)):
            raise ValueError("array data of different shapes")

    @property
    def samples(self) -> int:
        return len(self.acceleration)

    @property
    def triads(self) -> int:
        return int(self.acceleration.shape[1])

    def take(self, rows: NDArray[np.intp]) -> ArrayData:
        """The same array at some of the samples."""
        precision = (
            self.rate_precision if self.rate_precision.ndim == 2 else (self.rate_precision[rows])
        )
        return ArrayData(self.acceleration[rows], self.sigma, self.rate[rows], precision)

    @cached_property
    def weight(self) -> Array:
        """(A,) 1/σ²."""
        return np.asarray(self.sigma**-2.0)

    @cached_property
    def weighted(self) -> Array:
        """(A, 3, T) acceleration less its weighted mean over the triads, times the weight."""
        centred = self.acceleration - self.mean[:, None]
        return np.ascontiguousarray((centred * self.weight[:, None]).transpose(1, 2, 0))

    @cached_property
    def mean(self) -> Array:
        """(T, 3) weighted mean over the triads."""
        return np.asarray(
            np.einsum("tai,a->ti", self.acceleration, self.weight) / self.weight.sum()
        )

    @cached_property
    def power(self) -> Array:
        """(T,) weighted sum of squares about the weighted mean."""
        centred = self.acceleration - self.mean[:, None]
        return np.asarray(np.einsum("tai,tai,a->t", centred, centred, self.weight))

    @property
    def precision(self) -> Array:
        """(3, 3, T or 1) of the rate, samples last."""
        return self.rate_precision.reshape(-1, 3, 3).transpose(1, 2, 0)

    @cached_property
    def log_precision(self) -> float:
        """Σ over the samples of log|P|."""
        values = np.linalg.slogdet(self.rate_precision)[1]
        return float(np.sum(values)) * (self.samples if self.rate_precision.ndim == 2 else 1)


@dataclass(frozen=True)
class ArrayPrior:
    """What is assumed beforehand.

    nominal : (A, 3) m, drawn positions in the array's frame; sd : m, of each coordinate of
        triads 2 to A relative to triad 1
    motion : "learned" or "flat"; exponent : of |HᵀLH|, 1/2 by derivation, 1 as printed in (25)
    motion_scale : (rad/s²)², rough variance of ω̇ around which Σ is sought
    estimate_noise : whether one factor on all accelerometer sigmas is an unknown
    """

    nominal: Array
    sd: float = 3e-3
    motion: MotionPrior = "learned"
    exponent: float = 0.5
    motion_scale: float = 1e5
    estimate_noise: bool = False

    def __post_init__(self) -> None:
        if self.motion == "learned" and self.exponent != 0.5:
            raise UsageError(
                "the printed determinant goes with the flat motion prior only",
                remedy="use --motion-prior flat with --det-exponent 1",
            )

    @property
    def positions(self) -> int:
        """Number of free coordinates."""
        return 3 * (len(self.nominal) - 1)

    @property
    def motion_size(self) -> int:
        return 6 if self.motion == "learned" else 0

    @property
    def size(self) -> int:
        return self.positions + self.motion_size + int(self.estimate_noise)

    @cached_property
    def sd_vector(self) -> Array:
        """(size,) prior standard deviations in the order of the unknowns."""
        parts = [np.full(self.positions, self.sd), np.full(self.motion_size, HYPER_SD)]
        return np.concatenate([*parts, np.full(int(self.estimate_noise), NOISE_SD)])

    @cached_property
    def mean_vector(self) -> Array:
        """(size,) prior means: the drawing, Σ = motion_scale · I, the declared noise."""
        start = np.zeros(self.size)
        start[: self.positions] = (self.nominal[1:] - self.nominal[0]).ravel()
        return start

    def geometry(self, x: Array) -> Array:
        """(B, A, 3) m from unknowns (B, size); triad 1 at zero."""
        free = x[:, : self.positions].reshape(len(x), -1, 3)
        return np.concatenate([np.zeros((len(x), 1, 3)), free], axis=1)

    def factor(self, x: Array) -> Array:
        """(B, 3, 3) lower L with Σ^-1 = L Lᵀ, (rad/s²)^-1; zero for the flat prior."""
        out = np.zeros((len(x), 3, 3))
        if self.motion == "flat":
            return out
        h = x[:, self.positions : self.positions + 6]
        for k in range(3):
            out[:, k, k] = np.exp(np.clip(h[:, k], -40.0, 40.0))
        out[:, 1, 0], out[:, 2, 0], out[:, 2, 1] = h[:, 3], h[:, 4], h[:, 5]
        return np.asarray(out / np.sqrt(self.motion_scale))

    def factor_gradient(self, factor: Array, slope: Array) -> Array:
        """(B, 6) gradient by the unknowns of Σ, from (B, 3, 3) the gradient by Σ^-1."""
        by_factor = 2.0 * slope @ factor
        scale = 1.0 / np.sqrt(self.motion_scale)
        diagonal = [by_factor[:, k, k] * factor[:, k, k] for k in range(3)]
        below = [by_factor[:, i, j] * scale for i, j in ((1, 0), (2, 0), (2, 1))]
        return np.stack([*diagonal, *below], axis=1)

    def noise_weight(self, x: Array) -> Array:
        """(B,) factor on all weights 1/σ²."""
        if not self.estimate_noise:
            return np.ones(len(x))
        return np.asarray(np.exp(-2.0 * x[:, -1]), np.float64)
