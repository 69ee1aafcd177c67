"""What is known of the parameters before the data: a normal prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array


@dataclass(frozen=True)
class Prior:
    """mean (p,) of θ; root (p, p), rootᵀ root its precision

    noise : (1 + components, 2) mean and sd of the logs of the noise factor and of each component's
        sd (rad), where devices of the kind have told them; None where nothing is known of them
    """

    mean: Array
    root: Array
    noise: Array | None = None

    def rows(self, theta: Array) -> Array:
        """(p, 1 + p): what is left of the prior at θ, and its derivative; unit noise."""
        return np.column_stack([self.root @ (self.mean - theta), self.root])

    @property
    def covariance(self) -> Array:
        """(p, p)"""
        inverse = np.linalg.inv(self.root)
        return np.asarray(inverse @ inverse.T)


def joint_prior(mean: Array, covariance: Array) -> Prior:
    """Of parameters (p,) that are known together, covariance (p, p).

    Scaled to unit variances first: parameters differ by orders of magnitude in their units.
    """
    size = np.sqrt(np.diag(covariance))
    lower = np.linalg.cholesky(covariance / np.outer(size, size))
    return Prior(mean, np.asarray(np.linalg.inv(lower) / size, np.float64))


def independent(mean: Array, sd: Array) -> Prior:
    """Of parameters (p,) that are known each by itself."""
    return Prior(mean, np.diag(1.0 / sd))
