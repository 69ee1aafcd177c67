"""What the others say of a device that took no part in it: the search is made without the device.

Choosing an effect on all devices and leaving one out of its size only would flatter the held-out
error: the device that is predicted would have had a vote. A search costs no fit, since every device
keeps its products with all candidates, so it is made anew for each group that is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.cohort.fleet.pooled import Device, moderated, sizes
from imucalib.cohort.fleet.search import Rules, Search, search, told_to_each
from imucalib.core.prior import Prior, correlated

#: Groups that are left out at most, and simulated fleets of a search without one: enough for alpha.
_GROUPS, _DRAWS = 20, 199
#: Devices beyond which a fifth of them says no less than a twentieth would.
_MANY, _OF_MANY = 60, 5


@dataclass(frozen=True)
class Said:
    """What a fleet says. search : what it found; told : of each device what the others say of it;
    inner : the same where the others have found it too, empty where that was not asked; following :
    of the next device; all in typical sizes"""

    search: Search
    told: Mapping[str, Mapping[str, Prior]]
    inner: Mapping[str, Mapping[str, Prior]]
    following: Mapping[str, Prior]


def said_by(
    own: Sequence[Device], rules: Rules, seed: int, say: Callable[[str], None], *, without: bool
) -> Said:
    """Search a fleet. own : with their own noise; without : whether also without each device"""
    devices = moderated(own)
    found = search(devices, rules, np.random.default_rng(seed))
    for one in found.found:
        say(f"{one.effect}: in {len(one.able)} devices, p {one.pooled.p:.2g}")
    return Said(
        search=found,
        told=told_to_each(devices, found),
        inner=foretold(own, rules, seed) if found.found and without else {},
        following={one.effect: next_size(devices, one.effect) for one in found.found},
    )


def foretold(devices: Sequence[Device], rules: Rules, seed: int) -> dict[str, Mapping[str, Prior]]:
    """Of each device the effects that the others find, with what these say of its sizes (typical).

    devices : with their own noise, not drawn towards the fleet's, which the one left out would tell
    """
    groups = min(len(devices), _GROUPS if len(devices) <= _MANY else _OF_MANY)
    few = replace(rules, draws=min(rules.draws, _DRAWS))
    every: dict[str, Mapping[str, Prior]] = {}
    for group in range(groups):
        rest = moderated([d for k, d in enumerate(devices) if k % groups != group])
        found = search(rest, few, np.random.default_rng((seed, group))).found
        said = {one.effect: next_size(rest, one.effect) for one in found}
        for device in devices[group::groups]:
            every[device.name] = {n: one for n, one in said.items() if n in device.columns}
    return every


def next_size(devices: Sequence[Device], effect: str) -> Prior:
    """Of an effect's size in another device of the kind, in typical sizes."""
    able = [(d, d.columns[effect]) for d in devices if effect in d.columns]
    gram = np.stack([d.gram[np.ix_(at, at)] for d, at in able])
    along = np.stack([d.along[at] for d, at in able])
    found = sizes(gram, along)
    spread = found.common_covariance + found.scatter**2 * np.eye(len(found.common))
    return correlated(found.common, spread)
