"""From finished calibrations to a fleet: what the devices share, and how they differ."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.population import Population
from imucalib.cohort.fleet.device import Device
from imucalib.cohort.fleet.following import population_of
from imucalib.cohort.fleet.left_out import Said, said_by
from imucalib.cohort.fleet.outcome import Asked, Fleet, Member, Recording
from imucalib.cohort.fleet.recorded.calibrated import Calibrated, Value, calibrated
from imucalib.cohort.fleet.recorded.devices import read_devices, with_devices
from imucalib.cohort.fleet.recorded.pooled import (
    combined,
    device_of,
    foretold,
    own_effects,
    sizes_of,
    with_effects,
)
from imucalib.cohort.fleet.search import Rules
from imucalib.cohort.fleet.spread import Spread, nested_spread, outliers
from imucalib.core.context import Context
from imucalib.core.prior import Prior
from imucalib.errors import UsageError
from imucalib.loop.candidates import searched
from imucalib.loop.held_out import Difference, difference, with_density
from imucalib.readers.source import sha256_of
from imucalib.units import MG


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
    of = {name: [one for one in usable if one.device == name] for name in
          dict.fromkeys(one.device for one in usable)}  # fmt: skip
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
                f"{first.name} and {one.name} have no parameter in common", remedy="give devices "
                "of one kind",
            )  # fmt: skip


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
    of: Mapping[str, Sequence[Calibrated]], values: Mapping[str, tuple[Value, ...]],
    pooled: Sequence[str],
) -> tuple[Spread, ...]:  # fmt: skip
    """Of every parameter that all recordings have, without effects whose sizes are pooled already:
    there each device's value leans on the others'."""
    recordings = [(k, one.name) for k, own in enumerate(of.values()) for one in own]
    tables = [{v.name: v for v in values[name]} for _, name in recordings]
    device = np.array([k for k, _ in recordings], np.intp)
    shared = [v for v in tables[0].values()
              if v.effect not in pooled and all(v.name in table for table in tables)]  # fmt: skip
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
