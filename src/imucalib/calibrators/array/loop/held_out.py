"""Residuals of an array on parts of the motion that positions and effects have not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.state import ArrayState
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
    parts: list[tuple[Array, Array]] = []
    for one, found in zip((setup.first, ~setup.first), base.halves, strict=True):
        step = base.solved(found).step
        rows = setup.inner[~one]
        acceleration = sampled.off.acceleration[rows].copy()
        rate = sampled.off.rate[rows].copy()
        at = 0
        for block, live in zip(base.blocks, base.lives, strict=True):
            theta = live @ step[at : at + live.shape[1]]
            at += live.shape[1]
            target = rate if block.gyro else acceleration
            target -= block.at(theta)[rows]
        parts.append(_without_motion(state, rows, acceleration, rate))
    a = np.concatenate([p[0].ravel() for p in parts])
    g = np.concatenate([p[1].ravel() for p in parts])
    return Residuals(float(np.median(np.abs(a))), float(np.median(np.abs(g)) / DEG))


def _without_motion(
    state: ArrayState, rows: NDArray[np.intp], acceleration: Array, rate: Array
) -> tuple[Array, Array]:
    sampled = state.sampled
    arms, root = sampled.arms[rows], sampled.root[rows]
    heavy = acceleration * sampled.weights.acceleration[rows][..., None]
    right = np.einsum("tkij,tki->tj", arms, heavy)
    right[:, 6:] += np.einsum("tk,tki->ti", sampled.weights.rate[rows], rate)
    nine = np.einsum("tij,tkj,tk->ti", root, root, right, optimize=True)
    moved = np.einsum("tkij,tj->tki", arms, nine)
    return acceleration - moved, rate - nine[:, None, 6:]
