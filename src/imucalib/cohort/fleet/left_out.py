"""What the others say of a device that took no part in it: the search is made without the device.

Choosing an effect on all devices and leaving one out of its size only would flatter the held-out
error: the device that is predicted would have had a vote. A search costs no fit, since every device
keeps its products with all candidates, so it is made anew for each group that is left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.cohort.fleet.device import Device, moderated
from imucalib.cohort.fleet.pooled import sizes
from imucalib.cohort.fleet.search import Rules, search
from imucalib.cohort.fleet.shrunk import Prior
from imucalib.core.effect import Effect

#: Groups that are left out at most, and simulated fleets of a search without one: enough for alpha.
_GROUPS, _DRAWS = 20, 199


def foretold(
    devices: Sequence[Device], effects: Mapping[str, Effect], rules: Rules, seed: int
) -> dict[str, list[Prior]]:
    """Of each device the effects that the others find, at the sizes that these say.

    devices : with their own noise, not drawn towards the fleet's, which the one left out would tell
    """
    groups = min(len(devices), _GROUPS)
    few = replace(rules, draws=min(rules.draws, _DRAWS))
    every: dict[str, list[Prior]] = {device.name: [] for device in devices}
    for group in range(groups):
        rest = moderated([d for k, d in enumerate(devices) if k % groups != group])
        found = search(rest, few, np.random.default_rng((seed, group))).found
        said = {one.effect: next_size(rest, one.effect) for one in found}
        for device in devices[group::groups]:
            every[device.name] = [
                Prior(effects[name], *said[name]) for name in said if name in device.columns
            ]
    return every


def next_size(devices: Sequence[Device], effect: str) -> tuple[Array, Array]:
    """Mean (k,) and covariance (k, k), typical sizes, of the size in another device of a kind."""
    able = [(d, d.columns[effect]) for d in devices if effect in d.columns]
    gram = np.stack([d.gram[np.ix_(at, at)] for d, at in able])
    along = np.stack([d.along[at] for d, at in able])
    found = sizes(gram, along)
    spread = found.common_covariance + found.scatter**2 * np.eye(len(found.common))
    return found.common, spread
