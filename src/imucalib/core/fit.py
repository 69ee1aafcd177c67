"""What every estimator returns, and what the data cannot determine, in words.

A combination of parameters is open when the data know it worse than data sheets do: singular
values of the whitened Jacobian, scaled by each parameter's typical size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Balanced, Noise, Whitener, whitener
from imucalib.core.effect import Parameter
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.prior import Prior
from imucalib.data import Data

#: A combination counts as open when its standard deviation exceeds this many typical sizes.
OPEN_AT = 3.0
_LEVEL = 0.95  # of intervals


def null_directions(
    white_jacobian: Array, parameters: tuple[Parameter, ...], factor: float
) -> tuple[str, ...]:
    """Sentences for each open combination; white_jacobian is (N, p) at noise factor 1."""
    if not parameters:
        return ()
    typical = np.array([p.typical for p in parameters])
    scaled = white_jacobian * typical / factor
    if len(scaled) > len(parameters):
        scaled = np.linalg.qr(scaled, mode="r")
    _, values, rows = np.linalg.svd(scaled, full_matrices=True)
    values = np.concatenate([values, np.zeros(len(parameters) - values.size)])
    found = [rows[k] for k in range(len(parameters)) if values[k] * OPEN_AT < 1.0]
    return tuple(_words(direction, parameters) for direction in found)


def _words(direction: Array, parameters: tuple[Parameter, ...]) -> str:
    order = np.argsort(-np.abs(direction))
    share = np.abs(direction) / np.abs(direction).max()
    main = [parameters[k].name for k in order if share[k] > 0.2][:5]
    if len(main) == 1:
        return f"{main[0]} is not determined"
    return f"{main[0]} cannot be told from {', '.join(main[1:])}"


class StoredParameter(Data):
    """A parameter: value and standard deviation in `unit`."""

    name: str
    effect: str
    stage: Annotated[str, "Of the effect; what is off in the fixture is not the sensor's."]
    value: float
    sd: float
    unit: str


@dataclass(frozen=True)
class NoiseMixture:
    """θ over what the noise may be: of m noises the weight (m,), θ less the fit's (m, p) and its
    covariance (m, p, p); log_sd : (1 + c,) of the logs of factor and components."""

    log_sd: Array
    weight: Array
    shift: Array
    covariance: Array

    def half_widths(self, rows: Array) -> Array:
        """(R,) half widths about the fit's θ of 95 % intervals of rows (R, p) times θ."""
        from scipy.special import ndtr

        shift = rows @ self.shift.T
        spread = np.einsum("rp,mpq,rq->rm", rows, self.covariance, rows, optimize=True)
        sd = np.sqrt(np.maximum(spread, 1e-300))
        low = np.zeros(len(rows))
        high = np.max(np.abs(shift) + 9.0 * sd, axis=1)
        for _ in range(40):
            half = 0.5 * (low + high)
            inside = ndtr((half[:, None] - shift) / sd) - ndtr((-half[:, None] - shift) / sd)
            over = inside @ self.weight > _LEVEL
            low, high = np.where(over, low, half), np.where(over, half, high)
        return np.asarray(high)


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
    shrink : (p,) standard deviation of each parameter about its start over the noise factor, where
        a search has found how large it may be, infinite elsewhere; or None
    mixture : over the noise, where that was integrated out; the covariance is the mixture's then
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
    prior: Prior | None = None
    mixture: NoiseMixture | None = None
    shrink: Array | None = None

    def linearise_known(self, theta: Array) -> Array:
        """(k, 1 + p): what is left at θ of what is known of the parameters beside the readings, and
        its derivative, with the noise factor for its noise."""
        if self.prior is not None:
            return self.noise.factor * self.prior.rows(theta)
        sd = self.known_sd / self.noise.factor
        return shrink_rows(sd, np.array([p.start for p in self.parameters]) - theta)

    @property
    def known_sd(self) -> Array:
        """(p,) standard deviation of each parameter before the readings: what a data sheet says,
        or how large a search found that it may be; infinite where nothing is known."""
        sheet = self.observations.noise_prior
        told = sheet.parameters if sheet is not None else {}
        sd = np.array([told.get(p.name, np.inf) for p in self.parameters])
        return sd if self.shrink is None else np.minimum(sd, self.noise.factor * self.shrink)

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

    def half_width(self, direction: Array) -> Array:
        """Half widths (...) of the two-sided 95 % intervals of directions (..., p) times θ: of the
        mixture over the noise, else Student's t."""
        from scipy.special import stdtrit

        rows = direction.reshape(-1, direction.shape[-1])
        if self.mixture is not None:
            found = self.mixture.half_widths(rows)
        else:
            variance = np.einsum("rp,pq,rq->r", rows, self.covariance, rows)
            freedom = np.array([self.interval_dof(row) for row in rows])
            found = stdtrit(freedom, 0.5 + _LEVEL / 2.0) * np.sqrt(np.maximum(variance, 0.0))
        return np.asarray(found.reshape(direction.shape[:-1]))


def shrink_rows(shrink: Array, away: Array) -> Array:
    """(k, 1 + p) rows of parameters whose standard deviation over the noise factor is finite; away
    : (p,) start less value."""
    held = np.flatnonzero(np.isfinite(shrink))
    rows = np.zeros((held.size, 1 + shrink.size))
    rows[:, 0] = away[held] / shrink[held]
    rows[np.arange(held.size), 1 + held] = 1.0 / shrink[held]
    return rows
