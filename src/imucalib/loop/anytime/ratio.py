"""The restricted likelihood's ratio with and without effects, over their sizes and the settings'
scatter, of many data sets at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import whitener

#: Sizes of an effect over its typical one, at a noise of one σ.
SIZES = (0.05, 0.2, 0.8)
#: Length of a column beside the fitted ones below which it is rounding.
_NONE = 1e-9


@dataclass(frozen=True)
class Rows:
    """Rows of a table. jacobian : (N, p) of what is fitted; settings : (N, q_c) of each component;
    blocks : (N, m) of each effect at typical size; all in the balance's units"""

    jacobian: Array
    settings: tuple[Array, ...]
    blocks: tuple[Array, ...]

    def first(self, count: int) -> Rows:
        """The first numbers of them."""
        part = slice(0, count)
        return Rows(
            self.jacobian[part],
            tuple(s[part] for s in self.settings),
            tuple(b[part] for b in self.blocks),
        )


def log_ratios(rows: Rows, data: Array, points: Sequence[tuple[float, ...]]) -> Array:
    """(effects, D) log E of each effect by itself in data (N, D). points : ratios of the settings'
    scatter to the noise, a mean over which is taken of both likelihoods"""
    with_effect = np.zeros((len(points), len(rows.blocks), data.shape[1]))
    nothing = np.zeros((len(points), data.shape[1]))
    for k, point in enumerate(points):
        nothing[k], with_effect[k] = _likelihoods(rows, data, point)
    return log_mean(with_effect) - log_mean(nothing)


def _likelihoods(rows: Rows, data: Array, ratio: tuple[float, ...]) -> tuple[Array, Array]:
    """Log restricted likelihood (D,) without and (effects, D) with each, the mean over sizes."""
    white = whitener(rows.settings, ratio)
    basis, triangle = np.linalg.qr(white(rows.jacobian))
    residual = white(data)
    residual = residual - basis @ (basis.T @ residual)
    freedom = data.shape[0] - basis.shape[1]
    diagonal = np.maximum(np.abs(np.diag(triangle)), _NONE)
    fixed = -0.5 * white.log_det - float(np.log(diagonal).sum())
    power = np.sum(residual**2, axis=0)
    found = np.zeros((len(rows.blocks), data.shape[1]))
    for k, block in enumerate(rows.blocks):
        columns = white(block)
        u, size, _ = np.linalg.svd(columns - basis @ (basis.T @ columns), full_matrices=False)
        explained = (u.T @ residual) ** 2
        gain = (np.array(SIZES)[:, None] * size) ** 2
        left = power - (gain / (1.0 + gain)) @ explained
        logs = -0.5 * (freedom * np.log(left) + np.log1p(gain).sum(axis=1)[:, None])
        found[k] = log_mean(logs)
    return fixed - 0.5 * freedom * np.log(power), fixed + found


def log_mean(logs: Array) -> Array:
    """Log of the mean over the first axis."""
    top = logs.max(axis=0)
    return np.asarray(top + np.log(np.mean(np.exp(logs - top), axis=0)), np.float64)
