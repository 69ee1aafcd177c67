"""The report of `imucal inspect`, as a document and as plain types."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from imucalib.calibrators.lab.files import TableSeen
from imucalib.data import Data
from imucalib.inspection.inspection import ChannelFacts, Inspection, advice, next_commands, problems
from imucalib.recording.mapping import OPTION_FIELDS
from imucalib.recording.yaml_text import load
from imucalib.report.render.document import (
    Block,
    Column,
    Document,
    Facts,
    Plot,
    Section,
    Series,
    Table,
    Text,
)
from imucalib.report.sections import decision
from imucalib.rests.candidates import Candidate, refusals
from imucalib.rests.segments import Segments
from imucalib.units import DEG, MG, STANDARD_GRAVITY

#: Fields of a mapping that have an option of their own.
_OPTIONS = (
    " sensor acc gyro temperature time gyro_unit temperature_unit time_unit rate axis_map preset "
    "acc_offset skip decimal delimiter "
)
_RENAMED = {field: f"--{name.replace('_', '-')}" for name, field in OPTION_FIELDS.items()}
_RESTS = (
    "Drift and noise of the worst axis. Turning: the mean goes further than 0.3 deg, or steadily "
    "by more than 0.025 deg/s, or the gyroscope is off its bias; vibrating: louder than a "
    "sensor's own noise can be; other noise: louder than usual, and too rare to be the sensor's; "
    "dropouts: single samples far from all others."
)
#: Unit -> of a noise, a norm at rest and a largest value: what one is, its format and its unit.
_FIELD = {
    "m/s2": ((MG, ".2f", " mg"), (STANDARD_GRAVITY, ".4f", " g"), (STANDARD_GRAVITY, ".2f", " g")),
    "rad/s": ((DEG, ".3f", " deg/s"), (DEG, ".2f", " deg/s"), (DEG, ".1f", " deg/s")),
}
_AS_RECORDED = ((1.0, ".4g", ""), (1.0, ".5g", ""), (1.0, ".4g", ""))
#: What a table is, by what its columns give.
_REFERENCES = {
    "vector": "a table of positions whose inclination and tool-face are known",
    "direction": "a table of positions whose face or direction is known",
    "norm": "a table of readings at rest",
    "plan": "a plan of positions, without readings",
}
#: Bytes in which a file of this program says that it is one.
_OWN = 4096
#: Where what is proposed writes.
_OUT = ("-o", "out")
#: Heading, what it shows, format: of the channels, the columns of a table, candidates.
_CHANNELS: tuple[Column, ...] = (
    ("channel", "name", ""),
    ("unit", "unit", ""),
    ("samples", "samples", "d"),
    ("Hz", "rate_hz", ".4g"),
    ("noise", lambda f: _size(max(f.noise, default=math.nan), f.unit, 0), ">"),
    ("norm at rest", lambda f: _size(f.norm_at_rest, f.unit, 1), ">"),
    ("largest", lambda f: _size(float(np.abs([f.low, f.high]).max()), f.unit, 2), ">"),
)
_COLUMNS: tuple[Column, ...] = (
    ("column", "heading", ""),
    ("taken as", lambda one: one.role.replace("_", "-"), ""),
    ("unit", "unit", ""),
    ("smallest", "smallest", ".6g"),
    ("largest", "largest", ".6g"),
)
_GAPS: tuple[Column, ...] = (
    ("at, s", "start", ".3f"),
    ("length, s", lambda gap: gap.stop - gap.start, ".3f"),
    ("reason", "reason", ""),
)


def compose_inspection_document(
    found: Inspection,
    typed: str,
    *,
    rests: bool = False,
) -> Document:
    """What is in the file, what would be used, what is wrong, and what to do next; on request
    every candidate for a rest.

    typed : the file and the options of its reading, as a command takes them
    """
    losses: list[Block] = [Text(note, "warning") for note in found.losses]
    if found.gap_count:
        losses.append(_gaps(found))
    notes = _merge([n for n in found.notes if n not in found.losses])
    parts = [
        Section("File", (_file(found),)),
        Section(
            "Channels",
            (
                Table.from_columns(
                    _CHANNELS, found.channels, note="Noise of one sample at rest, worst axis."
                ),
            ),
        ),
        Section("Clocks", (_clocks(found),)),
        Section("Rest", _rest(found.still)),
        Section("Candidates for rests", _candidates(found) if rests else (), kept=True),
        Section("Losses and gaps", tuple(losses)),
        Section("Notes", Text.paragraphs(notes)),
        Section("How it was read", (Facts(_options(found)),) if found.mapping else ()),
        Section(
            "Next",
            (*map(Text, next_commands(found, typed)), Facts(tuple(advice(found)))),
            kept=True,
        ),
    ]
    sensors = sum(f.quantity == "acceleration" for f in found.channels)
    still, wrong = found.still.n if found.still else 0, tuple(problems(found))
    summary = f"{sensors} accelerometer{'s' * (sensors != 1)}, "
    summary += f"{still} still segment{'s' * (still != 1)}"
    said = "; ".join(wrong) or "nothing is wrong"
    verdict = Text(f"{summary}; {said}.", "warning" if wrong else "plain")
    return Document(found.path, verdict, tuple(parts), drawn="--html")


def compose_table_document(seen: TableInspection) -> Document:
    """What a table of positions holds, how it would be read, what is wrong, the next command."""
    facts = [("rows", str(seen.rows)), ("file", f"sha256 {seen.sha256[:16]}…")]
    facts += [("readings", seen.readings)] if seen.readings else []
    parts = (
        Section("Table", (Facts(tuple(facts)), Table.from_columns(_COLUMNS, seen.columns))),
        Section("What is wrong", Text.sentences(seen.problems, "warning"), kept=True),
        Section("Notes", Text.paragraphs(seen.notes)),
        Section("Next", Text.paragraphs(seen.next), kept=True),
    )
    wrong = len(seen.problems)
    said = f"{wrong} thing{'s' * (wrong != 1)} to settle" if wrong else "nothing is wrong"
    verdict = Text(
        f"{_REFERENCES[seen.reference].capitalize()}: {seen.rows} rows; {said}.",
        "warning" if wrong else "plain",
    )
    return Document(seen.path, verdict, parts, drawn="--html")


def compose_own_document(path: Path, typed: str) -> tuple[Document, OwnInspection] | None:
    """What a file is that this program wrote, the next command, and the same for machines; None of
    another's file. Raises UnreadableInput where it is damaged."""
    if path.suffix.lower() not in (".yaml", ".yml", ".json"):
        return None
    with path.open("rb") as stream:  # a log of a phone may be as long as it likes
        if b"imucal" not in stream.read(_OWN):
            return None
    content = load(path)
    found = content if isinstance(content, dict) else {}
    kind = str(found.get("schema", ""))
    if kind == "imucal/calibration":
        what = f"A calibration by {found.get('calibrator')}, status {found.get('status')}"
        steps: tuple[str, ...] = (
            f"`imucal validate {typed}`: whether it is whole.",
            f"`imucal export {typed} --to c-header`: its coefficients.",
            f"`imucal apply {typed} RECORDING -o corrected.mcap`: corrects a recording.",
        )
    elif kind.startswith("imucal/"):
        what, page = f"A report of imucal ({kind})", path.with_name("report.html")
        steps = (f"{page} shows it." if page.is_file() else "It is for programs; `--full` prints.",)
    else:
        return None
    section = Section("Next", Text.paragraphs(steps), kept=True)
    document = Document(str(path), Text(f"{what}."), (section,), drawn="--html")
    return document, OwnInspection(str(path), kind, steps)


def table_commands(seen: TableSeen, typed: str) -> tuple[str, ...]:
    """What to type next, and why."""
    if seen.kind == "plan":
        return (
            f"`imucal design {typed}`: judges the plan.",
            f"`imucal lab {typed} --recording LOG -o out`: calibrates, with the log of a recording "
            "that rests in these positions one after another.",
        )
    words = [f"imucal lab {typed}"]
    words += [f"--reference {seen.kind}"] * (seen.kind != "vector")
    zero = seen.table.inclination_zero
    words += [f"--inclination-zero {zero}"] * (zero == "vertical")
    command = " ".join(words)
    asked = (replace(one, options=(*one.options, *_OUT)) for one in seen.wrong if one.options)
    found = [*(decision(one, command) for one in asked)]
    found += [f"{one}." for one in seen.wrong if not one.options]
    local = "add --latitude or --gravity for the local gravity"
    return tuple(found) or (f"`{command} -o out`: calibrates; {local}.",)


class TableColumn(Data):
    """A column that takes part."""

    heading: str
    role: str
    unit: Annotated[str | None, "As the heading states it."]
    smallest: float
    largest: float


class TableInspection(Data, name="inspection/1"):
    """A table of positions as `imucal lab` would read it."""

    path: str
    format: Literal["positions"]
    sha256: str
    reference: Annotated[str, "What its columns give; a plan has angles alone."]
    rows: int
    columns: tuple[TableColumn, ...]
    readings: Annotated[str, "Their unit, and how it is known."]
    problems: tuple[str, ...]
    notes: tuple[str, ...]
    next: Annotated[tuple[str, ...], "What to type, and why."]


class OwnInspection(Data, name="inspection/1"):
    """A file that this program wrote."""

    path: str
    format: Annotated[str, "Its schema."]
    next: Annotated[tuple[str, ...], "What to type, and why."]


class CandidateFacts(Data):
    """A candidate for a rest."""

    start_s: float
    stop_s: float
    length_s: float
    drift: float
    noise: float
    unit: Annotated[str, "Of drift and noise."]
    rest: Annotated[bool, "Whether it is one."]
    reason: Annotated[str, "What refused it; empty for a rest."]


class Gaps(Data):
    """Stretches in which a sensor has no samples."""

    count: int
    seconds: Annotated[float, "In which any sensor has one."]


class NormAtRest(Data):
    """What a channel's norm at rest says."""

    channel: str
    finding: str


class RecordingInspection(Data, name="inspection/1"):
    """A recording: what it holds, how it was read, what is wrong with it, what to type."""

    path: str
    format: str
    sha256: str
    start_ns: Annotated[int | None, "Of the Unix epoch; null where the file does not say."]
    span_s: float
    channels: tuple[ChannelFacts, ...]
    gaps: Gaps
    still_segments: int
    why_not_still: str
    candidates: Annotated[tuple[NormAtRest, ...], "Accelerometers, nearest to gravity first."]
    problems: tuple[str, ...]
    next: Annotated[tuple[str, ...], "What to type, and why."]
    losses: tuple[str, ...]
    mapping: Annotated[Mapping[str, Any], "How it was read, for --mapping."]
    notes: tuple[str, ...]
    rests: Annotated[tuple[CandidateFacts, ...] | None, "With --rests."] = None


def describe_table(seen: TableSeen, typed: str) -> TableInspection:
    """What is known of a table. typed : as for `compose_table_document`"""
    table = seen.table
    columns = (
        TableColumn(
            table.names.get(role, role),
            role,
            table.unit.get(role),
            float(np.min(values)),
            float(np.max(values)),
        )
        for role, values in table.columns.items()
    )
    return TableInspection(
        path=table.path,
        format="positions",
        sha256=table.sha256,
        reference=seen.kind,
        rows=table.n,
        columns=tuple(columns),
        readings=seen.unit,
        problems=tuple(one.what for one in seen.wrong),
        notes=seen.notes,
        next=table_commands(seen, typed),
    )


def describe_recording(found: Inspection, typed: str, *, rests: bool) -> RecordingInspection:
    """What is known of a recording; on request with every candidate for a rest."""
    return RecordingInspection.of(
        found,
        "span_s=span",
        gaps=Gaps(found.gap_count, found.gap_seconds),
        still_segments=found.still.n if found.still else 0,
        candidates=tuple(NormAtRest(*one) for one in found.candidates),
        problems=tuple(problems(found)),
        next=next_commands(found, typed),
        rests=_describe_candidates(found) if rests else None,
    )


def _describe_candidates(found: Inspection) -> tuple[CandidateFacts, ...]:
    unit = "m/s2" if _in_si(found) else "counts"
    times = "start_s=start stop_s=stop length_s=length"
    return tuple(
        CandidateFacts.of(c, times, unit=unit, rest=not c.reason)
        for c in (found.still.candidates if found.still else ())
    )


def _options(found: Inspection) -> tuple[tuple[str, str], ...]:
    """How it was read, by the options that say the same."""
    names, rows = {"\t": "tab", " ": "blanks"}, []
    for key, value in found.mapping.items():
        option = f"--{key.replace('_', '-')}" if f" {key} " in _OPTIONS else key
        text = names.get(str(value), str(value))
        if isinstance(value, list | tuple):
            text = ", ".join(map(str, value))
        rows.append((_RENAMED.get(key, option), text))
    return tuple(rows)


def _merge(notes: list[str]) -> list[str]:
    """Notes that say the same of several sensors as one."""
    same: dict[str, list[tuple[str, str]]] = {}
    for note in notes:
        match = re.fullmatch(r"(\S+): (topic \S+, |)(.*)", note, re.DOTALL)
        name, topic, text = match.groups() if match else ("", "", note)
        same.setdefault(text, []).append((name, topic))
    merged = []
    for text, found in same.items():
        (first, topic), (last, _) = found[0], found[-1]
        name = first if len(found) == 1 else f"{first} to {last} ({len(found)})"
        lead = f"{name}: " + (topic if len(found) == 1 else "") if first else ""
        merged.append(lead + text)
    return merged


def _gaps(found: Inspection) -> Table:
    title = f"{found.gap_count} gap{'s' * (found.gap_count != 1)}, {found.gap_seconds:.3g} s in all"
    title += f"; the longest {len(found.gaps)}" if found.gap_count > len(found.gaps) else ""
    return Table.from_columns(_GAPS, found.gaps, title)


def _rest(still: Segments | None) -> tuple[Table, ...]:
    """Where gravity lay while the sensors were still."""
    if still is None or not still.n:
        return ()
    means = [still.mean[:, k] for k in range(len(still.triads))]
    norms = [float(np.median(np.linalg.norm(mean, axis=1))) for mean in means]
    spans = [
        np.round([mean.min(axis=0) / norm, mean.max(axis=0) / norm], 2) + 0.0
        for mean, norm in zip(means, norms, strict=True)
    ]
    rows = tuple(
        (triad, *(f"{low:+.2f} to {high:+.2f}" for low, high in span.T))
        for triad, span in zip(still.triads, spans, strict=True)
    )
    tones = Table.mark_rows("warning", ((s[0] > -0.5).any() or (s[1] < 0.5).any() for s in spans))
    title = f"{still.n} still segment{'s' * (still.n != 1)}; gravity along each axis, in units of "
    title += "its norm at rest"
    note = "Scale and bias of an axis show only when it has pointed both up and down."
    return (Table(title, ("sensor", "x", "y", "z"), rows, "lrrr", note, tones),)


def _file(found: Inspection) -> Facts:
    start = "not in the file"
    if found.start_ns is not None:
        moment = datetime.fromtimestamp(found.start_ns / 1e9, UTC)
        start = moment.strftime("%Y-%m-%d %H:%M:%S UTC")
    span, sha256 = f"{found.span:.3f} s", f"{found.sha256[:16]}…"
    return Facts((("format", found.format), ("starts", start), ("span", span), ("sha256", sha256)))


def _size(value: float, unit: str, kind: int) -> str:
    """A noise (0), a norm at rest (1) or a largest value (2) in the field's units."""
    if math.isnan(value):
        return "-"
    size, form, name = _FIELD.get(unit, _AS_RECORDED)[kind]
    return f"{value / size:{form}}{name}"


def _clocks(found: Inspection) -> Table:
    """One row for all channels whose clocks did the same."""
    same: dict[tuple[str, ...], list[str]] = {}
    for f in found.channels:
        facts = (
            f"{1e6 * f.jitter_s:.1f}" if math.isfinite(f.jitter_s) else "-",
            f"{1e3 * f.longest_step_s:.2f}",
            str(f.duplicates),
            str(f.back_steps),
        )
        same.setdefault(facts, []).append(f.name)
    rows = []
    for shown, (first, *more) in same.items():
        label = f"{first} + {len(more)}" if more else first
        if len(same) == 1 and more:
            label = ("both" if len(more) == 1 else f"all {len(more) + 1}") + " channels"
        rows.append((label, *shown))
    header = ("channel", "jitter, µs", "longest step, ms", "repeated stamps", "back steps")
    tones = Table.mark_rows("warning", (shown[2:] != ("0", "0") for shown in same))
    return Table("", header, tuple(rows), "lrrrr", tones=tones)


def _candidates(found: Inspection) -> tuple[Block, ...]:
    """Every candidate for a rest in a table and over time, and what refuses those that are none."""
    candidates = found.still.candidates if found.still else ()
    if not candidates:
        return (Text(f"None: {found.why_not_still or refusals(candidates)}.", "warning"),)
    unit, size = ("mg", MG) if _in_si(found) else ("counts", 1.0)
    columns: tuple[Column, ...] = (
        ("start, s", "start", ".2f"),
        ("length, s", "length", ".2f"),
        (f"drift, {unit}", lambda c: c.drift / size, ".2f"),
        (f"noise, {unit}", lambda c: c.noise / size, ".2f"),
        ("", lambda c: c.reason or "rest", ""),
    )
    tones = Table.mark_rows("warning", (bool(c.reason) for c in candidates))
    rests = sum(not c.reason for c in candidates)
    title = f"{rests} rests, {len(candidates) - rests} refused"
    plots = (_over_time(candidates, name, unit, size) for name in ("drift", "noise"))
    return (Table.from_columns(columns, candidates, title, _RESTS, tones), *plots)


def _in_si(found: Inspection) -> bool:
    return {f.unit for f in found.channels if f.quantity == "acceleration"} == {"m/s2"}


def _over_time(candidates: Sequence[Candidate], name: str, unit: str, size: float) -> Plot:
    """Drift or noise of the candidates at their middles, a series a reason."""
    series = []
    for reason in dict.fromkeys(c.reason for c in candidates):
        own = [c for c in candidates if c.reason == reason]
        x = np.array([0.5 * (c.start + c.stop) for c in own])
        y = np.maximum(np.array([getattr(c, name) for c in own]) / size, 1e-3)
        labels = tuple(f"{c.start:.2f} s, {c.length:.2f} s long" for c in own)
        series.append(Series(reason or "rest", x, y, "points", names=labels))
    what = name.capitalize()
    caption = f"{what} of every candidate at its middle, by what became of it."
    labels = (f"{what} over time", "time, s", f"{name}, {unit}")
    return Plot(*labels, tuple(series), caption, log_y=True)
