"""Finished calibrations as a fleet takes them: from a run's folder, its files, or a batch."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from imucalib.calibration import sums as block
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import check, read
from imucalib.calibration.provenance import Provenance
from imucalib.calibration.triads import Triad
from imucalib.cohort.entries import calibration_beside
from imucalib.core.fit import StoredParameter
from imucalib.errors import ImucalError, UnreadableInput
from imucalib.posterior.closed_loop.sums import Sums
from imucalib.recording.identity import NAMELESS
from imucalib.units import MG

#: What is no table: a folder of a run or of a batch, a calibration, a report, an entry.
_SUFFIXES = (".yaml", ".yml", ".json")


@dataclass(frozen=True)
class Calibrated:
    """One recording's calibration.

    name : short, of its own in a fleet
    recording : its path as far as it is known
    device : serial number where the recording names one, or empty
    values : all parameters, fixture included; of an array also each IMU's gain and bias
    sums : what it says of every effect, or None
    """

    name: str
    recording: str
    device: str
    values: tuple[StoredParameter, ...]
    sums: Sums | None
    provenance: Provenance
    calibration: Calibration

    @property
    def calibrator(self) -> str:
        return self.calibration.calibrator


def is_calibrated(path: Path) -> bool:
    """Whether a path is a calibration's, and not a table's or a recording's."""
    return path.is_dir() or path.suffix.lower() in _SUFFIXES


def load_calibrations(
    paths: Sequence[Path],
) -> tuple[tuple[Calibrated, ...], tuple[tuple[str, str], ...]]:
    """Every calibration, and what could not be read or was no calibration: file -> why."""
    found, failed = list[Calibrated](), list[tuple[str, str]]()
    for path in paths:
        for file in _reports(path):
            try:
                one = _read(file)
                demand_new(one.provenance, [(o.name, o.provenance) for o in found], "recording")
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


def demand_new(one: Provenance, others: Sequence[tuple[str, Provenance]], what: str) -> None:
    """Raise UnreadableInput for a table or recording that is there, by name, already: counted
    twice, it would agree with itself."""
    for name, other in others:
        if one.sha256 == other.sha256:
            raise UnreadableInput(f"the same {what} as {name}", remedy="give each device's once")


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


def _read(file: Path) -> Calibrated:
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
        kept = {one.name for one in fields(Provenance)} - {"path", "parts"}
        return Calibrated(
            name=Path(made["input"]).name.partition(".")[0],
            recording=content["recording"] if entry else made["input"],
            device=(own.sensor or NAMELESS).serial,
            values=(*own.parameters, *_of_imus(own.triads)),
            sums=None if sums is None else block.sums_of(sums),
            provenance=Provenance(path=made["input"], **{name: made[name] for name in kept}),
            calibration=own,
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UnreadableInput(
            f"no report of imucal, or a damaged one: {error!r}", where=str(file)
        ) from None


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
