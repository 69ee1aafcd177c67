"""Misfits of a later recording, linearised once, with the parts of their covariance.

    misfit = reading - foretold = J (θ - θ̂) + N η + noise + C (change)

With the calibration's full covariance Cθ the misfits of an unchanged sensor have the covariance
V = s² W + J Cθ Jᵀ + Σ sd² N Nᵀ + Σ session² C Cᵀ. Each part's size was estimated with degrees of
freedom of its own; the calibration's covariance goes with the noise of its readings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.checking.noise import Scatter
from imucalib.core.eigen import eigen


@dataclass(frozen=True)
class Part:
    """covariance : (N, N) (m/s²)²; dof : degrees of freedom behind its size"""

    covariance: Array
    dof: float

    def take(self, rows: Index) -> Part:
        return replace(self, covariance=self.covariance[np.ix_(rows, rows)])


@dataclass(frozen=True)
class Misfits:
    """N misfits of n rests or positions.

    value : (N,) m/s²; reading : of the readings' noise; setting : by the name of the component
    session : by the kind of change, what a power-up brings, in its unit
    jacobian : (N, p) by all of the calibration's parameters, zero for those that do not act here
    parameters : (p, p) their covariance; changes : per kind, (N, 3) m/s² per unit
    owner : (N,) row of each; label : (n,) of the rows; force : (n, 3) m/s² corrected
    directed : whether directions are known
    """

    value: Array
    reading: Part
    setting: Mapping[str, Part]
    session: Mapping[str, Scatter]
    jacobian: Array
    parameters: Array
    changes: Mapping[str, Array]
    owner: Index
    label: tuple[str, ...]
    force: Array
    directed: bool

    @property
    def n(self) -> int:
        return len(self.label)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """Readings with the calibration's own error, settings, power-up."""
        carried = self.jacobian @ self.parameters @ self.jacobian.T
        columns = {k: s.sd * self.changes[k] for k, s in self.session.items() if k in self.changes}
        return (
            replace(self.reading, covariance=self.reading.covariance + carried),
            *self.setting.values(),
            *(Part(c @ c.T, self.session[kind].dof) for kind, c in columns.items()),
        )

    @cached_property
    def covariance(self) -> Array:
        """(N, N) of an unchanged sensor."""
        return np.asarray(np.sum([part.covariance for part in self.parts], axis=0))

    @cached_property
    def noise(self) -> Array:
        """(N, N) what is not the calibration's error."""
        return self.covariance - self.jacobian @ self.parameters @ self.jacobian.T

    @cached_property
    def dof(self) -> float:
        """Of the whole covariance's scale: ν = 1 / Σ share² / ν_part (Satterthwaite 1946,
        Biometrics Bulletin 2, 110-114)."""
        inverse = np.linalg.inv(self.covariance)
        share = np.array([np.sum(inverse * part.covariance) for part in self.parts])
        share = share / share.sum()
        return float(1.0 / np.sum(share**2 / np.array([part.dof for part in self.parts])))

    def white(self, columns: Array) -> Array:
        """L⁻¹ columns, V = L Lᵀ."""
        from scipy.linalg import solve_triangular

        lower = np.linalg.cholesky(self.covariance)
        return np.asarray(solve_triangular(lower, columns, lower=True, check_finite=False))

    def drawn(self, rng: np.random.Generator, draws: int) -> Array:
        """(draws, N) whitened misfits of unchanged sensors, each part's true size drawn by what its
        estimate says: size² = estimate² ν / χ²(ν) (Fisher's fiducial law, exact of one part)."""
        total: Array = np.zeros((draws, self.value.size))
        for part in self.parts:
            white = self.white(self.white(part.covariance).T)
            values, vectors = eigen(0.5 * (white + white.T))
            keep = values > 1e-12 * max(float(values[-1]), 1e-300)
            # The symmetric root: equal values leave the vectors open, and rounding would choose.
            root = (vectors[:, keep] * np.sqrt(values[keep])) @ vectors[:, keep].T
            size = np.sqrt(part.dof / rng.chisquare(part.dof, draws))[:, None]
            total += size * (rng.standard_normal((draws, root.shape[1])) @ root.T)
        return total

    def take(self, rows: Index) -> Misfits:
        """Some of the rows, in order."""
        left = np.flatnonzero(np.isin(self.owner, rows))
        return replace(
            self,
            value=self.value[left],
            reading=self.reading.take(left),
            setting={name: part.take(left) for name, part in self.setting.items()},
            jacobian=self.jacobian[left],
            changes={name: c[left] for name, c in self.changes.items()},
            owner=np.searchsorted(rows, self.owner[left]),
            label=tuple(self.label[r] for r in rows),
            force=self.force[rows],
        )

    def without(self, row: int) -> Misfits:
        """All rows but one."""
        return self.take(np.delete(np.arange(self.n, dtype=np.intp), row))

    def joined(self, other: Misfits) -> Misfits:
        """Both, of one power-up: the calibration's errors and the session's are common to all."""
        m, k = self.value.size, other.value.size
        setting = {
            name: Part(
                _diagonal(_of(self.setting, name, m), _of(other.setting, name, k)),
                (self.setting.get(name) or other.setting[name]).dof,
            )
            for name in {**self.setting, **other.setting}
        }
        return replace(
            self,
            value=np.concatenate([self.value, other.value]),
            reading=Part(
                _diagonal(self.reading.covariance, other.reading.covariance), self.reading.dof
            ),
            setting=setting,
            jacobian=np.concatenate([self.jacobian, other.jacobian]),
            changes={n: np.concatenate([c, other.changes[n]]) for n, c in self.changes.items()},
            owner=np.concatenate([self.owner, other.owner + self.n]),
            label=(*self.label, *other.label),
            force=np.concatenate([self.force, other.force]),
        )


def _of(parts: Mapping[str, Part], name: str, size: int) -> Array:
    return parts[name].covariance if name in parts else np.zeros((size, size))


def _diagonal(one: Array, other: Array) -> Array:
    from scipy.linalg import block_diag

    return np.asarray(block_diag(one, other), np.float64)
