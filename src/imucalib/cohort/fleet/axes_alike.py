"""Scatter between devices of one axis, drawn towards that of the other axes of its kind.

Few devices say little of a scatter: of five, the four that judge the fifth leave three degrees of
freedom, and Student's t asks for 22 of it at one in a hundred of 45 numbers. Axes of a kind scatter
alike within a factor, log-normal about what they share, so that the others count as ν₀ degrees of
freedom: s² = (ν₀ s₀² + ν s_a²) / (ν₀ + ν), with trigamma(ν₀ / 2) the variance of log s₀² about it
(moderated variances; Smyth 2004, section 6.2).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucalib.arrays import Array

#: Standard deviation of the log of an axis' scatter about that of its kind, as between power-ups.
_UNLIKE = 0.5


def of_a_kind(names: Sequence[str]) -> list[list[int]]:
    """Numbers of the parameters that stand with each: "bias_x" with "bias_y" and "bias_z"."""
    kinds = [name.rpartition("_")[0] or name for name in names]
    return [[j for j, other in enumerate(kinds) if other == kind] for kind in kinds]


def moderated_axes(
    variance: Array, dof: float, kinds: Sequence[Sequence[int]]
) -> tuple[Array, Array]:
    """Variances (p,) above zero with `dof` degrees of freedom each; what becomes of both (p,)."""
    from scipy.special import polygamma

    better, freedom = variance.copy(), np.full(variance.size, dof)
    own = (2.0 * _UNLIKE) ** 2
    for k, kind in enumerate(kinds):
        others = [j for j in kind if j != k]
        if others:
            shared = float(np.exp(np.mean(np.log(variance[others]))))
            doubt = own + (own + float(polygamma(1, dof / 2.0))) / len(others)
            more = 2.0 * inverse_trigamma(doubt)
            better[k] = (more * shared + dof * variance[k]) / (more + dof)
            freedom[k] = dof + more
    return better, freedom


def inverse_trigamma(value: float) -> float:
    from scipy.optimize import brentq
    from scipy.special import polygamma

    found = brentq(lambda log_x: float(polygamma(1, np.exp(log_x))) - value, -12.0, 12.0)
    return float(np.exp(found))
