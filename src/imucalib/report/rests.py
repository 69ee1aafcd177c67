"""The candidates for rests of a recording: which are rests, and what refuses the others."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.inspection.inspection import Inspection
from imucalib.report.document import Block, Plot, Section, Series, Table, Text, Tone
from imucalib.rests.levels import Candidate, refusals
from imucalib.units import MG

_NOTE = (
    "Drift and noise of the worst axis. Turning: the mean goes further than 0.3 deg, or steadily "
    "by more than 0.025 deg/s, or the gyroscope is off its bias; vibrating: louder than a "
    "sensor's own noise can be; other noise: louder than usual, and too rare to be the sensor's; "
    "dropouts: single samples far from all others."
)


def rests_section(found: Inspection) -> Section:
    """Every candidate in a table and over time."""
    candidates = found.still.candidates if found.still else ()
    if not candidates:
        why = found.why_not_still or refusals(candidates)
        return Section("Candidates for rests", (Text(f"None: {why}.", "warning"),))
    unit = _unit(found)
    rows = tuple(
        (
            f"{c.start:.2f}",
            f"{c.length:.2f}",
            f"{c.drift / _size(unit):.2f}",
            f"{c.noise / _size(unit):.2f}",
            c.reason or "rest",
        )
        for c in candidates
    )
    tones: dict[int, Tone] = {i: "warning" for i, c in enumerate(candidates) if c.reason}
    header = ("start, s", "length, s", f"drift, {unit}", f"noise, {unit}", "")
    rests = sum(not c.reason for c in candidates)
    title = f"{rests} rests, {len(candidates) - rests} refused"
    blocks: list[Block] = [Table(title, header, rows, "rrrrl", _NOTE, tones)]
    blocks += [_over_time(candidates, name, unit) for name in ("drift", "noise")]
    return Section("Candidates for rests", tuple(blocks))


def rests_dict(found: Inspection) -> list[dict[str, Any]]:
    """The candidates in plain types; drift and noise in the accelerometer's unit."""
    candidates = found.still.candidates if found.still else ()
    unit = "m/s2" if _unit(found) == "mg" else "counts"
    return [
        {
            "start_s": c.start,
            "stop_s": c.stop,
            "length_s": c.length,
            "drift": c.drift,
            "noise": c.noise,
            "unit": unit,
            "rest": not c.reason,
            "reason": c.reason,
        }
        for c in candidates
    ]


def _unit(found: Inspection) -> str:
    units = {f.unit for f in found.channels if f.quantity == "acceleration"}
    return "mg" if units == {"m/s2"} else "counts"


def _size(unit: str) -> float:
    return MG if unit == "mg" else 1.0


def _over_time(candidates: tuple[Candidate, ...], name: str, unit: str) -> Plot:
    """Drift or noise of the candidates at their middles, a series a reason."""
    series = []
    for reason in dict.fromkeys(c.reason for c in candidates):
        own = [c for c in candidates if c.reason == reason]
        x = np.array([0.5 * (c.start + c.stop) for c in own])
        y = np.array([getattr(c, name) for c in own]) / _size(unit)
        labels = tuple(f"{c.start:.2f} s, {c.length:.2f} s long" for c in own)
        series.append(Series(reason or "rest", x, np.maximum(y, 1e-3), "points", names=labels))
    caption = f"{name.capitalize()} of every candidate at its middle, by what became of it."
    return Plot(
        f"{name.capitalize()} over time", "time, s", f"{name}, {unit}", tuple(series), caption,
        log_y=True,
    )  # fmt: skip
