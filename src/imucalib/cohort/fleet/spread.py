"""How devices differ: the scatter of every parameter between them, and who is not of the kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.comparison.beyond import Beyond, beyond, beyond_sd
from imucalib.cohort.fleet.axes_alike import moderated_axes, of_a_kind

#: Family-wise chance of an outlying device where none is, and devices from which on one is told.
_ALPHA, _FEWEST = 0.01, 5
#: Share of the devices' own variance below which a scatter is not told from none.
_LEAST = 0.1


@dataclass(frozen=True)
class Spread:
    """A parameter over a fleet: mean ± sd of the mean, and the scatter between devices, in `unit`;
    values, sds : (devices,); sessions : the scatter between recordings of one device, beyond what
    each one's sd explains, None where no device was recorded twice"""

    name: str
    unit: str
    mean: float
    mean_sd: float
    scatter: float
    values: Array
    sds: Array
    sessions: Beyond | None = None

    @property
    def interval(self) -> Beyond:
        """The scatter between devices with its 95 % interval."""
        return beyond(self.values, self.sds**2)

    def next_sd(self) -> float:
        """Of one recording of the next device: the scatter between devices and between recordings,
        the doubt about the mean, and Student's (K - 1) / (K - 3) for that about the scatter."""
        count = len(self.values)
        within = 0.0 if self.sessions is None else self.sessions.sd
        whole = self.scatter**2 + within**2 + self.mean_sd**2
        return float(np.sqrt(grown(count) * whole))


def grown(devices: int) -> float:
    """By how much a variance that few devices tell falls short of the next one's, on average."""
    return (devices - 1.0) / (devices - 3.0)


@dataclass(frozen=True)
class Outlier:
    """A device whose parameter the others do not foretell. p : family-wise"""

    device: str
    parameter: str
    value: float
    sd: float
    unit: str
    mean: float
    scatter: float
    p: float


def spread_of(name: str, unit: str, values: Array, sds: Array) -> Spread:
    """Of devices with one value each."""
    scatter = beyond_sd(values, sds**2)
    weight = 1.0 / (sds**2 + scatter**2)
    mean = float(weight @ values / weight.sum())
    return Spread(
        name=name, unit=unit, mean=mean, mean_sd=float(weight.sum() ** -0.5), scatter=scatter,
        values=values, sds=sds,
    )  # fmt: skip


def nested_spread(name: str, unit: str, values: Array, sds: Array, device: Index) -> Spread:
    """Of recordings with one value each; device : (recordings,) 0 to devices - 1.

    A device's value is the mean of its recordings, whose scatter beyond their sds all devices tell
    together.
    """
    within = beyond(values, sds**2, device)
    if np.isnan(within.sd):
        return spread_of(name, unit, values, sds)
    weight = 1.0 / (sds**2 + within.sd**2)
    total = np.bincount(device, weight)
    own = np.bincount(device, weight * values) / total
    return replace(spread_of(name, unit, own, np.sqrt(1.0 / total)), sessions=within)


def outliers(devices: Sequence[str], spreads: Sequence[Spread]) -> tuple[Outlier, ...]:
    """Devices beside a normal population that the others make, by Student's t, worst first."""
    from scipy.special import stdtr

    count = len(devices)
    if count < _FEWEST:
        return ()
    kinds, found = of_a_kind([one.name for one in spreads]), list[Outlier]()
    for k in range(count):
        rest = np.arange(count) != k
        others = [spread_of(s.name, s.unit, s.values[rest], s.sds[rest]) for s in spreads]
        least = [_LEAST * float(np.mean(s.sds**2)) for s in others]
        variance = np.maximum([s.scatter**2 for s in others], least)
        better, freedom = moderated_axes(variance, count - 2.0, kinds)
        for one, own, square, dof in zip(spreads, others, better, freedom, strict=True):
            weight = 1.0 / (own.sds**2 + square)
            mean = float(weight @ own.values / weight.sum())
            sd = float(np.sqrt(square + 1.0 / weight.sum() + one.sds[k] ** 2))
            t = abs(one.values[k] - mean) / sd
            p = min(1.0, 2.0 * float(stdtr(dof, -t)) * count * len(spreads))
            if p <= _ALPHA:
                found.append(
                    Outlier(
                        devices[k], one.name, float(one.values[k]), float(one.sds[k]), one.unit,
                        mean=mean, scatter=float(square**0.5), p=p,
                    )
                )  # fmt: skip
    return tuple(sorted(found, key=lambda o: o.p))
