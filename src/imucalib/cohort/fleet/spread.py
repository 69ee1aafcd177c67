"""How devices differ: the scatter of every parameter between them, and who is not of the kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array

#: Family-wise chance of an outlying device where none is, and devices from which on one is told.
_ALPHA, _FEWEST = 0.01, 5


@dataclass(frozen=True)
class Spread:
    """A parameter over a fleet: mean ± sd of the mean, and the scatter between devices, in `unit`;
    values, sds : (devices,)"""

    name: str
    unit: str
    mean: float
    mean_sd: float
    scatter: float
    values: Array
    sds: Array


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
    """Scatter by Paule and Mandel (1982): where the weighted squares equal their freedom."""
    from scipy.optimize import brentq

    def excess(tau: float) -> float:
        weight = 1.0 / (sds**2 + tau**2)
        mean = float(weight @ values / weight.sum())
        return float(weight @ (values - mean) ** 2) - (len(values) - 1)

    top = 10.0 * float(np.ptp(values)) + float(sds.max())
    scatter = float(brentq(excess, 0.0, top)) if excess(0.0) > 0.0 else 0.0
    weight = 1.0 / (sds**2 + scatter**2)
    mean = float(weight @ values / weight.sum())
    return Spread(
        name=name, unit=unit, mean=mean, mean_sd=float(weight.sum() ** -0.5), scatter=scatter,
        values=values, sds=sds,
    )  # fmt: skip


def outliers(devices: Sequence[str], spreads: Sequence[Spread]) -> tuple[Outlier, ...]:
    """Devices beside a normal population that the others make, by Student's t, worst first."""
    from scipy.special import stdtr

    count = len(devices)
    if count < _FEWEST:
        return ()
    found = []
    for one in spreads:
        for k in range(count):
            rest = np.arange(count) != k
            others = spread_of(one.name, one.unit, one.values[rest], one.sds[rest])
            var = others.scatter**2 + others.mean_sd**2 + one.sds[k] ** 2
            t = abs(one.values[k] - others.mean) / float(np.sqrt(var))
            p = min(1.0, 2.0 * float(stdtr(count - 2, -t)) * count * len(spreads))
            if p <= _ALPHA:
                found.append(
                    Outlier(
                        devices[k],
                        one.name,
                        float(one.values[k]),
                        float(one.sds[k]),
                        one.unit,
                        mean=others.mean,
                        scatter=others.scatter,
                        p=p,
                    )
                )
    return tuple(sorted(found, key=lambda o: o.p))
