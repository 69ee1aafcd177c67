"""From finished calibrations to a fleet: what the devices share, and how they differ."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.calibrators.population import Population
from imucalib.cohort.fleet.left_out import Said, said_by
from imucalib.cohort.fleet.outcome import (
    Asked,
    Fleet,
    Member,
    Recording,
    Spread,
    nested_spread,
    outliers,
    population_of,
)
from imucalib.cohort.fleet.pooled import Device, gained
from imucalib.cohort.fleet.recorded.calibrated import Calibrated, Value, calibrated
from imucalib.cohort.fleet.search import Rules
from imucalib.core.effect import Context
from imucalib.core.prior import Prior
from imucalib.effects import named
from imucalib.errors import UnreadableInput, UsageError
from imucalib.loop.candidates import searched
from imucalib.loop.held_out import Difference, difference, with_density
from imucalib.loop.sums import Sums, columns_of
from imucalib.readers.source import sha256_of
from imucalib.units import MG

#: sd of an effect that a recording has by itself, in typical sizes: its own data decide.
_OWN = 10.0


def device_of(name: str, recordings: Sequence[Sums], wanted: Sequence[str]) -> Device:
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
    return Device(name, noise, columns, gram, along, float(dof.sum()))


@dataclass(frozen=True)
class Foretold:
    """What a device's data say of effects at the sizes that others say. error : mg, its noise then;
    nats : gained by its data"""

    error: float
    nats: float


def foretold(device: Device, said: Mapping[str, Prior]) -> Foretold:
    """What effects of a given size explain is known exactly: |y - Xθ|² = |y|² - 2 aᵀθ + θᵀGθ."""
    from scipy.linalg import block_diag

    at = columns_of(device.columns, list(said))
    size = np.concatenate([np.zeros(0), *(one.mean for one in said.values())])
    gram, along = device.gram[np.ix_(at, at)], device.along[at]
    less = (2.0 * along @ size - size @ gram @ size) / device.dof
    error = device.noise * float(np.sqrt(max(1.0 - less, 0.0)))
    spread = block_diag(*(one.covariance for one in said.values())) if said else np.zeros((0, 0))
    return Foretold(error, gained(gram, along, size, np.asarray(spread)))


@dataclass(frozen=True)
class Sizes:
    """Of a device's effects in typical sizes, by its own data and what the others say: names in the
    order of mean (k,) and covariance (k, k)."""

    names: tuple[str, ...]
    mean: Array
    covariance: Array

    def of(self, sums: Sums) -> Sizes:
        """Of those that a recording can show."""
        able = tuple(name for name in self.names if name in sums.blocks)
        width = [named(name).parameters(Context(1)) for name in self.names]
        of = np.repeat(self.names, [len(one) for one in width])
        at = np.flatnonzero(np.isin(of, able))
        return Sizes(able, self.mean[at], self.covariance[np.ix_(at, at)])


def sizes_of(device: Device, said: Mapping[str, Prior], own: Sequence[str]) -> Sizes:
    """said : by the others; own : effects of this device alone, of which nobody says anything"""
    names = (*said, *(e for e in own if e not in said))
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
    return Sizes(names, covariance @ towards, covariance)


@dataclass(frozen=True)
class Combined:
    """A recording's parameters with its device's effects: values in their units, covariance."""

    effects: tuple[str, ...]
    values: tuple[Value, ...]
    covariance: Array


def combined(one: Calibrated, sizes: Sizes) -> Combined:
    """One Gauss-Newton step from the base model: second order is the base's share of an effect."""
    assert one.sums is not None
    able = sizes.of(one.sums)
    theta, covariance = one.sums.together(able.names, able.mean, able.covariance)
    new = [(name, p) for name in able.names for p in named(name).parameters(Context(1))]
    scale = np.concatenate([np.ones(one.sums.base.theta.size), [p.typical for _, p in new]])
    theta, covariance = theta * scale, covariance * np.outer(scale, scale)
    units = {v.name: (v.effect, v.unit) for v in one.values}
    units |= {p.name: (name, p.unit) for name, p in new}
    names = (*one.sums.base.parameters, *(p.name for _, p in new))
    values = tuple(
        Value(name, units[name][0], float(v), float(s), units[name][1])
        for name, v, s in zip(names, theta, np.sqrt(np.diag(covariance)), strict=True)
    )
    return Combined(able.names, values, covariance)


def own_effects(one: Calibrated) -> tuple[str, ...]:
    """Effects that the recording's own search has put beside the base model."""
    assert one.sums is not None
    base = set(one.sums.base.parameters)
    return tuple(dict.fromkeys(v.effect for v in one.values if v.name not in base))


def with_effects(own: Calibration, made: Combined) -> Calibration:
    """The calibration with the fleet's effects in the place of what it had beside its base; its
    errors stay those of the recording alone, and it says so."""
    stage = {p.effect: p.stage for p in own.parameters}
    stage |= {name: named(name).stage for name in made.effects}
    stored = tuple(
        StoredParameter(v.name, v.effect, stage[v.effect], v.value, v.sd, v.unit)
        for v in made.values
    )
    said = {"effects": list(made.effects), "errors": "of the recording calibrated alone"}
    facts = {**own.facts, "fleet": said}
    return replace(own, parameters=stored, covariance=made.covariance, facts=facts, sha256="")


#: Headings of the two columns, the first that is there: `imucal collect` writes the last ones.
_RECORDING, _DEVICE = ("recording", "path"), ("device", "serial")


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


def with_devices(found: Sequence[Calibrated], named: Mapping[str, str]) -> tuple[Calibrated, ...]:
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
    rules: Rules = field(default_factory=Rules)
    seed: int = 0
    command: str = ""

    def stated(self) -> dict[str, object]:
        """The settings as provenance keeps them."""
        return {
            "only": list(self.only),
            "without": list(self.without),
            "devices_sha256": None if self.devices is None else sha256_of(self.devices),
            **vars(self.rules),
        }


#: Status of a calibration that stands on a prior as much as on its postures.
_WEAK = "weak"


def run_recorded(paths: Sequence[Path], wanted: Wanted, say: Callable[[str], None]) -> Fleet:
    """Pool calibrations of one calibrator, whose recordings are grouped by device.

    Raises UnreadableInput for what is no calibration, and UsageError for fewer than two devices and
    for calibrators that differ.
    """
    found, failed = calibrated(paths)
    found = with_devices(found, read_devices(wanted.devices) if wanted.devices else {})
    usable = tuple(one for one in found if one.status != _WEAK)
    _demand_one_kind(usable, failed, weak=len(found) - len(usable))
    of = {
        name: [one for one in usable if one.device == name]
        for name in dict.fromkeys(one.device for one in usable)
    }
    say(f"{len(usable)} recordings of {len(of)} devices; searching for what they share")
    effects = tuple(searched(wanted.only, wanted.without, {}).effects)
    pooled = {name: [one.sums for one in own if one.sums is not None] for name, own in of.items()}
    own = [device_of(name, sums, effects) for name, sums in pooled.items() if sums]
    said = said_by(own, wanted.rules, wanted.seed, say, without=True) if len(own) > 1 else None
    members, values = _members(of, own, said)
    spreads = _spreads(of, values, tuple(said.following) if said else ())
    return Fleet(
        members=members,
        failed=failed,
        search=said.search if said else None,
        spreads=spreads,
        outliers=outliers(list(of), spreads),
        difference=_gain(own, said) if said and said.search.found else None,
        asked=Asked(usable[0].calibrator, wanted.command, wanted.seed, wanted.stated()),
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
    of: Mapping[str, Sequence[Calibrated]], own: Sequence[Device], said: Said | None
) -> tuple[tuple[Member, ...], dict[str, tuple[Value, ...]]]:
    """Devices, and of every recording the parameters with what its device has."""
    device = {one.name: one for one in own}
    members, values = list[Member](), dict[str, tuple[Value, ...]]()
    for name, recordings in of.items():
        made = []
        told = said.told.get(name, {}) if said else {}
        for one in recordings:
            recording, values[one.name] = _recording(one, device.get(name), told)
            made.append(recording)
        base = final = float("nan")
        others = said.inner.get(name, {}) if said else {}
        if name in device:
            base, final = device[name].noise, foretold(device[name], others).error
        members.append(Member(name, tuple(made), base, final, tuple(others)))
    return tuple(members), values


def _recording(
    one: Calibrated, device: Device | None, told: Mapping[str, Prior]
) -> tuple[Recording, tuple[Value, ...]]:
    """As it is where the fleet has nothing for it, or where it has what the fleet cannot keep."""
    if one.sums is None or device is None or not told:
        return Recording(one.name, one.provenance, one.calibration), one.values
    mine = own_effects(one)
    if lost := [name for name in mine if name not in one.sums.blocks]:
        kept = f"it has {', '.join(lost)} of its own"
        return Recording(one.name, one.provenance, one.calibration, kept), one.values
    made = combined(one, sizes_of(device, told, mine))
    stored = one.calibration and with_effects(one.calibration, made)
    return Recording(one.name, one.provenance, stored), made.values


def _spreads(
    of: Mapping[str, Sequence[Calibrated]],
    values: Mapping[str, tuple[Value, ...]],
    pooled: Sequence[str],
) -> tuple[Spread, ...]:
    """Of every parameter that all recordings have, without effects whose sizes are pooled already:
    there each device's value leans on the others'."""
    recordings = [(k, one.name) for k, own in enumerate(of.values()) for one in own]
    tables = [{v.name: v for v in values[name]} for _, name in recordings]
    device = np.array([k for k, _ in recordings], np.intp)
    shared = [
        v
        for v in tables[0].values()
        if v.effect not in pooled and all(v.name in table for table in tables)
    ]
    return tuple(
        nested_spread(
            v.name,
            v.unit,
            np.array([table[v.name].value for table in tables]),
            np.array([table[v.name].sd for table in tables]),
            device,
        )
        for v in shared
    )


def _gain(own: Sequence[Device], said: Said) -> Difference:
    """Of devices of the kind: each is one number, predicted by the others. The density decides: an
    effect that is small beside the noise of one posture is sure by hundreds of them."""
    told = [foretold(device, said.inner.get(device.name, {})) for device in own]
    before, after = np.array([d.noise for d in own]), np.array([one.error for one in told])
    found = difference(before, after, np.arange(len(own)), len(own), "rms")
    return with_density(found, np.array([one.nats for one in told]))


def _following(
    usable: Sequence[Calibrated], spreads: Sequence[Spread], said: Said | None
) -> Population | None:
    """Of worn sensors, whose next recording takes it; None for others."""
    sums = [one.sums for one in usable if one.sums is not None]
    by_name = {one.name: one for one in spreads}
    if said is None or not sums or not set(sums[0].base.parameters) <= set(by_name):
        return None
    noise: Array = MG * np.array([np.hypot(one.noise, one.wander) for one in sums])
    sure = np.array([np.sqrt(0.5 / one.dof) for one in sums])
    return population_of(
        [by_name[name] for name in sums[0].base.parameters],
        said.following,
        {"reading": (noise, sure)},
        Context(1),
        "norm",
    )


def _notes(
    found: Sequence[Calibrated], usable: Sequence[Calibrated], own: Sequence[Device]
) -> tuple[str, ...]:
    notes = []
    if weak := [one.name for one in found if one.status == _WEAK]:
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
