"""The search of a fleet: effects that exist in all devices, each with its own size; and what the
others say of a device that took no part in it.

Choosing an effect on all devices and leaving one out of its size only would flatter the held-out
error: the device that is predicted would have had a vote. A search costs no fit, since every device
keeps its products with all candidates, so it is made anew for each group that is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.cohort.fleet.pooled import (
    GROUPS,
    PooledDevice,
    PooledEffect,
    Sizes,
    by_others,
    gain_from_others,
    pool_effects,
    products,
    shrink_noise,
    sizes,
)
from imucalib.core.prior import Prior, joint_prior
from imucalib.posterior.odds import DEEPEST, FALSE_CLAIM, OCCAM

#: Devices beyond which a fifth of them says no less than a twentieth would.
_MANY, _OF_MANY = 60, 5


@dataclass(frozen=True)
class FleetEffect:
    """An effect of the fleet. rivals : names that explain as much; nats : that each device's data
    gain by the others' sizes; able : devices that can show it; sizes : theirs"""

    pooled: PooledEffect
    rivals: tuple[str, ...]
    nats: Array
    able: tuple[str, ...]
    sizes: Sizes

    @property
    def effect(self) -> str:
        return self.pooled.effect


#: Effect -> its sizes, in typical sizes.
Priors = Mapping[str, Prior]


@dataclass(frozen=True)
class Search:
    """What the devices of a fleet share.

    found : in order
    first : every effect before any was accepted
    refused : what stood out, and why it was not accepted
    by_others : of each device what the others say of the effects
    unseen : the same where the others have found them too, empty where that was not wanted
    following : what is said of the next device
    """

    found: tuple[FleetEffect, ...]
    first: tuple[PooledEffect, ...]
    refused: tuple[tuple[str, str], ...]
    by_others: Mapping[str, Priors] = field(default_factory=dict)
    unseen: Mapping[str, Priors] = field(default_factory=dict)
    following: Priors = field(default_factory=dict)


def search_fleet(
    own: Sequence[PooledDevice], say: Callable[[str], None], *, without: bool
) -> Search:
    """Search a fleet. own : with their own noise; without : whether also without each device"""
    devices = shrink_noise(own)
    found = search(devices)
    by_device: dict[str, dict[str, Prior]] = {device.name: {} for device in devices}
    for one in found.found:
        say(f"{one.effect}: in {len(one.able)} devices, {100.0 * one.pooled.probability:.0f} %")
        able, gram, along = products(devices, one.effect)
        for name, said in zip(able, by_others(gram, along), strict=True):
            by_device[name][one.effect] = joint_prior(*said)
    unseen = _drop_each(own) if found.found and without else {}
    following = _predict_another(devices, found)
    return replace(found, by_others=by_device, unseen=unseen, following=following)


def search(devices: Sequence[PooledDevice]) -> Search:
    """Accept the likeliest effect while silence would cost more than a false claim, and each device
    confirms it by what the others predict."""
    now, found, refused = tuple(devices), list[FleetEffect](), dict[str, str]()
    first: tuple[PooledEffect, ...] = ()
    while True:
        scores = pool_effects(now, missing=bool(found))
        first = first or scores
        there = sum(s.probability for s in scores)
        if FALSE_CLAIM * (1.0 - there) >= there or len(found) == DEEPEST:
            return Search(tuple(found), first, tuple(refused.items()))
        best = scores[0]
        able, gram, along = products(now, best.effect)
        nats = gain_from_others(gram, along)
        if nats.sum() <= 0.0:
            refused[best.effect] = f"the others foretell no device's: {nats.sum():+.1f} nats"
            now = tuple(replace(d, columns=_leave_out(d, best.effect)) for d in now)
            continue
        said = sizes(gram, along)
        rivals = tuple(s.effect for s in scores[1:] if s.evidence > best.evidence - OCCAM)
        found.append(FleetEffect(best, rivals, nats, able, said))
        now = tuple(_drop(device, best.effect, said) for device in now)


def _drop(device: PooledDevice, effect: str, said: Sizes) -> PooledDevice:
    """A device without an effect, whose size is N(μ, τ²) before its data are seen."""
    if effect not in device.columns:
        return device
    k = device.columns[effect]
    across, own = device.gram[:, k], device.gram[np.ix_(k, k)]
    shrunk = said.scatter**2 * np.linalg.inv(np.eye(len(k)) + said.scatter**2 * own)
    away = device.along[k] - own @ said.common
    along = device.along - across @ (said.common + shrunk @ away)
    gram = device.gram - across @ shrunk @ across.T
    return replace(device, columns=_leave_out(device, effect), gram=gram, along=along)


def _leave_out(device: PooledDevice, effect: str) -> dict[str, Index]:
    """Where the parameters of all other effects stand."""
    return {name: at for name, at in device.columns.items() if name != effect}


def _drop_each(devices: Sequence[PooledDevice]) -> dict[str, Priors]:
    """Of each device the effects that the others find, with what these say of its sizes.

    devices : with their own noise, not drawn towards the fleet's, which the one left out would
    tell
    """
    groups = min(len(devices), GROUPS if len(devices) <= _MANY else _OF_MANY)
    every: dict[str, Priors] = {}
    for group in range(groups):
        rest = shrink_noise([d for k, d in enumerate(devices) if k % groups != group])
        said = _predict_another(rest, search(rest))
        for device in devices[group::groups]:
            every[device.name] = {n: one for n, one in said.items() if n in device.columns}
    return every


def _predict_another(devices: Sequence[PooledDevice], found: Search) -> dict[str, Prior]:
    """The sizes in another device of the kind of the effects that were found in these."""
    return {
        one.effect: joint_prior(*sizes(*products(devices, one.effect)[1:]).another)
        for one in found.found
    }
