"""From finished calibrations to a fleet: what the devices share, and how they differ."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.population import Population
from imucalib.cohort.fleet.calibrated import Calibrated, load_calibrations
from imucalib.cohort.fleet.outcome import (
    DeviceRecording,
    Fleet,
    FleetMember,
    Spread,
    outliers,
    population_of,
    shared_parameters,
)
from imucalib.cohort.fleet.pooled import PooledDevice, evidence_of_sizes
from imucalib.cohort.fleet.search import Priors, Search, search_fleet
from imucalib.core.effect import Context
from imucalib.core.fit import StoredParameter
from imucalib.effects import named
from imucalib.errors import UnreadableInput, UsageError
from imucalib.file_hash import sha256_of
from imucalib.posterior.candidates import effects_to_search
from imucalib.posterior.closed_loop.sums import Sums, columns_of
from imucalib.posterior.held_out import Difference, add_density, difference
from imucalib.units import MG

#: sd of an effect that a recording has by itself, in typical sizes: its own data decide.
_OWN = 10.0
#: Headings of the two columns, the first that is there: `imucal collect` writes the last ones.
_RECORDING, _DEVICE = ("recording", "path"), ("device", "serial")
#: Status of a calibration that rests on a prior as much as on its postures.
_WEAK = "weak"


def device_of(name: str, recordings: Sequence[Sums], wanted: Sequence[str]) -> PooledDevice:
    """A device whose recordings share the sizes of effects, each with a base model of its own."""
    names = [e for e in wanted if any(e in one.blocks for one in recordings)]
    width = {e: next(one.blocks[e].size for one in recordings if e in one.blocks) for e in names}
    ends = np.cumsum([0, *width.values()])
    columns: dict[str, Index] = {
        e: np.arange(a, b) for e, a, b in zip(names, ends, ends[1:], strict=False)
    }
    gram, along = np.zeros((ends[-1], ends[-1])), np.zeros(ends[-1])
    for one in recordings:
        has = [e for e in names if e in one.blocks]
        own, at = columns_of(one.blocks, has), columns_of(columns, has)
        gram[np.ix_(at, at)] += one.gram[np.ix_(own, own)]
        along[at] += one.along[own]
    dof = np.array([one.dof for one in recordings])
    square = np.array([one.noise**2 for one in recordings])
    noise = float(np.sqrt(dof @ square / dof.sum()))
    return PooledDevice(name, noise, columns, gram, along, float(dof.sum()))


def predict_noise(device: PooledDevice, said: Priors) -> tuple[float, float]:
    """A device's noise (mg) with effects at the sizes that others say, and the nats that its data
    gain: what effects of a given size explain is known exactly, |y - Xθ|² = |y|² - 2 aᵀθ + θᵀGθ."""
    from scipy.linalg import block_diag

    at = columns_of(device.columns, list(said))
    size = np.concatenate([np.zeros(0), *(one.mean for one in said.values())])
    gram, along = device.gram[np.ix_(at, at)], device.along[at]
    less = (2.0 * along @ size - size @ gram @ size) / device.dof
    error = device.noise * float(np.sqrt(max(1.0 - less, 0.0)))
    spread = block_diag(*(one.covariance for one in said.values())) if said else np.zeros((0, 0))
    return error, evidence_of_sizes(gram, along, size, np.asarray(spread))


def _sizes(
    device: PooledDevice, said: Priors, own: Sequence[str]
) -> tuple[list[str], Array, Array]:
    """A device's effects, with mean (k,) and covariance (k, k) of their sizes (typical) by its own
    data and what the others say. own : effects of this device alone, of which nobody says anything
    """
    names = [*said, *(e for e in own if e not in said)]
    at = columns_of(device.columns, names)
    precision, towards, start = device.gram[np.ix_(at, at)], device.along[at], 0
    for name in names:
        part = slice(start, start + device.columns[name].size)
        start = part.stop
        if name in said:
            prior = said[name].root.T @ said[name].root
            precision[part, part] += prior
            towards[part] += prior @ said[name].mean
        else:
            precision[part, part] += np.eye(part.stop - part.start) / _OWN**2
    covariance = np.asarray(np.linalg.inv(precision), np.float64)
    return names, covariance @ towards, covariance


def _recording(
    one: Calibrated, device: PooledDevice | None, said: Priors
) -> tuple[DeviceRecording, tuple[StoredParameter, ...]]:
    """With its device's effects; as it is where the fleet has nothing for it, or where it has what
    the fleet cannot keep."""
    if one.sums is None or device is None or not said:
        return DeviceRecording(one.name, one.provenance, one.calibration), one.values
    base = one.sums.base
    # Effects that the recording's own search has added to the base model.
    own = list(dict.fromkeys(v.effect for v in one.values if v.name not in set(base.parameters)))
    if lost := [name for name in own if name not in one.sums.blocks]:
        kept = f"it has {', '.join(lost)} of its own"
        return DeviceRecording(one.name, one.provenance, one.calibration, kept), one.values
    names, mean, covariance = _sizes(device, said, own)
    able = [name for name in names if name in one.sums.blocks]
    at = np.flatnonzero(np.isin(np.repeat(names, [device.columns[n].size for n in names]), able))
    # One Gauss-Newton step from the base model: second order is the base's share of an effect.
    theta, whole = one.sums.together(able, mean[at], covariance[np.ix_(at, at)])
    new = [(named(name), p) for name in able for p in named(name).parameters(Context(1))]
    scale = np.concatenate([np.ones(base.theta.size), [p.typical for _, p in new]])
    theta, whole = theta * scale, whole * np.outer(scale, scale)
    known = {v.name: v for v in one.values}
    kinds = [(known[n].effect, known[n].stage, known[n].unit) for n in base.parameters]
    kinds += [(effect.name, effect.stage, p.unit) for effect, p in new]
    parameters = [*base.parameters, *(p.name for _, p in new)]
    stored = tuple(
        StoredParameter(name, effect, stage, float(value), float(sd), unit)
        for name, (effect, stage, unit), value, sd in zip(
            parameters, kinds, theta, np.sqrt(np.diag(whole)), strict=True
        )
    )
    # Its errors stay those of the recording alone, and it says so.
    facts = {"effects": able, "errors": "of the recording calibrated alone"}
    made = replace(
        one.calibration,
        parameters=stored,
        covariance=whole,
        facts={**one.calibration.facts, "fleet": facts},
        sha256="",
    )
    return DeviceRecording(one.name, one.provenance, made), stored


def read_devices(path: Path) -> dict[str, str]:
    """Recording -> device. Raises UnreadableInput for what is no such table."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UnreadableInput(f"cannot be read: {error}", where=str(path)) from None
    heading = list(rows[0]) if rows else []
    picked = [next((n for n in names if n in heading), None) for names in (_RECORDING, _DEVICE)]
    if None in picked:
        raise UnreadableInput(
            "it says of no recording which device made it",
            where=str(path),
            remedy="a CSV with the columns recording and device, as `imucal collect` writes it "
            "with serial",
        )
    recording, device = (str(name) for name in picked)
    named = {row[recording]: row[device] for row in rows if row[device]}
    often = Counter(Path(name).name for name in named)
    short = {Path(n).name: d for n, d in named.items() if often[Path(n).name] == 1}
    return {**short, **named}


def assign_devices(found: Sequence[Calibrated], named: Mapping[str, str]) -> tuple[Calibrated, ...]:
    """Every recording with its device: as named, as its file says, or a device by itself.

    Raises UnreadableInput where some are named and others are not.
    """
    own = {one.name: named.get(one.recording) or named.get(one.provenance.path) for one in found}
    absent = [one.recording for one in found if named and own[one.name] is None]
    if absent:
        raise UnreadableInput(
            f"no device is named for {', '.join(absent[:3])}"
            + (f" and {len(absent) - 3} more" if len(absent) > 3 else ""),
            remedy="add these recordings to the table of --devices, by the paths of their files",
        )
    return tuple(replace(one, device=own[one.name] or one.device or one.name) for one in found)


@dataclass(frozen=True)
class Wanted:
    """only, without : as of a search; devices : table that says which recording is of which
    command : that was typed"""

    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    devices: Path | None = None
    command: str = ""

    def describe_settings(self) -> dict[str, object]:
        """The settings as provenance keeps them."""
        return {
            "only": list(self.only),
            "without": list(self.without),
            "devices_sha256": None if self.devices is None else sha256_of(self.devices),
        }


def run_recorded(paths: Sequence[Path], wanted: Wanted, say: Callable[[str], None]) -> Fleet:
    """Pool calibrations of one calibrator, whose recordings are grouped by device.

    Raises UnreadableInput for what is no calibration, and UsageError for fewer than two devices and
    for calibrators that differ.
    """
    found, failed = load_calibrations(paths)
    found = assign_devices(found, read_devices(wanted.devices) if wanted.devices else {})
    usable = tuple(one for one in found if one.calibration.status != _WEAK)
    _demand_one_kind(usable, failed, weak=len(found) - len(usable))
    of = {
        name: [one for one in usable if one.device == name]
        for name in dict.fromkeys(one.device for one in usable)
    }
    say(f"{len(usable)} recordings of {len(of)} devices; searching for what they share")
    effects = tuple(effects_to_search(wanted.only, wanted.without, {}).effects)
    sums = {name: [one.sums for one in own if one.sums is not None] for name, own in of.items()}
    own = [device_of(name, every, effects) for name, every in sums.items() if every]
    said = search_fleet(own, say, without=True) if len(own) > 1 else None
    members, values = _members(of, own, said)
    device = np.repeat(np.arange(len(of)), [len(own) for own in of.values()])
    spreads = shared_parameters(
        [values[one.name] for own in of.values() for one in own],
        tuple(said.following) if said else (),
        device,
    )
    return Fleet(
        members=members,
        failed=failed,
        search=said,
        spreads=spreads,
        outliers=outliers(list(of), spreads),
        difference=_gain(own, said) if said and said.found else None,
        calibrator=usable[0].calibrator,
        command=wanted.command,
        settings=wanted.describe_settings(),
        following=_following(usable, spreads, said),
        notes=_notes(found, usable, own),
    )


def _demand_one_kind(
    usable: Sequence[Calibrated], failed: Sequence[tuple[str, str]], weak: int
) -> None:
    if len({one.device for one in usable}) < 2:
        why = [f"{name}: {text}" for name, text in failed]
        why += [f"{weak} of weak coverage say too little of their device"] if weak else []
        raise UsageError(
            f"a fleet needs two devices or more, and {len({o.device for o in usable})} of these "
            "calibrations can be used" + (f" ({'; '.join(why)})" if why else ""),
            remedy="give the calibrations of more devices; --devices says which recording is of "
            "which",
        )
    kinds = {one.calibrator: one for one in usable}
    if len(kinds) > 1:
        text = ", ".join(f"{one.name} of {kind}" for kind, one in kinds.items())
        raise UsageError(f"calibrations of different kinds: {text}", remedy="give those of one")
    first = usable[0]
    for one in usable[1:]:
        own, other = ({v.name: v.unit for v in c.values} for c in (first, one))
        if not set(own.items()) & set(other.items()):
            raise UsageError(
                f"{first.name} and {one.name} have no parameter in common",
                remedy="give devices of one kind",
            )


def _members(
    of: Mapping[str, Sequence[Calibrated]], own: Sequence[PooledDevice], said: Search | None
) -> tuple[tuple[FleetMember, ...], dict[str, tuple[StoredParameter, ...]]]:
    """Devices, and of every recording the parameters with what its device has."""
    device = {one.name: one for one in own}
    members, values = list[FleetMember](), dict[str, tuple[StoredParameter, ...]]()
    for name, recordings in of.items():
        made = []
        for one in recordings:
            given = said.by_others.get(name, {}) if said else {}
            recording, values[one.name] = _recording(one, device.get(name), given)
            made.append(recording)
        base = final = float("nan")
        others = said.unseen.get(name, {}) if said else {}
        if name in device:
            base, final = device[name].noise, predict_noise(device[name], others)[0]
        members.append(FleetMember(name, tuple(made), base, final, tuple(others)))
    return tuple(members), values


def _gain(own: Sequence[PooledDevice], said: Search) -> Difference:
    """Of devices of the kind: each is one number, predicted by the others. The density decides: an
    effect that is small against the noise of one posture is sure by hundreds of them."""
    pairs = [predict_noise(device, said.unseen.get(device.name, {})) for device in own]
    after, nats = np.array(pairs).T
    before = np.array([device.noise for device in own])
    found = difference(before, after, np.arange(len(own)), len(own), "rms")
    return add_density(found, nats)


def _following(
    usable: Sequence[Calibrated], spreads: Sequence[Spread], said: Search | None
) -> Population | None:
    """Of worn sensors, whose next recording takes it; None for others."""
    sums = [one.sums for one in usable if one.sums is not None]
    by_name = {one.name: one for one in spreads}
    if said is None or not sums or not set(sums[0].base.parameters) <= set(by_name):
        return None
    noise: Array = MG * np.array([np.hypot(one.noise, one.drift) for one in sums])
    sure = np.array([np.sqrt(0.5 / one.dof) for one in sums])
    return population_of(
        [by_name[name] for name in sums[0].base.parameters],
        said.following,
        {"reading": (noise, sure)},
        Context(1),
        "norm",
    )


def _notes(
    found: Sequence[Calibrated], usable: Sequence[Calibrated], own: Sequence[PooledDevice]
) -> tuple[str, ...]:
    notes = []
    if weak := [one.name for one in found if one.calibration.status == _WEAK]:
        notes.append(
            f"Of weak coverage, so that they say nothing of their kind: {', '.join(weak)}. "
            "Calibrate them again beside the others: `imucal actigraph RECORDING --fleet "
            "FOLDER/fleet.yaml`."
        )
    without = [one.name for one in usable if one.sums is None]
    if usable[0].calibrator == "actigraph" and without:
        notes.append(
            f"Without what a search needs (--no-loop, or an earlier version): {', '.join(without)}."
        )
    if len(own) < 2 and usable[0].calibrator != "actigraph":
        notes.append(
            f"Calibrations of `imucal {usable[0].calibrator}` do not hold what a search for shared "
            "effects needs: their parameters are compared."
        )
    return tuple(notes)
