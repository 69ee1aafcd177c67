"""The report of `imucal inspect`."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import numpy as np

from imucalib.inspection import ChannelFacts, Inspection
from imucalib.report.document import Block, Document, Facts, Section, Table, Text
from imucalib.units import DEG, MG, STANDARD_GRAVITY


def inspection_document(found: Inspection) -> Document:
    """Channels, clock, rest and losses, and what would be used."""
    usable = bool(found.candidates) and not math.isinf(_first_ratio(found))
    still = found.still.n if found.still else 0
    if usable and still:
        verdict = Text(f"{still} still segments; {found.candidates[0][0]} would be used.", "ok")
    else:
        why = found.why_not_still or (
            found.candidates[0][1] if found.candidates else "no acceleration"
        )
        verdict = Text(f"Not ready for calibration: {why}.", "warning")
    sections = [Section("File", (_file(found),)), Section("Channels", _channels(found))]
    if found.candidates:
        norms = Table("Norm at rest", ("channel", "finding"), tuple(found.candidates), "ll")
        sections.append(Section("Accelerometers", (norms,)))
    notes: list[Block] = [Text(note) for note in found.notes]
    if found.gap_count:
        gaps = tuple((f"{g.start:.3f}", f"{g.stop - g.start:.3f}", g.reason) for g in found.gaps)
        title = f"Longest of {found.gap_count} gaps, {found.gap_seconds:.3g} s in all"
        notes.append(Table(title, ("at, s", "length, s", "reason"), gaps, "rrl"))
    if notes:
        sections.append(Section("Notes", tuple(notes)))
    if found.mapping:
        read = tuple((k, _text(v)) for k, v in found.mapping.items())
        sections.append(Section("How it was read", (Facts(read),)))
    return Document(found.path, verdict, tuple(sections))


def _first_ratio(found: Inspection) -> float:
    first = next(f for f in found.channels if f.name == found.candidates[0][0])
    return 0.0 if first.unit == "m/s2" and not math.isnan(first.norm_at_rest) else math.inf


def _text(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


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


def _shown(values: Any, unit: str) -> str:
    """Noise in the field's units, largest axis."""
    if not len(values):
        return "-"
    worst = float(np.max(values))
    if unit == "m/s2":
        return f"{worst / MG:.2f} mg"
    return f"{worst / DEG:.3f} deg/s" if unit == "rad/s" else f"{worst:.3g}"


def _channels(found: Inspection) -> tuple[Block, ...]:
    channels = tuple(
        (
            f.name,
            f.unit,
            str(f.samples),
            f"{f.clock.rate:.4g}",
            _shown(f.noise, f.unit),
            _norm(f),
        )
        for f in found.channels
    )
    table = Table(
        "Channels",
        ("channel", "unit", "samples", "Hz", "noise", "norm at rest"),
        channels,
        "llrrrr",
        "Noise of one sample at rest, worst axis.",
    )
    clocks = tuple(
        (
            f.name,
            f"{1e6 * f.clock.jitter:.1f}",
            f"{1e3 * f.clock.longest_step:.2f}",
            str(f.clock.duplicates),
            str(f.clock.back_steps),
        )
        for f in found.channels
    )
    header = ("channel", "jitter, µs", "longest step, ms", "repeated stamps", "back steps")
    return table, Table("Clocks", header, clocks, "lrrrr")


def _norm(f: ChannelFacts) -> str:
    if math.isnan(f.norm_at_rest):
        return "-"
    if f.unit == "m/s2":
        return f"{f.norm_at_rest / STANDARD_GRAVITY:.4f} g"
    return f"{f.norm_at_rest / DEG:.2f} deg/s" if f.unit == "rad/s" else f"{f.norm_at_rest:.5g}"


def inspection_dict(found: Inspection) -> dict[str, Any]:
    """Plain types, ready for JSON."""

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
                "longest_step_s": number(f.clock.longest_step),
                "noise": [float(v) for v in f.noise],
                "norm_at_rest": number(f.norm_at_rest),
            }
            for f in found.channels
        ],
        "gaps": {"count": found.gap_count, "seconds": found.gap_seconds},
        "still_segments": found.still.n if found.still else 0,
        "why_not_still": found.why_not_still,
        "candidates": [{"channel": c, "finding": w} for c, w in found.candidates],
        "mapping": dict(found.mapping),
        "notes": list(found.notes),
    }
