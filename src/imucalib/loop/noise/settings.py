"""Whether one axis of a bench is set so much worse than the other that its dial is in doubt.

Few settings of a dial that is off (zero, scale, eccentricity) scatter as if they were badly set.
The same hands set both axes: beyond a few times the other's scatter the cause is open.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from imucalib.core.fit import Fit
from imucalib.effects import known
from imucalib.loop.evidence import Score
from imucalib.loop.found import Unexplained
from imucalib.units import DEG

#: A dial with fewer settings has no shape to be seen by; scatter (rad) that any bench may have; and
#: how far one axis may scatter beyond the other: on the table of paper 004 the two differ by 1.8.
_FEW, _USUAL, _BEYOND = 10, 0.05 * DEG, 3.0


def doubtful_dials(fit: Fit, scores: tuple[Score, ...], alpha: float) -> tuple[Unexplained, ...]:
    """Axes with few settings that scatter beyond doubt more than `_BEYOND` times the other's.

    scores : of the last search; what turns the bench and explains most stands beside the scatter
    """
    dials = strongest(s for s in scores if _turns(s.name))
    return tuple(
        Unexplained(
            f"the {settings} {axis} settings are off by {own / DEG:.2g} deg, those of the other "
            f"axis by {other / DEG:.2g} deg: so few cannot tell a dial that is off from scatter",
            axis, "noise", p, 0.0, 0.0,
            alike=dials,
        )
        for axis, settings, own, other, p in _compared(fit)
        if p < alpha
    )  # fmt: skip


def strongest(scores: Iterable[Score]) -> tuple[str, ...]:
    """Names of those that explain at least half as much as the best, if anything."""
    own = [s for s in scores if s.evidence > 0.0]
    return tuple(s.name for s in own if s.evidence > 0.5 * own[0].evidence)


def _turns(name: str) -> bool:
    effect = known(name)
    return effect is not None and effect.stage == "fixture"


def _compared(fit: Fit) -> list[tuple[str, int, float, float, float]]:
    """Of each axis with few settings: name, settings, its scatter and the other's (rad), chance."""
    from scipy.special import chdtrc, fdtrc

    at, noise = fit.at, fit.noise
    free = range(at.free)
    if at.free != 2 or fit.noise_covariance.size < 9:
        return []
    found = []
    for c in free:
        settings, own, other = at.settings[c].shape[1], noise.sd[c], noise.sd[1 - c]
        spread = float(fit.noise_covariance[c + 1, c + 1])
        if settings >= _FEW or own <= 0.0 or not spread > 0.0:
            continue
        worth = 0.5 / spread  # degrees of freedom of its estimate
        ratio = (own / (_BEYOND * max(other, _USUAL))) ** 2
        known = float(fit.noise_covariance[2 - c, 2 - c])
        if other > _USUAL and known > 0.0:
            p = float(fdtrc(worth, 0.5 / known, ratio))
        else:
            p = float(chdtrc(worth, worth * ratio))
        if math.isfinite(p):
            found.append((at.component[c].removesuffix(" setting"), settings, own, other, p))
    return found
