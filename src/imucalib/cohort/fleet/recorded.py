"""From finished calibrations to a fleet: what the devices share, and how they differ. They are
taken from a run's folder, its files, or a batch."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration import sums as block
from imucalib.calibration.file import check, read
from imucalib.calibrators.population import Population
from imucalib.cohort.entries import calibration_beside
from imucalib.cohort.fleet.outcome import (
    DeviceRecording,
    Fleet,
    FleetMember,
    Spread,
    demand_new,
    outliers,
    population_of,
    shared_parameters,
)
from imucalib.cohort.fleet.search import (
    PooledDevice,
    Priors,
    Search,
    evidence_of_sizes,
    search_fleet,
)
from imucalib.core.effect import Context
from imucalib.core.fit import StoredParameter
from imucalib.effects import named
from imucalib.errors import ImucalError, UnreadableInput, UsageError
from imucalib.file_hash import sha256_of
from imucalib.posterior.candidates import effects_to_search
from imucalib.posterior.closed_loop.sums import Sums, columns_of
from imucalib.posterior.held_out import Difference, add_density, difference
from imucalib.recording.identity import NAMELESS
from imucalib.units import MG

#: What is no table: a folder of a run or of a batch, a calibration, a report, an entry.
_SUFFIXES = (".yaml", ".yml", ".json")
#: sd of an effect that a recording has by itself, in typical sizes: its own data decide.
_OWN = 10.0
#: Headings of the two columns, the first that is there: `imucal collect` writes the last ones.
_RECORDING, _DEVICE = ("recording", "path"), ("device", "serial")
#: Status of a calibration that rests on a prior as much as on its postures.
_WEAK = "weak"


def is_calibrated(path: Path) -> bool:
    """Whether a path is a calibration's, and not a table's or a recording's."""
    return path.is_dir() or path.suffix.lower() in _SUFFIXES


def load_calibrations(
    paths: Sequence[Path],
) -> tuple[tuple[DeviceRecording, ...], tuple[tuple[str, str], ...]]:
    """Every calibration, and what could not be read or was no calibration: file -> why."""
    found, failed, known = list[DeviceRecording](), list[tuple[str, str]](), dict[str, str]()
    for path in paths:
        for file in _reports(path):
            try:
                one = _read(file)
                demand_new(one, known, "recording")
                found.append(one)
            except ImucalError as error:
                short = file.parent.name if file.name == "report.json" else file.stem
                failed.append((short, str(error)))
    # Recordings of the same name are numbered in the order given.
    often, seen, apart = Counter(one.name for one in found), Counter[str](), []
    for one in found:
        seen[one.name] += 1
        number = f"_{seen[one.name]}" if often[one.name] > 1 else ""
        apart.append(replace(one, name=f"{one.name}{number}"))
    return tuple(apart), tuple(failed)


def _reports(path: Path) -> Iterator[Path]:
    """The JSON files that a path means. Raises UnreadableInput where there are none."""
    if path.is_file() and path.suffix.lower() == ".json":
        yield path
        return
    folder = path if path.is_dir() else path.parent
    if (folder / "report.json").is_file():
        yield folder / "report.json"
        return
    entries = sorted(folder.glob("*.json")) if path.is_dir() else []
    if not entries:
        raise UnreadableInput(
            "no report.json of a calibration, and no entries of a batch",
            where=str(path),
            remedy="give the folder that a calibrating command wrote, with all of its files, or "
            "that of `imucal batch`",
        )
    yield from entries


def _read(file: Path) -> DeviceRecording:
    """Raises UnreadableInput for what is no report with its calibration beside it, or an entry of
    what was not calibrated."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        entry = "exit_code" in content and "calibrator" not in content
        if entry and content["row"] is None:
            raise UnreadableInput(content["error"] or "it was not calibrated", where=str(file))
        stored = calibration_beside(file) if entry else file.with_name("calibration.yaml")
        own, sums = read(stored), content["sums"] if entry else content.get(block.KEY)
        check(own, str(stored))
        made = own.facts["provenance"]
        return DeviceRecording(
            name=Path(made["input"]).name.partition(".")[0],
            calibration=own,
            path=content["recording"] if entry else made["input"],
            device=(own.sensor or NAMELESS).serial,
            sums=None if sums is None else block.sums_of(sums),
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UnreadableInput(
            f"no report of imucal, or a damaged one: {error!r}", where=str(file)
        ) from None


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


def _put_in(one: DeviceRecording, device: PooledDevice | None, said: Priors) -> DeviceRecording:
    """A recording with its device's effects; as it is where the fleet has nothing for it, or where
    it has what the fleet cannot keep."""
    if one.sums is None or device is None or not said:
        return one
    base = one.sums.base
    # Effects that the recording's own search has added to the base model.
    own = list(dict.fromkeys(v.effect for v in one.values if v.name not in set(base.parameters)))
    if lost := [name for name in own if name not in one.sums.blocks]:
        return replace(one, kept=f"it has {', '.join(lost)} of its own")
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
    return replace(one, calibration=made)


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


def assign_devices(
    found: Sequence[DeviceRecording], named: Mapping[str, str]
) -> tuple[DeviceRecording, ...]:
    """Every recording with its device: as named, as its file says, or a device by itself.

    Raises UnreadableInput where some are named and others are not.
    """
    own = {one.name: named.get(one.path) or named.get(one.provenance["input"]) for one in found}
    absent = [one.path for one in found if named and own[one.name] is None]
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
    members = _members(of, own, said)
    spreads = shared_parameters(members, tuple(said.following) if said else ())
    return Fleet(
        members=members,
        failed=failed,
        search=said,
        spreads=spreads,
        outliers=outliers(list(of), spreads),
        difference=_gain(own, said) if said and said.found else None,
        calibrator=usable[0].calibration.calibrator,
        command=wanted.command,
        settings=wanted.describe_settings(),
        following=_following(usable, spreads, said),
        notes=_notes(found, usable, own),
    )


def _demand_one_kind(
    usable: Sequence[DeviceRecording], failed: Sequence[tuple[str, str]], weak: int
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
    kinds = {one.calibration.calibrator: one for one in usable}
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
    of: Mapping[str, Sequence[DeviceRecording]], own: Sequence[PooledDevice], said: Search | None
) -> tuple[FleetMember, ...]:
    """Devices, every recording with what its device has."""
    device, members = {one.name: one for one in own}, list[FleetMember]()
    for name, recordings in of.items():
        given = said.by_others.get(name, {}) if said else {}
        made = tuple(_put_in(one, device.get(name), given) for one in recordings)
        base = final = float("nan")
        others = said.unseen.get(name, {}) if said else {}
        if name in device:
            base, final = device[name].noise, predict_noise(device[name], others)[0]
        members.append(FleetMember(name, made, base, final, tuple(others)))
    return tuple(members)


def _gain(own: Sequence[PooledDevice], said: Search) -> Difference:
    """Of devices of the kind: each is one number, predicted by the others. The density decides: an
    effect that is small against the noise of one posture is sure by hundreds of them."""
    pairs = [predict_noise(device, said.unseen.get(device.name, {})) for device in own]
    after, nats = np.array(pairs).T
    before = np.array([device.noise for device in own])
    found = difference(before, after, np.arange(len(own)), len(own), "rms")
    return add_density(found, nats)


def _following(
    usable: Sequence[DeviceRecording], spreads: Sequence[Spread], said: Search | None
) -> Population | None:
    """Of worn sensors, whose next recording takes it; None for others."""
    sums = [one.sums for one in usable if one.sums is not None]
    if said is None or not sums:
        return None
    noise: Array = MG * np.array([np.hypot(one.noise, one.drift) for one in sums])
    sure = np.array([np.sqrt(0.5 / one.dof) for one in sums])
    return population_of(
        sums[0].base.parameters,
        spreads,
        said.following,
        {"reading": (noise, sure)},
        Context(1),
        "norm",
    )


def _notes(
    found: Sequence[DeviceRecording], usable: Sequence[DeviceRecording], own: Sequence[PooledDevice]
) -> tuple[str, ...]:
    notes = []
    if weak := [one.name for one in found if one.calibration.status == _WEAK]:
        notes.append(
            f"Of weak coverage, so that they say nothing of their kind: {', '.join(weak)}. "
            "Calibrate them again beside the others: `imucal actigraph RECORDING --fleet "
            "FOLDER/fleet.yaml`."
        )
    kind = usable[0].calibration.calibrator
    without = [one.name for one in usable if one.sums is None]
    if kind == "actigraph" and without:
        notes.append(
            f"Without what a search needs (--no-loop, or an earlier version): {', '.join(without)}."
        )
    if len(own) < 2 and kind != "actigraph":
        notes.append(
            f"Calibrations of `imucal {kind}` do not hold what a search for shared "
            "effects needs: their parameters are compared."
        )
    return tuple(notes)
