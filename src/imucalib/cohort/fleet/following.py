"""What a fleet says of the next device of its kind: parameters, shared effects, noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.population import Population, Told, ToldNoise
from imucalib.cohort.fleet.spread import Spread, grown, spread_of
from imucalib.core.context import Context
from imucalib.core.fit import Fit
from imucalib.core.prior import Prior
from imucalib.effects import named

#: Devices from which on there is a scatter to speak of.
FEWEST = 4
#: Least doubt about the log of a noise, and the share of the usual below which one has vanished.
_SURE, _VANISHED = 0.05, 0.1
#: Sizes of a noise (devices,) and their relative standard deviations.
Sizes = tuple[Array, Array]


def population_of(
    base: Sequence[Spread],
    effects: Mapping[str, Prior],
    noise: Mapping[str, Sizes],
    context: Context,
    reference: str,
) -> Population | None:
    """None for fewer than four devices.

    base : of the base model's parameters, in order; effects : that the fleet shares, with the size
    of the next device in typical sizes; noise : "reading" (m/s²), and each component's (rad)
    context : that names the effects' parameters
    """
    from scipy.linalg import block_diag

    count = len(base[0].values)
    if count < FEWEST:
        return None
    told = [Told(one.name, one.unit, one.mean, one.next_sd()) for one in base]
    blocks = [np.array([[one.sd**2]]) for one in told]
    for name, prior in effects.items():
        parameters = named(name).parameters(context)
        typical = np.array([p.typical for p in parameters])
        own = grown(count) * prior.covariance * np.outer(typical, typical)
        blocks.append(own)
        told += [
            Told(p.name, p.unit, float(m * p.typical), float(np.sqrt(v)))
            for p, m, v in zip(parameters, prior.mean, np.diag(own), strict=True)
        ]
    return Population(
        devices=count,
        reference=reference,
        effects=tuple(effects),
        parameters=tuple(told),
        covariance=np.asarray(block_diag(*blocks)),
        noise=tuple(_told(name, *sizes) for name, sizes in noise.items()),
    )


def noise_of(fits: Sequence[Fit]) -> dict[str, Sizes]:
    """Of fits of devices: the readings', and each component that all of them have."""
    reading = np.array([f.noise.factor * float(np.median(f.observations.sigma)) for f in fits])
    every = {"reading": (reading, np.array([f.noise_sd[0] for f in fits]))}
    for name in fits[0].noise.component:
        own = [f.noise.component.index(name) for f in fits if name in f.noise.component]
        if len(own) < len(fits):
            continue
        sizes = np.array([f.noise.sd[k] for f, k in zip(fits, own, strict=True)])
        if np.any(sizes > 0.0):
            sds = np.array([f.noise_sd[1 + k] for f, k in zip(fits, own, strict=True)])
            every[name] = (sizes, sds)
    return every


def _told(name: str, sizes: Array, sds: Array) -> ToldNoise:
    """A noise that vanished in a device was at most a tenth of the usual, and that is unsure."""
    least = _VANISHED * float(np.median(sizes[sizes > 0.0]))
    gone = sizes < least
    logs = np.log(np.maximum(sizes, least))
    one = spread_of(name, "log", logs, np.where(gone, 1.0, np.maximum(sds, _SURE)))
    return ToldNoise(name, float(np.exp(one.mean)), max(one.next_sd(), _SURE))
