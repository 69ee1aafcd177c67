"""What a fleet says of the next device of its kind: parameters, shared effects, noise.

Of few devices neither the middle nor the scatter is known well: the variance of the next one is the
scatter, the doubt about the mean, and Student's (K - 1) / (K - 3) for the doubt about the scatter.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.population import Population, Told, ToldNoise
from imucalib.cohort.fleet.spread import Spread, spread_of
from imucalib.core.fit import Fit
from imucalib.core.parameter import Parameter
from imucalib.effects import named

#: Devices from which on there is a scatter to speak of.
FEWEST = 4
#: Least doubt about the log of a noise, and the share of the usual below which one has vanished.
_SURE, _VANISHED = 0.05, 0.1


def population_of(
    fits: Sequence[Fit],
    spreads: Sequence[Spread],
    effects: Mapping[str, tuple[Array, Array]],
    reference: str,
) -> Population | None:
    """None for fewer than four devices.

    fits : of the base model, each device alone; spreads : of every parameter
    effects : of those that the fleet shares the size of the next device, mean (k,) and covariance
    (k, k), in typical sizes
    """
    count = len(fits)
    if count < FEWEST:
        return None
    grown = (count - 1.0) / (count - 3.0)
    base = fits[0].parameters
    by_name = {one.name: one for one in spreads}
    told, blocks = list[Told](), list[Array]()
    for p in base:
        one = by_name[p.name]
        variance = grown * (one.scatter**2 + one.mean_sd**2)
        told.append(Told(p.name, one.unit, one.mean, float(np.sqrt(variance))))
        blocks.append(np.array([[variance]]))
    for mean, covariance, parameters in _shared(fits[0], effects):
        typical = np.array([p.typical for p in parameters])
        own = grown * covariance * np.outer(typical, typical)
        blocks.append(own)
        told += [
            Told(p.name, p.unit, float(m * p.typical), float(np.sqrt(v)))
            for p, m, v in zip(parameters, mean, np.diag(own), strict=True)
        ]
    return Population(
        devices=count,
        reference=reference,
        effects=tuple(effects),
        parameters=tuple(told),
        covariance=_joined(blocks),
        noise=_noise(fits, grown),
    )


def _shared(
    fit: Fit, effects: Mapping[str, tuple[Array, Array]]
) -> Iterator[tuple[Array, Array, tuple[Parameter, ...]]]:
    for name, (mean, covariance) in effects.items():
        yield mean, covariance, named(name).parameters(fit.observations.context)


def _joined(blocks: Sequence[Array]) -> Array:
    from scipy.linalg import block_diag

    return np.asarray(block_diag(*blocks))


def _noise(fits: Sequence[Fit], grown: float) -> tuple[ToldNoise, ...]:
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
    return tuple(_told(name, *values, grown) for name, values in every.items())


def _told(name: str, sizes: Array, sds: Array, grown: float) -> ToldNoise:
    """A noise that vanished in a device was at most a tenth of the usual, and that is unsure."""
    least = _VANISHED * float(np.median(sizes[sizes > 0.0]))
    gone = sizes < least
    logs = np.log(np.maximum(sizes, least))
    one = spread_of(name, "log", logs, np.where(gone, 1.0, np.maximum(sds, _SURE)))
    doubt = np.sqrt(grown * (one.scatter**2 + one.mean_sd**2))
    return ToldNoise(name, float(np.exp(one.mean)), float(max(doubt, _SURE)))
