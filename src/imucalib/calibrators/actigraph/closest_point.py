"""The field's rule beside ours: GGIR's auto-calibration, from the same recording's windows.

Ten-second windows whose three axes scatter by less than 13 mg, each taken as one point: gain and
offset of each axis bring the points to the unit sphere, each step a regression of the nearest
points on the present ones (van Hees et al. 2014, J Appl Physiol 117, 738-744, Appendix). It has six
parameters, counts windows of one posture as independent, and states no uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.rests.runs import Scan
from imucalib.units import MG, STANDARD_GRAVITY

_SCATTER, _LARGEST, _SPAN = 13.0 * MG, 2.0 * STANDARD_GRAVITY, 0.3
_ROUNDS, _SETTLED, _NEAREST = 1000, 1e-10, 0.01


@dataclass(frozen=True)
class ClosestPoint:
    """corrected = scale (raw + offset), in g. scale, offset : (3,); points : windows used
    before, after : mean error of |a| over these windows, mg; enough : whether every axis saw both
    signs beyond 0.3 g, without which the rule is not to be applied"""

    scale: Array
    offset: Array
    points: int
    before: float
    after: float
    enough: bool

    def as_dict(self) -> dict[str, Any]:
        """The block of report.json."""
        return {
            "scale": self.scale.tolist(),
            "offset_g": self.offset.tolist(),
            "windows": self.points,
            "error_before_mg": self.before,
            "error_after_mg": self.after,
            "enough": self.enough,
        }

    def norm_error(self, reading: Array) -> Array:
        """(n,) m/s², |corrected| minus 1 g of readings (n, 3) m/s²."""
        size = np.linalg.norm(self.scale * (reading / STANDARD_GRAVITY + self.offset), axis=1)
        return np.asarray((size - 1.0) * STANDARD_GRAVITY, np.float64)


def closest_point(scanned: Scan) -> ClosestPoint | None:
    """The rule on the windows of a scan; None with fewer than ten of them at rest."""
    w = scanned.windows
    still = (np.sqrt(w.variance) < _SCATTER).all(axis=1) & (np.abs(w.mean) < _LARGEST).all(axis=1)
    points = w.mean[still] / STANDARD_GRAVITY
    points = points[(points**2).sum(axis=1) > 0.0]
    if len(points) < 10:
        return None
    scale, offset = _fitted(points)
    enough = bool((points.min(axis=0) < -_SPAN).all() and (points.max(axis=0) > _SPAN).all())
    sizes = (np.linalg.norm(p, axis=1) for p in (points, scale * (points + offset)))
    before, after = (1e3 * float(np.mean(np.abs(s - 1.0))) for s in sizes)
    return ClosestPoint(scale, offset, len(points), before, after, enough)


def _fitted(points: Array) -> tuple[Array, Array]:
    scale, offset = np.ones(3), np.zeros(3)
    weight, last = np.ones(len(points)), np.inf
    for _ in range(_ROUNDS):
        now = scale * (points + offset)
        nearest = now / np.linalg.norm(now, axis=1, keepdims=True)
        total = weight.sum()
        centre, target = (weight @ v / total for v in (now, nearest))
        spread = weight @ np.square(now - centre)
        slope = weight @ ((now - centre) * (nearest - target)) / np.maximum(spread, 1e-12)
        shift = target - slope * centre
        offset = offset + shift / (scale * slope)
        scale = scale * slope
        away = np.linalg.norm(shift + slope * now - nearest, axis=1)
        misfit = float(weight @ away**2 / total)
        weight = np.minimum(1.0 / np.maximum(away, 1e-12), 1.0 / _NEAREST)
        if abs(misfit - last) < _SETTLED:
            break
        last = misfit
    return scale, offset
