"""What a power-up changes, in the covariances of calibrations of different days.

A calibration of one power-up states how well that one is known: its bias and its seat are the
day's. One of several states the mean, and the scatter about it. Beside another day's, the first
lacks the scatter whole; the other's mean holds its share, known from as many power-ups as it has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.noise import FAMILIES, Scatter, stated_sessions
from imucalib.calibration.comparison.basis import PowerUps


@dataclass(frozen=True)
class BetweenPowerUps:
    """calibrations : with the scatter in their covariances
    power_ups : what of them it is, or None where nothing tells it
    words : where it is from, or that nothing states it"""

    calibrations: tuple[Calibration, ...]
    power_ups: PowerUps | None
    words: str


def with_power_ups(
    calibrations: Sequence[Calibration], given: Mapping[str, float]
) -> BetweenPowerUps:
    """given : kind of change -> its scatter (bias mg, mounting deg) instead of what files state"""
    stated = [stated_sessions(c) for c in calibrations]
    scatter = {kind: Scatter(size) for kind, size in given.items()} or _pooled(stated)
    words = _words(scatter, given, stated)
    if not scatter:
        return BetweenPowerUps(tuple(calibrations), None, words)
    made, share = [], []
    for calibration, own in zip(calibrations, stated, strict=True):
        count = len(calibration.facts["between_sessions"]["sessions"]) if own else 1
        part = _on_parameters(calibration, own or scatter, count)
        whole = calibration.covariance if own else calibration.covariance + part
        made.append(replace(calibration, covariance=whole))
        share.append(part)
    dof = min(s.dof for s in scatter.values())
    return BetweenPowerUps(tuple(made), PowerUps(share, dof), words)


def _pooled(stated: Sequence[Mapping[str, Scatter]]) -> dict[str, Scatter]:
    """Mean of the variances that files state, by their degrees of freedom."""
    found = {}
    for kind in FAMILIES:
        every = [one[kind] for one in stated if kind in one]
        if every:
            dof = sum(s.dof for s in every)
            found[kind] = Scatter((sum(s.dof * s.sd**2 for s in every) / dof) ** 0.5, dof)
    return found


def _on_parameters(calibration: Calibration, scatter: Mapping[str, Scatter], count: int) -> Array:
    """(p, p) what power-ups bring to a mean of `count` of them."""
    var = [
        scatter[p.effect].sd ** 2 / count if p.effect in scatter else 0.0
        for p in calibration.parameters
    ]
    return np.diag(np.array(var, np.float64))


def _words(
    scatter: Mapping[str, Scatter],
    given: Mapping[str, float],
    stated: Sequence[Mapping[str, Scatter]],
) -> str:
    if not scatter:
        return (
            "what a power-up changes is in no sd: a bias that differs may be another day's "
            "(--between-sessions)"
        )
    said = ", ".join(f"{s.sd:.3g} {FAMILIES[kind]} of {kind}" for kind, s in scatter.items())
    source = "as given" if given else "as the calibrations of several state"
    alone = sum(not one for one in stated)
    return f"power-ups scatter by {said}, {source}: in the sds of {alone} of one power-up"
