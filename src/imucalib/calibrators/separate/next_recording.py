"""What to record next, of whichever calibrator: its plan, and the table that is filled in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.calibration.ambiguity import KEY, read_report
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import check, read
from imucalib.calibrators.array.separate.motion_block import motions_of
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.separate.candidates import BEFORE, Rests
from imucalib.calibrators.separate.plan import Planned, Wish, planned
from imucalib.calibrators.separate.recorded import Recorded, recorded_of
from imucalib.effects import named
from imucalib.errors import UsageError
from imucalib.loop.separation.plan import Separation


@dataclass(frozen=True)
class Part:
    """One ambiguity. what : is recorded ("rests", "postures", "motion"); header, rows : each of
    them, in words; remedies : what would end what they cannot"""

    separation: Separation
    what: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    remedies: tuple[str, ...]

    @property
    def ended(self) -> bool:
        """Whether what is planned ends the ambiguity."""
        return self.separation.enough


@dataclass(frozen=True)
class NextRecording:
    """parts : of every ambiguity, none where a name stands alone; table : as CSV, to be filled in,
    or empty; wish : what the user can do"""

    calibrator: str
    parts: tuple[Part, ...]
    table: str
    wish: Wish

    @property
    def exit_code(self) -> int:
        """5 where an ambiguity stays."""
        return 0 if all(part.ended for part in self.parts) else 5


def next_recording(path: Path, wish: Wish) -> NextRecording:
    """Plan from a calibration's folder, or from the calibration.yaml in it.

    Raises UnreadableInput where the folder lacks the run's files, and UsageError where a wish does
    not fit the recording.
    """
    folder = path if path.is_dir() else path.parent
    file = folder / "calibration.yaml" if path.is_dir() else path
    calibration = read(file)
    check(calibration, str(file))
    report, where = read_report(folder), str(folder / "report.json")
    if calibration.calibrator == "array":
        return _motions(report, where, wish)
    recorded = recorded_of(report[KEY], where)
    if wish.temperatures and "temperature" not in recorded.covariates:
        raise UsageError(
            "--temperatures: the recording has no temperature",
            where=str(folder),
            remedy="leave it out, or record the temperature and calibrate again",
        )
    found = planned(recorded, calibration, wish)
    writer = _Writer(calibration, recorded, report)
    parts = tuple(writer.part(one) for one in found)
    return NextRecording(calibration.calibrator, parts, writer.table(found), wish)


def _motions(report: Mapping[str, Any], where: str, wish: Wish) -> NextRecording:
    """Of an array, whose run has tried the motions itself."""
    if wish.temperatures or wish.between:
        raise UsageError(
            "--temperatures and --between-sessions are for sensors at rest",
            where=where,
            remedy="leave them out: an array is told a motion",
        )
    parts = []
    for one in motions_of(report[KEY], where):
        separation = one.separation
        rows = (("1", *one.words, f"{one.seconds:.0f} s"),) if separation.plan else ()
        effects = dict.fromkeys(
            name.partition("@")[0] for pair in separation.never for name in pair
        )
        remedies = tuple(dict.fromkeys(named(name).identify.rstrip(".") for name in effects))
        header = ("", "about", "how", "how fast", "how long")
        parts.append(Part(separation, "motion", header, rows, remedies))
    return NextRecording("array", tuple(parts), "", wish)


@dataclass(frozen=True)
class _Writer:
    """Rests in words and as a table."""

    calibration: Calibration
    recorded: Recorded
    report: Mapping[str, Any]

    def part(self, one: Planned) -> Part:
        what = "postures" if self.calibration.calibrator == "actigraph" else "rests"
        values = self._values(one.rests)
        told = [name for name in values if name not in _UNTOLD[self.recorded.reference]]
        count = one.rests.n
        rows = tuple((str(k + 1), *(values[name][k] for name in told)) for k in range(count))
        header = ("", *(_HEADINGS.get(name, name) for name in told))
        return Part(one.separation, what, header, rows, one.remedies)

    def table(self, every: tuple[Planned, ...]) -> str:
        """All rests, with empty cells for the readings under the recording's own headings."""
        names = (self.report.get("provenance") or {}).get("mapping") or {}
        readings = [str(names.get(axis, axis)) for axis in "xyz"]
        lines = []
        for one in every:
            values = self._values(one.rests)
            lines += [",".join(v[k] for v in values.values()) + ",,," for k in range(one.rests.n)]
            header = ",".join((*values, *readings))
        return "\n".join((header, *lines, "")) if lines else ""

    def _values(self, rests: Rests) -> dict[str, list[str]]:
        """Columns by role, in the words of the user's conventions."""
        conventions = Conventions(**(self.calibration.facts.get("conventions") or {}))
        i, t = conventions.outside(rests.inclination, rests.tool_face)
        values = {"inclination": [f"{v:.1f}" for v in i], "tool_face": [f"{v:.1f}" for v in t]}
        if self.recorded.reference != "vector":
            values |= {f"u{a}": [f"{v:.3f}" for v in np.round(rests.direction[:, k], 3) + 0.0]
                       for k, a in enumerate("xyz")}  # fmt: skip
        for name, level in rests.levels.items():
            hour = 12.0 / np.pi if name == "time_of_day" else 1.0
            values[name] = [f"{v:.4g}" for v in hour * level]
        return values


#: Columns of the table that the reader of the report needs not: how else a direction is said.
_UNTOLD = {"vector": (), "direction": ("inclination", "tool_face"),
           "norm": ("inclination", "tool_face")}  # fmt: skip
_HEADINGS = {
    "tool_face": "tool-face", "temperature": "degC", BEFORE: "degC before",
    "time_of_day": "hour of day", "ux": "gravity along x", "uy": "y", "uz": "z",
    "inclination_approach": "inclination from", "tool_face_approach": "tool-face from",
}  # fmt: skip
