"""Entries: what became of each recording of a cohort, as files, and the table of all.

An entry holds its recording's row and, beside it, the calibration: a cohort is gathered by rows, as
none of its files is ever held with another.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from imucalib.atomic_file import replace_atomically
from imucalib.calibration import sums
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import to_yaml, write_together
from imucalib.calibration.outcome import KEEP, NO_NAME, UNPROVED_NAME, Left, Limit
from imucalib.errors import UsageError
from imucalib.recording.pairing import cell

#: What a recording without a report is, by the command's exit code.
_FAILED = {3: "unreadable", 4: "undetermined"}
#: Columns that a paper has of its recordings, of all that `rows` knows.
PAPER = (
    "recording",
    "use",
    "why",
    "serial",
    "hours_worn",
    "posture_runs",
    "effects_added",
    "error_before",
    "error_after",
    "norm_sd_largest_mg",
    "enmo_before_mg",
    "enmo_after_mg",
)
#: What the calibration is good for, by the status of its run.
_USE = {"ok": "use", "marginal": "care"}
_NO_USE = "do not"


@dataclass(frozen=True)
class Entry:
    """What became of one recording.

    exit_code : of the command, or negative when a signal ended it; error : its message
    row : of the table, None when nothing was calibrated; sums : what the recording says of every
    effect, for a fleet, where that is known; reused : nothing had to be done
    """

    recording: str
    key: str
    exit_code: int
    seconds: float
    error: str
    row: dict[str, Any] | None = None
    sums: dict[str, Any] | None = None
    reused: bool = False

    @property
    def calibrated(self) -> bool:
        return self.row is not None


def failure_words(message: str, remedy: str) -> str:
    """What and what to do, of a failure as commands tell it to machines."""
    return ". ".join(filter(None, (message, remedy)))


def read_entry(path: Path) -> Entry | None:
    """An entry from its file; None when there is none or it is no entry."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return Entry(**content)
    except (OSError, ValueError, TypeError):
        return None


def write_entry(entry: Entry, path: Path, calibration: Calibration | None = None) -> None:
    """Write an entry, and the calibration beside it where there is one, all or none; the folder is
    made where it is missing."""
    content = json.dumps(asdict(entry), allow_nan=False, separators=(",", ":"))
    texts = {path: content + "\n"}
    if calibration is not None:
        texts[calibration_beside(path)] = to_yaml(calibration)
    write_together(texts)


def calibration_beside(entry: Path) -> Path:
    """Where the calibration of an entry is."""
    return entry.with_suffix(".yaml")


def entry_of(
    recording: str, exit_code: int, seconds: float, error: str, report: Mapping[str, Any] | None
) -> Entry:
    """The entry, without a key, of a run with the content of its report.json, or with none."""
    row = None if report is None else _row_of(report)
    of_fleet = None if report is None else report.get(sums.KEY)
    return Entry(recording, "", exit_code, seconds, error, row=row, sums=of_fleet)


@dataclass(frozen=True)
class Cohort:
    """Entries of a folder: the file of each recording's newest, by name, and the columns of all.

    older : how many entries a newer one takes the place of; others : files that are no entries
    """

    newest: dict[str, Path]
    columns: tuple[str, ...]
    older: int
    others: int


def cohort_of(paths: Iterable[Path]) -> Cohort:
    """What the files of a folder, the oldest first, are."""
    newest, count, others = dict[str, tuple[Path, tuple[str, ...]]](), 0, 0
    known = dict[tuple[str, ...], tuple[str, ...]]()  # most rows have the same columns
    for path in paths:
        entry = read_entry(path)
        if entry is None:
            others += 1
            continue
        columns = tuple(_table_row(entry))
        newest[entry.recording] = path, known.setdefault(columns, columns)
        count += 1
    ordered = sorted(newest.items())
    kinds = dict.fromkeys(columns for _, (_, columns) in ordered)
    return Cohort(
        newest={name: path for name, (path, _) in ordered},
        columns=tuple(dict.fromkeys(name for columns in kinds for name in columns)),
        older=count - len(newest),
        others=others,
    )


def rows(cohort: Cohort) -> Iterator[dict[str, Any]]:
    """One flat row a recording: what it is good for and why, quality, errors before and after,
    parameters with sd. Of recordings with the same content all but the first say so."""
    first = dict[str, str]()
    for recording, path in cohort.newest.items():
        entry = read_entry(path)
        if entry is None:  # it went since the folder was looked at
            continue
        row = _table_row(entry)
        twin = first.setdefault(row.get("sha256", recording), recording)
        if twin != recording:
            said = f"the same data as {Path(twin).name}"
            row |= {"use": _NO_USE, "why": "; ".join(filter(None, (said, row["why"])))}
        yield row


def _table_row(entry: Entry) -> dict[str, Any]:
    """An entry's row; of a recording without a calibration what failed, and how to mend it."""
    failed = {
        "use": _NO_USE,
        "why": entry.error,
        "status": _FAILED.get(entry.exit_code, "failed"),
        "verdict": None,
        "what_to_do": entry.error.rpartition(". ")[2],
    }
    names = {"recording": entry.recording, "exit_code": entry.exit_code}
    return names | (entry.row or failed)


def _row_of(report: Mapping[str, Any]) -> dict[str, Any]:
    """What a table tells of a calibration, by its report.json."""
    card = report.get("card")
    steps = card["to_do"] if card else report["loop"]["advice"]
    return {
        "use": _USE.get(report["status"], _NO_USE),
        "why": "; ".join(_against(report)),
        "status": report["status"],
        "verdict": report["loop"]["verdict"],
        "what_to_do": next((str(step) for step in steps if not step.startswith(KEEP)), ""),
        **quality_of(report),
        **_numbers(report),
    }


def _against(report: Mapping[str, Any]) -> list[str]:
    """All that keeps a calibration from being simply good, each with its number."""
    broken = (
        Limit(m["name"], math.nan if m["value"] is None else m["value"], m["limit"], m["unit"])
        for m in report["limits"]
        if m["broken"]
    )
    left = (
        Left(m["name"], m["value"], m["accepted"], m["unit"]) for m in report["left"] if m["beyond"]
    )
    said = (*(one.sentence for one in broken), *report["undecided"], *report["reasons"])
    why = [*said, *(one.sentence for one in left)]
    if report["status"] == "marginal" and not why:
        why.append(UNPROVED_NAME if report["loop"]["verdict"] == "suspected" else NO_NAME)
    return why


def _numbers(report: Mapping[str, Any]) -> dict[str, Any]:
    error = report["loop"]["errors"][0]
    found: dict[str, Any] = {
        "sha256": report["provenance"]["sha256"],
        "samples": report["provenance"]["samples"],
        "effects_added": " ".join(s["effect"] for s in report["loop"]["steps"]),
        "error_unit": error["unit"],
        "error_raw": error["raw"],
        "error_base": error["base"],
        "error_final": error["final"],
        "held_out_base": error["held_out"]["base"],
        "held_out_final": error["held_out"]["final"],
    }
    found |= {
        k: v for k, v in report.get("recording", {}).items() if isinstance(v, int | float | str)
    }
    for parameter in report["parameters"]:
        found[parameter["name"]] = parameter["value"]
        found[f"{parameter['name']}_sd"] = parameter["sd"]
    return found


def quality_of(report: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of one recording from its report.json; None where a report does not tell.

    Hours in h, errors and standard deviations in the report's unit (mg for one sensor),
    temperatures in °C.
    """
    coverage, activity = report.get("coverage", {}), report.get("activity") or {}
    sensor = report.get("sensor", {})
    held = report["loop"]["errors"][0]["held_out"]
    warm = coverage.get("temperature_degC") or (None, None)
    # The direction with the largest held-out error of those that were seen.
    cells = [c for c in report.get("sphere", ()) if c["held_out_mg"] is not None]
    worst: dict[str, Any] = max(cells, key=lambda c: float(c["held_out_mg"]), default={})
    enmo = activity.get("enmo_mg", {}).get("all") or {}
    # Axes that gravity has pulled by 0.5 g both ways.
    span = coverage.get("axis_range_g")
    seen = span and "".join(a for a, (low, high) in span.items() if low < -0.5 and high > 0.5)
    return {
        "sensor": sensor.get("name"),
        **{key: sensor.get(key) for key in ("device", "serial")},
        "rate_hz": coverage.get("rate_hz"),
        "hours_recorded": _round(activity.get("hours_recorded", coverage.get("hours"))),
        "hours_worn": _round(activity.get("hours_worn")),
        "gaps": report["provenance"]["gaps"],
        "still_windows": coverage.get("still_windows"),
        "posture_runs": coverage.get("posture_runs"),
        "axes_seen_both_ways": (seen or "none") if span else None,
        "norm_sd_largest_mg": _round(coverage.get("norm_sd_largest_mg")),
        "temperature_least_degC": warm[0],
        "temperature_largest_degC": warm[1],
        "error_before": _round(held["raw"]),
        "error_after": _round(held["final"]),
        "worst_direction": worst.get("name"),
        "worst_direction_error_mg": _round(worst.get("held_out_mg")),
        "enmo_before_mg": _round(enmo.get("raw")),
        "enmo_after_mg": _round(enmo.get("corrected")),
    }


def _round(value: Any) -> float | None:
    return None if value is None else float(f"{value:.5g}")


def write_table(rows: Iterable[dict[str, Any]], path: Path, columns: Sequence[str]) -> None:
    """Write rows, one after the other; columns : those of `PAPER`, say, of which a row may lack
    some.

    Raises UsageError for a suffix that is neither .csv nor .parquet, or without the extra.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".parquet":
        _parquet(rows, columns, path)
        return
    if path.suffix != ".csv":
        raise UsageError(f"no table format for '{path.suffix}'", remedy="use .csv or .parquet")
    with (
        replace_atomically(path) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, columns, lineterminator="\n", extrasaction="ignore")
        writer.writerow({name: cell(name) for name in columns})
        writer.writerows({k: cell(v) for k, v in row.items()} for row in rows)


def _parquet(rows: Iterable[dict[str, Any]], columns: Sequence[str], path: Path) -> None:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise UsageError(
            "Parquet needs pyarrow", remedy="pip install 'imucalib[parquet]', or write .csv"
        ) from None
    cells: dict[str, list[Any]] = {name: [] for name in columns}
    for row in rows:
        for name, column in cells.items():
            column.append(row.get(name))
    table = pyarrow.table(cells)
    with replace_atomically(path) as temporary:
        pyarrow.parquet.write_table(table, temporary)
