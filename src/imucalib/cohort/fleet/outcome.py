"""A finished fleet: what its devices share, what each is by itself, what the next one will be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.calibration.comparison.agreement import ExcessScatter, beyond, excess
from imucalib.calibration.provenance import Provenance
from imucalib.calibrators.population import Population, PriorNoise, PriorParameter
from imucalib.cohort.fleet.pooled import moderated_axes, of_a_kind
from imucalib.cohort.fleet.search import Priors, Search
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.effects import named
from imucalib.loop.held_out import Difference

#: Devices from which on there is a scatter to speak of.
FEWEST = 4
#: Least doubt about the log of a noise, and the share of the usual below which one has vanished.
_SURE, _VANISHED = 0.05, 0.1
#: Family-wise chance of an outlying device where none is, and devices from which on one is named.
_ALPHA, _FEWEST = 0.01, 5
#: Share of the devices' own variance below which a scatter cannot be known from none.
_LEAST = 0.1
#: Sizes of a noise (devices,) and their relative standard deviations.
Sizes = tuple[Array, Array]


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
    sessions: ExcessScatter | None = None

    @property
    def interval(self) -> ExcessScatter:
        """The scatter between devices with its 95 % interval."""
        return beyond(self.values, self.sds**2)

    @property
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


def estimate_spread(name: str, unit: str, values: Array, sds: Array) -> Spread:
    """Of devices with one value each."""
    scatter = excess(values.size - 1.0, values, sds**2) ** 0.5
    weight = 1.0 / (sds**2 + scatter**2)
    mean = float(weight @ values / weight.sum())
    return Spread(
        name=name,
        unit=unit,
        mean=mean,
        mean_sd=float(weight.sum() ** -0.5),
        scatter=scatter,
        values=values,
        sds=sds,
    )


def nested_spread(name: str, unit: str, values: Array, sds: Array, device: Index) -> Spread:
    """Of recordings with one value each; device : (recordings,) 0 to devices - 1.

    A device's value is the mean of its recordings, whose scatter beyond their sds all devices tell
    together.
    """
    within = beyond(values, sds**2, np.eye(device.max() + 1)[device])
    if np.isnan(within.sd):
        return estimate_spread(name, unit, values, sds)
    weight = 1.0 / (sds**2 + within.sd**2)
    total = np.bincount(device, weight)
    own = np.bincount(device, weight * values) / total
    return replace(estimate_spread(name, unit, own, np.sqrt(1.0 / total)), sessions=within)


def shared_parameters(
    tables: Sequence[Sequence[StoredParameter]], pooled: Sequence[str], device: Index
) -> tuple[Spread, ...]:
    """Of every parameter that all recordings have, without effects whose sizes are pooled already:
    there each device's value leans on the others'. device : (recordings,) as of `nested_spread`"""
    by_name = [{p.name: p for p in own if p.effect not in pooled} for own in tables]
    shared = [p for name, p in by_name[0].items() if all(name in table for table in by_name)]
    return tuple(
        nested_spread(
            p.name,
            p.unit,
            np.array([table[p.name].value for table in by_name]),
            np.array([table[p.name].sd for table in by_name]),
            device,
        )
        for p in shared
    )


def outliers(devices: Sequence[str], spreads: Sequence[Spread]) -> tuple[Outlier, ...]:
    """Devices outside a normal population that the others make, by Student's t, worst first."""
    from scipy.special import stdtr

    count = len(devices)
    if count < _FEWEST:
        return ()
    kinds, found = of_a_kind([one.name for one in spreads]), list[Outlier]()
    for k, device in enumerate(devices):
        rest = np.arange(count) != k
        others = [estimate_spread(s.name, s.unit, s.values[rest], s.sds[rest]) for s in spreads]
        least = [_LEAST * float(np.mean(s.sds**2)) for s in others]
        variance = np.maximum([s.scatter**2 for s in others], least)
        better, freedom = moderated_axes(variance, count - 2.0, kinds)
        for one, own, square, dof in zip(spreads, others, better, freedom, strict=True):
            weight = 1.0 / (own.sds**2 + square)
            mean = float(weight @ own.values / weight.sum())
            value, sd = float(one.values[k]), float(one.sds[k])
            t = abs(value - mean) / float(np.sqrt(square + 1.0 / weight.sum() + sd**2))
            p = min(1.0, 2.0 * float(stdtr(dof, -t)) * count * len(spreads))
            if p <= _ALPHA:
                row = {"value": value, "sd": sd, "mean": mean, "scatter": float(square**0.5)}
                found.append(Outlier(device, one.name, unit=one.unit, p=p, **row))
    return tuple(sorted(found, key=lambda o: o.p))


def population_of(
    base: Sequence[Spread],
    effects: Priors,
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
    every = [PriorParameter(one.name, one.unit, one.mean, one.next_sd) for one in base]
    blocks = [np.array([[one.sd**2]]) for one in every]
    for name, prior in effects.items():
        parameters = named(name).parameters(context)
        typical = np.array([p.typical for p in parameters])
        own = grown(count) * prior.covariance * np.outer(typical, typical)
        blocks.append(own)
        every += [
            PriorParameter(p.name, p.unit, float(m * p.typical), float(np.sqrt(v)))
            for p, m, v in zip(parameters, prior.mean, np.diag(own), strict=True)
        ]
    return Population(
        devices=count,
        reference=reference,
        effects=tuple(effects),
        parameters=tuple(every),
        covariance=np.asarray(block_diag(*blocks)),
        noise=tuple(_noise(name, *sizes) for name, sizes in noise.items()),
    )


def noise_of(fits: Sequence[Fit]) -> dict[str, Sizes]:
    """Of fits of devices: the readings', and each component that all of them have."""
    reading = np.array([f.noise.factor * float(np.median(f.observations.sigma)) for f in fits])
    every = {"reading": (reading, np.array([f.noise_sd[0] for f in fits]))}
    for name in fits[0].noise.component:
        own = [(f, f.noise.component.index(name)) for f in fits if name in f.noise.component]
        sizes = np.array([f.noise.sd[k] for f, k in own])
        if len(own) == len(fits) and np.any(sizes > 0.0):
            every[name] = sizes, np.array([f.noise_sd[1 + k] for f, k in own])
    return every


def _noise(name: str, sizes: Array, sds: Array) -> PriorNoise:
    """A noise that vanished in a device was at most a tenth of the usual, and that is unsure."""
    least = _VANISHED * float(np.median(sizes[sizes > 0.0]))
    gone = sizes < least
    logs = np.log(np.maximum(sizes, least))
    one = estimate_spread(name, "log", logs, np.where(gone, 1.0, np.maximum(sds, _SURE)))
    return PriorNoise(name, float(np.exp(one.mean)), max(one.next_sd, _SURE))


@dataclass(frozen=True)
class DeviceRecording:
    """One recording of a device. calibration : with the fleet's effects, or None where its file
    was not at hand; kept : why the fleet's effects are not in it, or empty"""

    name: str
    provenance: Provenance
    calibration: Calibration | None
    kept: str = ""


@dataclass(frozen=True)
class FleetMember:
    """A device of the fleet. base, final : error without and with what the others say, mg, NaN
    where not computed; found_by_others : effects that these find without it, behind `final`"""

    name: str
    recordings: tuple[DeviceRecording, ...]
    base: float
    final: float
    found_by_others: tuple[str, ...] = ()


@dataclass(frozen=True)
class Settings:
    """calibrator : of every device; command : that was typed; stated : as provenance has them"""

    calibrator: str
    command: str
    stated: Mapping[str, object]


@dataclass(frozen=True)
class Fleet:
    """members : in the order given; failed : file -> why it is no member; search : None where no
    recording holds what a search needs
    difference : held-out error over all members, mg, None where nothing was found
    following : what it says of the next device, None for fewer than four
    notes : what else a reader must know"""

    members: tuple[FleetMember, ...]
    failed: tuple[tuple[str, str], ...]
    search: Search | None
    spreads: tuple[Spread, ...]
    outliers: tuple[Outlier, ...]
    difference: Difference | None
    settings: Settings
    following: Population | None = None
    notes: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """ "explained", "suspected", "unexplained", "nothing found" or "not searched"."""
        if self.search is None:
            return "not searched"
        if not self.search.found:
            return "unexplained" if self.search.refused else "nothing found"
        proved = self.difference is not None and self.difference.proved
        return "explained" if proved else "suspected"

    @property
    def exit_code(self) -> int:
        """5 where something is left open: a suspicion, an outlying device, a file that failed."""
        open_ = self.verdict in ("suspected", "unexplained") or self.outliers or self.failed
        return 5 if open_ else 0
