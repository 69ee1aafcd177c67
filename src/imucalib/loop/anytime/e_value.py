"""An e-value beside a step's p: valid however often a growing table is searched again.

With Q the restricted likelihood of the rows so far (the fitted parameters and the noise's scale
integrated out under their invariant priors), ρ the settings' scatter over the noise and τ the size
of the effect over its typical one at a noise of one declared σ,

    M = mean over effects, ρ, τ of Q(rows | effect, ρ, τ)  /  mean over ρ of Q(rows | nothing, ρ)

is a test martingale in the rows where nothing is missing (Lindon, Ham, Tingley and Bojinov 2022,
arXiv 2210.08589: linear models under right-Haar priors), so it ever reaches 1/α, at whichever row
one looks, with a chance of at most α (Ville). That is exact without settings; with them on average
over the prior of ρ, and for one ρ as measured in `benchmarks/growing.py`. Every effect that could
be tested has the same stake; a scan keeps its own, unused.

Most of the stake is on looks at numbers of rows that stand beforehand (`looks`): they pay 1/α once
one of them is passed, with a chance of at most `ON_LOOKS` α, whose mean is `ON_LOOKS`. Payments and
martingale add: E = (1 - ON_LOOKS) M + payment.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.loop.anytime.looks import Table, passed
from imucalib.loop.anytime.ratio import Rows, log_ratios
from imucalib.units import DEG

#: Scatter of settings, deg at a noise of one σ: stands before the data do, as the sizes do.
SCATTER = (0.0, 0.03, 0.1, 0.3)
#: What counts as reached, and the share of the stake on looks.
ALPHA, ON_LOOKS = 0.05, 0.9


def e_value(fit: Fit, blocks: Sequence[Array], stakes: int, seed: int = 0) -> float:
    """E that something is missing. fit : without it; blocks : (N, m) columns of each effect in the
    balance's units at typical size; stakes : effects and scans; seed : of simulated tables. NaN
    where columns were not kept."""
    if not blocks or any(b.shape[0] != fit.at.residual.size for b in blocks):
        return float("nan")
    logs = log_e_value(fit, blocks)
    top = float(logs.max())
    mixed = float(np.exp(min(top + np.log(np.sum(np.exp(logs - top)) / stakes), 600.0)))
    own = (1.0 - ON_LOOKS) * mixed
    if own >= 1.0 / ALPHA:
        return own
    rest = fit.noise.ratio[fit.at.free :]
    points = [(*[DEG * s] * fit.at.free, *rest) for s in SCATTER]
    table = Table(_rows(fit, blocks), fit.observations.n, fit.at.residual, fit.noise.ratio, points)
    return own + passed(table, ON_LOOKS * ALPHA, seed) / ALPHA


def log_e_value(fit: Fit, blocks: Sequence[Array]) -> Array:
    """(candidates,) log of the martingale of each by itself."""
    free = fit.at.free
    rest = fit.noise.ratio[free:]
    grid = [(*point, *rest) for point in product(*([tuple(DEG * s for s in SCATTER)] * free))]
    return log_ratios(_rows(fit, blocks), fit.at.residual[:, None], grid)[:, 0]


def _rows(fit: Fit, blocks: Sequence[Array]) -> Rows:
    return Rows(fit.at.jacobian, fit.at.settings, tuple(blocks))
