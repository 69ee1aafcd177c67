"""Residuals of an array on parts of the motion that positions and effects have not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.estimators.array.gram import beside_motion
from imucalib.loop.found import Checked
from imucalib.units import DEG

NORMAL_MAD = 1.4826


@dataclass(frozen=True)
class Residuals:
    """Median absolute deviations: acceleration (m/s²) and rate (deg/s)."""

    acceleration: float
    rate: float

    def against(self, after: Residuals) -> tuple[Checked, ...]:
        """These before a step and others after it."""
        return (
            Checked("accelerometers", "m/s2", self.acceleration, after.acceleration),
            Checked("gyros", "deg/s", self.rate, after.rate),
        )


def held_out_residuals(state: ArrayState) -> Residuals:
    """Each half of the motion, in blocks, under positions and effects of the other half.

    One Gauss-Newton step from the joint fit; the motion of a sample is always its own.
    """
    setup, sampled, base = state.setup, state.sampled, state.base
    off, parts = sampled.off, []
    for one, found in zip((setup.first, ~setup.first), base.halves, strict=True):
        rows = setup.inner[~one]
        change = base.reading(base.solved(found).step, off.rate.shape)
        parts.append(beside_motion(sampled, off.less(change).take(rows), rows))
    a = np.concatenate([p.acceleration.ravel() for p in parts])
    g = np.concatenate([p.rate.ravel() for p in parts])
    return Residuals(float(np.median(np.abs(a))), float(np.median(np.abs(g)) / DEG))
