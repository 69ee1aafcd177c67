"""An e-value beside a step's p: valid however often a growing table is searched again.

With Q the restricted likelihood of the rows so far (the fitted parameters and the noise's scale
integrated out under their invariant priors), ρ the settings' scatter over the noise and τ the size
of the effect over its typical one at a noise of one declared σ,

    E = mean over effects, ρ, τ of Q(rows | effect, ρ, τ)  /  mean over ρ of Q(rows | nothing, ρ)

is a test martingale in the rows where nothing is missing (Lindon, Ham, Tingley and Bojinov 2022,
arXiv 2210.08589: linear models under right-Haar priors), so it ever reaches 1/α, at whichever row
one looks, with a chance of at most α (Ville). That is exact without settings; with them on average
over the prior of ρ, and for one ρ as measured in `benchmarks/growing.py`. Every effect that could
be tested has the same stake; a scan keeps its own, unused.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import whitener
from imucalib.core.fit import Fit
from imucalib.units import DEG

#: Scatter of settings, deg at a noise of one σ, and sizes of the effect over its typical one. Both
#: stand before the data do.
SCATTER = (0.0, 0.03, 0.1, 0.3)
SIZES = (0.05, 0.2, 0.8)


def e_value(fit: Fit, blocks: Sequence[Array], stakes: int) -> float:
    """E that something is missing. fit : without it; blocks : (N, m) columns of each effect in the
    balance's units at typical size; stakes : effects and scans. NaN where columns were not kept."""
    if not blocks or any(b.shape[0] != fit.at.residual.size for b in blocks):
        return float("nan")
    logs = log_e_value(fit, blocks)
    top = float(logs.max())
    return float(np.exp(min(top + np.log(np.sum(np.exp(logs - top)) / stakes), 600.0)))


def log_e_value(fit: Fit, blocks: Sequence[Array]) -> Array:
    """(candidates,) log E of each by itself."""
    free = fit.at.free
    rest = fit.noise.ratio[free:]
    grid = [(*point, *rest) for point in product(*([tuple(DEG * s for s in SCATTER)] * free))]
    with_effect: Array = np.full((len(grid), len(blocks)), -np.inf)
    nothing = np.full(len(grid), -np.inf)
    for k, ratio in enumerate(grid):
        nothing[k], with_effect[k] = _likelihoods(fit, ratio, blocks)
    return _log_mean(with_effect) - _log_mean(nothing)


def _likelihoods(
    fit: Fit, ratio: tuple[float, ...], blocks: Sequence[Array]
) -> tuple[float, Array]:
    """Log restricted likelihood without and with each block, the mean over sizes."""
    at = fit.at
    white = whitener(at.settings, ratio)
    basis, triangle = np.linalg.qr(white(at.jacobian))
    residual = white(at.residual)
    residual = residual - basis @ (basis.T @ residual)
    freedom = residual.size - basis.shape[1]
    fixed = -0.5 * white.log_det - float(np.log(np.abs(np.diag(triangle))).sum())
    power = float(residual @ residual)
    found = np.zeros(len(blocks))
    for k, block in enumerate(blocks):
        columns = white(block)
        u, size, _ = np.linalg.svd(columns - basis @ (basis.T @ columns), full_matrices=False)
        explained = (u.T @ residual) ** 2
        gain = (np.array(SIZES)[:, None] * size) ** 2
        left = power - (gain / (1.0 + gain)) @ explained
        logs = -0.5 * (freedom * np.log(left) + np.log1p(gain).sum(axis=1))
        found[k] = _log_mean(logs)
    return fixed - 0.5 * freedom * float(np.log(power)), fixed + found


def _log_mean(logs: Array) -> Array:
    """Log of the mean over the first axis."""
    top = logs.max(axis=0)
    return np.asarray(top + np.log(np.mean(np.exp(logs - top), axis=0)), np.float64)
