"""A finished fleet: what its devices share, what each is by itself, what the next one will be."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.comparison.agreement import kind_of
from imucalib.calibration.triads import Triad
from imucalib.calibrators.population import Population, PriorNoise, PriorParameter
from imucalib.cohort.fleet.search import FleetEffect, Priors, Search
from imucalib.core.effect import Context
from imucalib.core.fit import Fit, StoredParameter
from imucalib.effects import named
from imucalib.errors import UnreadableInput
from imucalib.estimators.power_ups import ExcessScatter, estimate_excess, predict_next
from imucalib.posterior.closed_loop.sums import Sums
from imucalib.posterior.held_out import Difference
from imucalib.units import MG

#: Devices from which on there is a scatter to speak of.
FEWEST = 4
#: Least doubt about the log of a noise, and the share of the usual below which one has vanished.
_SURE, _VANISHED = 0.05, 0.1
#: Family-wise chance of an outlying device where none is, and devices from which on one is named.
_ALPHA, _FEWEST = 0.01, 5
#: Sizes of a noise (devices,) and their relative standard deviations.
Sizes = tuple[Array, Array]


@dataclass(frozen=True)
class DeviceRecording:
    """One recording of a device, calibrated.

    name : short, of its own in a fleet; calibration : at last with the fleet's effects
    path : of the recording as far as it is known; device : as it names it, or empty
    sums : what it says of every effect, or None; kept : why the fleet's are not in it, or empty
    """

    name: str
    calibration: Calibration
    path: str = ""
    device: str = ""
    sums: Sums | None = None
    kept: str = ""

    @property
    def provenance(self) -> Mapping[str, Any]:
        """As calibration.yaml has it."""
        return dict(self.calibration.facts["provenance"])

    @property
    def values(self) -> tuple[StoredParameter, ...]:
        """All parameters, fixture included; of an array also each IMU's gain and bias."""
        return (*self.calibration.parameters, *_of_imus(self.calibration.triads))


@dataclass(frozen=True)
class FleetMember:
    """A device of the fleet. base, final : error without and with what the others say, mg, NaN
    where not computed; found_by_others : effects that these find without it, behind `final`"""

    name: str
    recordings: tuple[DeviceRecording, ...]
    base: float
    final: float
    found_by_others: tuple[str, ...] = ()

    def folder_of(self, recording: DeviceRecording) -> str:
        """Where its calibration is written, below the fleet's folder."""
        return f"{self.name}/{recording.name}" if len(self.recordings) > 1 else self.name


@dataclass(frozen=True)
class Spread:
    """A parameter over a fleet: mean ± sd of the mean, and the scatter between devices in its 95 %
    interval, in `unit`; next_sd : of one recording of the next device, by all scatters that the
    devices allow; values, sds : (devices,); sessions : the scatter between recordings of a device,
    beyond what each one's sd explains, None where no device was recorded twice"""

    name: str
    unit: str
    mean: float
    mean_sd: float
    interval: ExcessScatter
    next_sd: float
    values: Array
    sds: Array
    sessions: ExcessScatter | None = None

    @property
    def scatter(self) -> float:
        """As likely larger as smaller."""
        return self.interval.sd


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


@dataclass(frozen=True)
class Fleet:
    """Devices of one kind.

    members : in the order given
    failed : file -> why it is no member
    search : what was found, None where no recording holds what a search needs
    spreads : of every parameter that all have
    outliers : who is not of the kind
    difference : held-out error over all members, mg, None where nothing was found
    calibrator : of every device; command : that was typed
    settings : as provenance has them
    following : what it says of the next device, None for fewer than four
    notes : what else a reader must know
    """

    members: tuple[FleetMember, ...]
    failed: tuple[tuple[str, str], ...]
    search: Search | None
    spreads: tuple[Spread, ...]
    outliers: tuple[Outlier, ...]
    difference: Difference | None
    calibrator: str
    command: str
    settings: Mapping[str, object]
    following: Population | None = None
    notes: tuple[str, ...] = ()

    @property
    def found(self) -> tuple[FleetEffect, ...]:
        """Effects that all devices share."""
        return self.search.found if self.search else ()

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


def _of_imus(triads: Sequence[Triad]) -> Iterator[StoredParameter]:
    """Gain and bias of every IMU of an array."""
    for triad in triads:
        sd = np.sqrt(np.maximum(np.diag(triad.covariance), 0.0)).tolist()
        for k, (i, j) in enumerate(np.ndindex(3, 3)):
            name, gain = f"{triad.name}.gain_{'xyz'[i]}{'xyz'[j]}", float(triad.gain[i, j])
            yield StoredParameter(name, "scale", "", gain, sd[k], "1")
        for k, axis in enumerate("xyz"):
            name, bias = f"{triad.name}.bias_{axis}", float(triad.bias[k]) / MG
            yield StoredParameter(name, "bias", "", bias, sd[9 + k] / MG, "mg")


def demand_new(one: DeviceRecording, known: dict[str, str], what: str) -> None:
    """Raise UnreadableInput for a table or recording that is there, by name, already: counted
    twice, it would agree with itself. known : sha256 -> name, to which it is added"""
    sha256 = one.provenance["sha256"]
    if sha256 in known:
        raise UnreadableInput(
            f"the same {what} as {known[sha256]}", remedy="give each device's once"
        )
    known[sha256] = one.name


def estimate_spreads(
    names: Sequence[str],
    units: Sequence[str],
    values: Array,
    sds: Array,
    sessions: Sequence[ExcessScatter | None],
) -> tuple[Spread, ...]:
    """Of parameters by name, whose values and sds are (devices, p); those of a kind, "bias_x" and
    "bias_y", scatter alike."""
    found = dict[int, Spread]()
    for kind in group_alike(names):
        said = predict_next(values[:, kind], sds[:, kind])
        ends = np.array([said.scatter(share) for share in (0.5, 0.025, 0.975)])
        for k, j in enumerate(kind):
            within = sessions[j]
            found[j] = Spread(
                name=names[j],
                unit=units[j],
                mean=float(said.mean[k]),
                mean_sd=float(said.mean_sd[k]),
                interval=ExcessScatter(*ends[:, k].tolist()),
                next_sd=float(np.hypot(said.sd[k], within.sd if within else 0.0)),
                values=values[:, j],
                sds=sds[:, j],
                sessions=within,
            )
    return tuple(found[j] for j in range(len(names)))


def average_devices(
    values: Array, sds: Array, device: Index
) -> tuple[Array, Array, ExcessScatter | None]:
    """A parameter's value and sd of each device: the mean of its recordings, whose scatter beyond
    their sds all devices tell together; None where no device has two.

    values, sds : (recordings,); device : (recordings,) 0 to devices - 1
    """
    within = estimate_excess(values, sds**2, np.eye(device.max() + 1)[device])
    if np.isnan(within.sd):
        return values, sds, None
    weight = 1.0 / (sds**2 + within.sd**2)
    total = np.bincount(device, weight)
    return np.bincount(device, weight * values) / total, np.sqrt(1.0 / total), within


def shared_parameters(members: Sequence[FleetMember], pooled: Sequence[str]) -> tuple[Spread, ...]:
    """Of every parameter that all recordings have, without effects whose sizes are pooled already:
    there each device's value leans on the others'."""
    device = np.repeat(np.arange(len(members)), [len(m.recordings) for m in members])
    tables = [r.values for m in members for r in m.recordings]
    by_name = [{p.name: p for p in own if p.effect not in pooled} for own in tables]
    shared = [p for name, p in by_name[0].items() if all(name in table for table in by_name)]
    if not shared:
        return ()
    every = [
        average_devices(
            np.array([table[p.name].value for table in by_name]),
            np.array([table[p.name].sd for table in by_name]),
            device,
        )
        for p in shared
    ]
    values, sds, sessions = zip(*every, strict=True)
    names, units = [p.name for p in shared], [p.unit for p in shared]
    return estimate_spreads(names, units, np.array(values).T, np.array(sds).T, sessions)


def outliers(devices: Sequence[str], spreads: Sequence[Spread]) -> tuple[Outlier, ...]:
    """Devices that the others do not foretell, worst first."""
    count = len(devices)
    if count < _FEWEST:
        return ()
    found = list[Outlier]()
    for kind in group_alike([one.name for one in spreads]):
        values, sds = (
            np.array([getattr(spreads[j], n) for j in kind]).T for n in ("values", "sds")
        )
        for k, device in enumerate(devices):
            rest = np.arange(count) != k
            others = predict_next(values[rest], sds[rest])
            scatter, chance = others.scatter(0.5), others.chance(values[k], sds[k])
            for i, j in enumerate(kind):
                p = min(1.0, float(chance[i]) * count * len(spreads))
                if p <= _ALPHA:
                    found.append(
                        Outlier(
                            device=device,
                            parameter=spreads[j].name,
                            value=float(values[k, i]),
                            sd=float(sds[k, i]),
                            unit=spreads[j].unit,
                            mean=float(others.mean[i]),
                            scatter=float(scatter[i]),
                            p=p,
                        )
                    )
    return tuple(sorted(found, key=lambda o: o.p))


def group_alike(names: Sequence[str]) -> list[list[int]]:
    """Numbers of the parameters that are alike: "bias_x" with "bias_y" and "bias_z"."""
    kinds = dict[str, list[int]]()
    for k, name in enumerate(names):
        kinds.setdefault(kind_of(name), []).append(k)
    return list(kinds.values())


def population_of(
    names: Sequence[str],
    spreads: Sequence[Spread],
    effects: Priors,
    noise: Mapping[str, Sizes],
    context: Context,
    reference: str,
) -> Population | None:
    """None for fewer than four devices, and where not all have every parameter of the base model.

    names : of the base model's parameters, in order; spreads : theirs, among others
    effects : that the fleet shares, with the size of the next device in typical sizes
    noise : "reading" (m/s²), and each component's (rad); context : that names effects' parameters
    reference : as of `lab`
    """
    from scipy.linalg import block_diag

    base = [one for name in names for one in spreads if one.name == name]
    count = len(base[0].values) if base else 0
    if len(base) < len(names) or count < FEWEST:
        return None
    every = [PriorParameter(one.name, one.unit, one.mean, one.next_sd) for one in base]
    blocks = [np.array([[one.sd**2]]) for one in every]
    for name, prior in effects.items():
        parameters = named(name).parameters(context)
        typical = np.array([p.typical for p in parameters])
        own = prior.covariance * np.outer(typical, typical)
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
    said = predict_next(logs[:, None], np.where(gone, 1.0, np.maximum(sds, _SURE))[:, None])
    return PriorNoise(name, float(np.exp(said.mean[0])), max(float(said.sd[0]), _SURE))
