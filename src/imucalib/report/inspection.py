"""The report of `imucal inspect`."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from imucalib.inspection.inspection import ChannelFacts, Inspection, advice, problems
from imucalib.inspection.noise import SensorNoise
from imucalib.report.document import Block, Document, Facts, Section, Table, Text, Tone
from imucalib.report.noise import noise_dict, noise_section
from imucalib.report.rests import rests_dict, rests_section
from imucalib.rests.segments import Segments
from imucalib.units import DEG, MG, STANDARD_GRAVITY

_CAUTION: Tone = "warning"
#: Fields of a mapping that have an option of their own.
_OPTIONS = {
    "acc", "gyro", "temperature", "time", "gyro_unit", "temperature_unit", "time_unit",
    "rate", "axis_map", "preset", "acc_offset", "skip", "decimal", "delimiter",
}  # fmt: skip
_RENAMED = {"acc_unit": "--unit", "lsb_per_g": "--lsb", "lsb_per_dps": "--gyro-lsb"}


def inspection_document(
    found: Inspection, *, rests: bool = False, noise: Sequence[SensorNoise] | None = None
) -> Document:
    """What is in the file, what would be used, what is wrong, and what to do next; on request
    every candidate for a rest, and the noise of what is still."""
    sections = [
        Section("File", (_file(found),)),
        Section("Channels", (_channels(found),)),
        Section("Clocks", (_clocks(found),)),
    ]
    if found.still is not None and found.still.n:
        sections.append(Section("Rest", (_rest(found.still),)))
    if rests:
        sections.append(replace(rests_section(found), kept=True))
    if noise is not None:
        sections.append(replace(noise_section(noise), kept=True))
    losses: list[Block] = [Text(note, "warning") for note in found.losses]
    if found.gap_count:
        losses.append(_gaps(found))
    if losses:
        sections.append(Section("Losses and gaps", tuple(losses)))
    notes = tuple(map(Text, _merged([n for n in found.notes if n not in found.losses])))
    if notes:
        sections.append(Section("Notes", notes))
    if found.mapping:
        sections.append(Section("How it was read", (Facts(_options(found)),)))
    sections.append(Section("Next", (Facts(advice(found)),), kept=True))
    return Document(found.path, _verdict(found), tuple(sections), drawn="--html")


def _verdict(found: Inspection) -> Text:
    sensors = [f for f in found.channels if f.quantity == "acceleration"]
    still = found.still.n if found.still else 0
    plural = "s" if len(sensors) != 1 else ""
    summary = f"{len(sensors)} accelerometer{plural}, {still} still segment{'s' * (still != 1)}"
    wrong = problems(found)
    if wrong:
        return Text(f"{summary}; {'; '.join(wrong)}.", "warning")
    return Text(f"{summary}; nothing is wrong.", "plain")


def _options(found: Inspection) -> tuple[tuple[str, str], ...]:
    rows = []
    for key, value in found.mapping.items():
        option = f"--{key.replace('_', '-')}" if key in _OPTIONS else key
        rows.append((_RENAMED.get(key, option), _text(value)))
    return tuple(rows)


def _text(value: object) -> str:
    names = {"\t": "tab", " ": "blanks"}
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value))
    return names.get(str(value), str(value))


def _merged(notes: list[str]) -> list[str]:
    """Notes that say the same of several sensors as one."""
    alike: dict[str, list[tuple[str, str]]] = {}
    for note in notes:
        match = re.fullmatch(r"(\S+): (topic \S+, |)(.*)", note, re.DOTALL)
        name, topic, text = match.groups() if match else ("", "", note)
        alike.setdefault(text, []).append((name, topic))
    merged = []
    for text, found in alike.items():
        (first, topic), (last, _) = found[0], found[-1]
        name = first if len(found) == 1 else f"{first} to {last} ({len(found)})"
        lead = f"{name}: " + (topic if len(found) == 1 else "") if first else ""
        merged.append(lead + text)
    return merged


def _gaps(found: Inspection) -> Table:
    rows = tuple((f"{g.start:.3f}", f"{g.stop - g.start:.3f}", g.reason) for g in found.gaps)
    title = f"{found.gap_count} gap{'s' * (found.gap_count != 1)}, {found.gap_seconds:.3g} s in all"
    if found.gap_count > len(rows):
        title += f"; the longest {len(rows)}"
    return Table(title, ("at, s", "length, s", "reason"), rows, "rrl")


def _rest(still: Segments) -> Table:
    """Where gravity lay while the sensors were still."""
    rows: list[tuple[str, ...]] = []
    tones: dict[int, Tone] = {}
    for i, triad in enumerate(still.triads):
        mean = still.mean[:, i]
        unit = float(np.median(np.linalg.norm(mean, axis=1)))
        low, high = np.round([mean.min(axis=0) / unit, mean.max(axis=0) / unit], 2)
        ends = (f"{a:+.2f} to {b:+.2f}" for a, b in zip(low + 0.0, high + 0.0, strict=True))
        rows.append((triad, *ends))
        if (low > -0.5).any() or (high < 0.5).any():
            tones[i] = _CAUTION
    title = f"{still.n} still segments; gravity along each axis, in units of its norm at rest"
    note = "Scale and bias of an axis show only when it has pointed both up and down."
    return Table(title, ("sensor", "x", "y", "z"), tuple(rows), "lrrr", note, tones)


def _file(found: Inspection) -> Facts:
    start = "not in the file"
    if found.start_ns is not None:
        moment = datetime.fromtimestamp(found.start_ns / 1e9, UTC)
        start = moment.strftime("%Y-%m-%d %H:%M:%S UTC")
    return Facts(
        (
            ("format", found.format),
            ("starts", start),
            ("span", f"{found.span:.3f} s"),
            ("sha256", found.sha256[:16] + "…"),
        )
    )


def _scaled(value: float, unit: str, fine: bool) -> str:
    """In the field's units: g or mg, deg/s."""
    if unit == "m/s2":
        return f"{value / MG:.2f} mg" if fine else f"{value / STANDARD_GRAVITY:.2f} g"
    digits = 3 if fine else 1
    return f"{value / DEG:.{digits}f} deg/s" if unit == "rad/s" else f"{value:.4g}"


def _channels(found: Inspection) -> Table:
    rows = tuple(
        (
            f.name,
            f.unit,
            str(f.samples),
            f"{f.clock.rate:.4g}" if math.isfinite(f.clock.rate) else "-",
            _scaled(float(f.noise.max()), f.unit, True) if len(f.noise) else "-",
            _norm(f),
            _scaled(float(np.abs([f.low, f.high]).max()), f.unit, False),
        )
        for f in found.channels
    )
    header = ("channel", "unit", "samples", "Hz", "noise", "norm at rest", "largest")
    return Table("", header, rows, "llrrrrr", "Noise of one sample at rest, worst axis.")


def _clocks(found: Inspection) -> Table:
    """One row for all channels whose clocks did the same."""
    alike: dict[tuple[str, ...], list[str]] = {}
    for f in found.channels:
        facts = (
            f"{1e6 * f.clock.jitter:.1f}" if math.isfinite(f.clock.jitter) else "-",
            f"{1e3 * f.clock.longest_step:.2f}",
            str(f.clock.duplicates),
            str(f.clock.back_steps),
        )
        alike.setdefault(facts, []).append(f.name)
    rows: list[tuple[str, ...]] = []
    tones: dict[int, Tone] = {}
    for i, (shown, names) in enumerate(alike.items()):
        every = len(alike) == 1 and len(names) > 1
        label = ("both" if len(names) == 2 else f"all {len(names)}") + " channels"
        label = label if every else names[0]
        rows.append((label if every or len(names) == 1 else f"{label} + {len(names) - 1}", *shown))
        if shown[2:] != ("0", "0"):
            tones[i] = _CAUTION
    header = ("channel", "jitter, µs", "longest step, ms", "repeated stamps", "back steps")
    return Table("", header, tuple(rows), "lrrrr", tones=tones)


def _norm(f: ChannelFacts) -> str:
    if math.isnan(f.norm_at_rest):
        return "-"
    if f.unit == "m/s2":
        return f"{f.norm_at_rest / STANDARD_GRAVITY:.4f} g"
    return f"{f.norm_at_rest / DEG:.2f} deg/s" if f.unit == "rad/s" else f"{f.norm_at_rest:.5g}"


def inspection_dict(
    found: Inspection, *, rests: bool = False, noise: Sequence[SensorNoise] | None = None
) -> dict[str, Any]:
    """Plain types, ready for JSON; on request with every candidate for a rest, and the noise."""

    def number(value: float) -> float | None:
        return value if math.isfinite(value) else None

    return {
        "schema": "imucal/inspection/1",
        "path": found.path,
        "format": found.format,
        "sha256": found.sha256,
        "start_ns": found.start_ns,
        "span_s": found.span,
        "channels": [
            {
                "name": f.name,
                "quantity": f.quantity,
                "triad": f.triad,
                "unit": f.unit,
                "samples": f.samples,
                "rate_hz": number(f.clock.rate),
                "jitter_s": number(f.clock.jitter),
                "duplicates": f.clock.duplicates,
                "back_steps": f.clock.back_steps,
                "names": list(f.names),
                "longest_step_s": number(f.clock.longest_step),
                "noise": [float(v) for v in f.noise],
                "norm_at_rest": number(f.norm_at_rest),
            }
            for f in found.channels
        ],
        "gaps": {"count": found.gap_count, "seconds": found.gap_seconds},
        "still_segments": found.still.n if found.still else 0,
        "why_not_still": found.why_not_still,
        **({"rests": rests_dict(found)} if rests else {}),
        **({} if noise is None else {"noise": noise_dict(noise)}),
        "candidates": [{"channel": c, "finding": w} for c, w in found.candidates],
        "problems": list(problems(found)),
        "losses": list(found.losses),
        "mapping": dict(found.mapping),
        "notes": list(found.notes),
    }
