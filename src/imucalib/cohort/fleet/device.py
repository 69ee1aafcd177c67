"""One device of a fleet: what every candidate effect would explain beside its base model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.cohort.fleet.axes_alike import inverse_trigamma
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.loop.candidates import effect_candidates
from imucalib.loop.thresholds import ABSORBED

#: λ of a candidate at typical size below which it is rounding.
_SHOWN = 1e-6
#: Devices from which on their noise is compared, and degrees of freedom that stand for all alike.
_MODERATED, _ALL_ALIKE = 3, 1e4


@dataclass(frozen=True)
class Device:
    """A device as the pooled search sees it.

    noise : size of its noise, in a unit that all devices share; dof : its degrees of freedom, and
        borrowed : how many the fleet adds
    columns : effect -> (k,) where its parameters stand in `gram`
    gram : (m, m) products of all candidates' columns in units of the noise, at typical sizes, with
        the base model's parameters taken out; along : (m,) their products with the residual
    """

    name: str
    noise: float
    columns: Mapping[str, Index]
    gram: Array
    along: Array
    dof: float
    borrowed: float = 0.0


def device_of(name: str, fit: Fit, effects: Mapping[str, Effect]) -> Device:
    """All effects that the data can carry and the base model does not absorb."""
    candidates, _ = effect_candidates(fit, effects.values())
    white, q = fit.white_basis()
    residual = white(fit.at.residual) / fit.noise.factor
    kept, columns, at = list[Array](), dict[str, Index](), 0
    for candidate in candidates:
        whole = white(candidate.columns) / fit.noise.factor
        rest = whole - q @ (q.T @ whole)
        left = float(np.linalg.norm(rest))
        if left < ABSORBED * float(np.linalg.norm(whole)) or left < _SHOWN:
            continue
        columns[candidate.name] = np.arange(at, at + rest.shape[1])
        kept.append(rest)
        at += rest.shape[1]
    every = np.column_stack(kept) if kept else np.zeros((residual.size, 0))
    return Device(
        name, fit.noise.factor, columns, every.T @ every, every.T @ residual, float(fit.dof)
    )


def moderated(devices: Sequence[Device]) -> tuple[Device, ...]:
    """With each device's noise drawn towards the fleet's, as far as the devices agree.

    Variances scatter between devices like a scaled inverse χ², whose size s₀² and degrees of
    freedom ν₀ the logs of the estimates tell: s² = (ν₀ s₀² + ν s_d²) / (ν₀ + ν), with ν₀ + ν of
    them (Smyth 2004, section 6.2).
    """
    from scipy.special import polygamma, psi

    if len(devices) < _MODERATED:
        return tuple(devices)
    dof = np.array([d.dof for d in devices])
    square = np.array([d.noise**2 for d in devices])
    own = np.log(square) - psi(dof / 2.0) + np.log(dof / 2.0)
    spread = float(np.var(own, ddof=1) - np.mean(polygamma(1, dof / 2.0)))
    if spread > 0.0:
        fleet = 2.0 * inverse_trigamma(spread)
        size = np.exp(own.mean() + psi(fleet / 2.0) - np.log(fleet / 2.0))
    else:
        fleet, size = _ALL_ALIKE, float(np.sum(dof * square) / np.sum(dof))
    better = (fleet * size + dof * square) / (fleet + dof)
    return tuple(
        replace(d, gram=d.gram * share, along=d.along * share, borrowed=float(fleet))
        for d, share in zip(devices, square / better, strict=True)
    )
