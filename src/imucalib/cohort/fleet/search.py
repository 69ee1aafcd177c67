"""The search of a fleet: effects that exist in all devices, each with its own size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.cohort.fleet.pooled import (
    Device,
    Pooled,
    Sizes,
    pooled,
    predictive,
    sizes,
    told_by_others,
)
from imucalib.core.prior import Prior, correlated
from imucalib.loop.posterior.odds import OCCAM

#: Families of devices beyond which a device is foretold by whole groups of the others.
_GROUPS = 20


@dataclass(frozen=True)
class Rules:
    """alpha : of a false effect anywhere in the fleet; most : effects; draws : of the null"""

    alpha: float = 0.04
    most: int = 3
    draws: int = 1000


@dataclass(frozen=True)
class Found:
    """An effect of the fleet. rivals : names that explain as much; nats : by which each device is
    foretold by the others' sizes; able : devices that can show it; sizes : theirs"""

    pooled: Pooled
    rivals: tuple[str, ...]
    nats: Array
    able: tuple[str, ...]
    sizes: Sizes

    @property
    def effect(self) -> str:
        return self.pooled.effect


@dataclass(frozen=True)
class Search:
    """found : in order; first : every effect before any was taken; refused : what stood out, and
    why it was not taken"""

    found: tuple[Found, ...]
    first: tuple[Pooled, ...]
    refused: tuple[tuple[str, str], ...]


def search(devices: Sequence[Device], rules: Rules, rng: np.random.Generator) -> Search:
    """Take what stands out and what each device confirms by what the others foretell."""
    now, found, refused = tuple(devices), list[Found](), dict[str, str]()
    first: tuple[Pooled, ...] = ()
    while True:
        scores = pooled(now, rng, rules.draws)
        first = first or scores
        left = [s for s in scores if s.effect not in refused]
        best = left[0] if left else None
        if best is None or best.p > rules.alpha or len(found) == rules.most:
            return Search(tuple(found), first, tuple(refused.items()))
        able, gram, along = _of(now, best.effect)
        nats = predictive_by_groups(gram, along)
        if nats.sum() <= 0.0:
            refused[best.effect] = f"the others foretell no device's: {nats.sum():+.1f} nats"
            continue
        said = sizes(gram, along)
        rivals = tuple(
            s.effect for s in left[1:] if s.p <= rules.alpha and s.evidence > best.evidence - OCCAM
        )
        found.append(Found(best, rivals, nats, able, said))
        now = tuple(_without(device, best.effect, said) for device in now)


def predictive_by_groups(gram: Array, along: Array) -> Array:
    """(devices,) as `predictive`; of many devices by groups that are left out together."""
    return predictive(gram, along, groups=min(len(gram), _GROUPS))


def told_to_each(devices: Sequence[Device], found: Search) -> dict[str, dict[str, Prior]]:
    """Of each device what the others say of the effects that were found, in typical sizes."""
    every: dict[str, dict[str, Prior]] = {device.name: {} for device in devices}
    for one in found.found:
        able, gram, along = _of(devices, one.effect)
        told = told_by_others(gram, along, min(len(able), _GROUPS))
        for name, said in zip(able, told, strict=True):
            every[name][one.effect] = correlated(*said)
    return every


def _of(devices: Sequence[Device], effect: str) -> tuple[tuple[str, ...], Array, Array]:
    able = [d for d in devices if effect in d.columns]
    at = [d.columns[effect] for d in able]
    gram = np.stack([d.gram[np.ix_(k, k)] for d, k in zip(able, at, strict=True)])
    along = np.stack([d.along[k] for d, k in zip(able, at, strict=True)])
    return tuple(d.name for d in able), gram, along


def _without(device: Device, effect: str, said: Sizes) -> Device:
    """A device with an effect taken out, whose size is N(μ, τ²) before its data are seen."""
    if effect not in device.columns:
        return device
    k = device.columns[effect]
    across, own = device.gram[:, k], device.gram[np.ix_(k, k)]
    shrunk = said.scatter**2 * np.linalg.inv(np.eye(len(k)) + said.scatter**2 * own)
    away = device.along[k] - own @ said.common
    along = device.along - across @ (said.common + shrunk @ away)
    columns = {name: at for name, at in device.columns.items() if name != effect}
    return replace(
        device, columns=columns, gram=device.gram - across @ shrunk @ across.T, along=along
    )
