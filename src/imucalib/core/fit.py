"""What every estimator returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Balanced, Noise, Whitener, whitener
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.parameter import Parameter
from imucalib.core.prior import Prior


@dataclass(frozen=True)
class Fit:
    """A fitted model.

    theta, parameters : (p,) values and what they are
    covariance : (p, p) with the noise as estimated; covariance / factor² is the one that the
        declared noise would give
    eta : free directions at the solution
    noise, noise_sd : estimated noise, and relative standard deviations of (factor, *sd)
    chi2, dof : Σ(residual/declared σ)² after taking the settings out, and its degrees of freedom
    log_likelihood : restricted log likelihood (nats, up to a constant of the data set)
    slope : (c, p, p) derivative of the covariance by log noise parameter, and
    noise_covariance : (c, c) of the log noise parameters; both for `interval_dof`
    null_directions : combinations that the data leave open, in words
    prior : of the parameters, or None where the data alone speak
    """

    model: Model
    parameters: tuple[Parameter, ...]
    theta: Array
    covariance: Array
    eta: Array
    noise: Noise
    noise_covariance: Array
    slope: Array
    at: Balanced
    observations: Observations
    chi2: float
    dof: int
    log_likelihood: float
    null_directions: tuple[str, ...]
    converged: bool
    iterations: int
    prior: Prior | None = None

    @property
    def sd(self) -> Array:
        return np.sqrt(np.diag(self.covariance))

    @property
    def condition(self) -> float:
        """Condition number of the whitened Jacobian in typical sizes: 1 is ideal, 1e3 is poor."""
        typical = np.array([p.typical for p in self.parameters])
        values = np.linalg.eigvalsh(self.covariance / np.outer(typical, typical))
        return float(np.sqrt(values[-1] / max(values[0], 1e-300))) if values.size else 1.0

    @property
    def noise_sd(self) -> Array:
        """Relative standard deviation of the noise factor and of each component's sd."""
        return np.sqrt(np.maximum(np.diag(self.noise_covariance), 0.0))

    def white_basis(self) -> tuple[Whitener, Array]:
        """The whitener of the noise, and an orthonormal basis of the whitened Jacobian."""
        white = whitener(self.at.settings, self.noise.ratio)
        return white, np.linalg.qr(white(self.at.jacobian))[0]

    def residual(self) -> Array:
        """(n, K, 3) m/s²: reading minus prediction at the estimated settings."""
        reference, context = self.observations.reference, self.observations.context
        predicted = self.model.predict(self.theta, reference.truth(self.eta), context)
        return self.observations.reading - predicted.reading

    def interval_dof(self, direction: Array) -> float:
        """Satterthwaite's degrees of freedom for the combination directionᵀθ.

        The variances come from few settings, so intervals need Student's t: dof = 2 v² / var(v)
        with v = directionᵀ C direction (Giesbrecht and Burns 1985).
        """
        v = float(direction @ self.covariance @ direction)
        gradient = np.einsum("i,cij,j->c", direction, self.slope, direction)
        spread = float(gradient @ self.noise_covariance @ gradient)
        return float(np.clip(2.0 * v * v / spread, 1.0, 1e6)) if spread > 0.0 else float(self.dof)

    def half_width(self, direction: Array, level: float = 0.95) -> float:
        """Half width of the two-sided interval of directionᵀθ at a level."""
        from scipy.special import stdtrit

        v = float(direction @ self.covariance @ direction)
        quantile = float(stdtrit(self.interval_dof(direction), 0.5 + level / 2.0))
        return quantile * float(np.sqrt(max(v, 0.0)))
