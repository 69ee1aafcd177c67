"""What changes between power-ups: each session's own offset, and the parameters after the next."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.lab.sessions.between import Between, Sessions
from imucalib.report.document import Plot, Section, Series, Table, Text
from imucalib.significant_digits import plus_minus


def sessions_section(sessions: Sessions | None) -> Section:
    """Empty where there is one session only."""
    if sessions is None:
        return Section("Sessions", ())
    count = len(sessions.names)
    rows = [
        (p.name.replace("_", " "), plus_minus(p.value, p.mean, p.unit),
         plus_minus(p.value, p.sd, p.unit), f"{p.value - p.half:.3g} to {p.value + p.half:.3g}")
        for p in sessions.parameters
    ]  # fmt: skip
    header = ("", f"mean of {count} power-ups", "next power-up", "95 %")
    table = Table(
        "After the next power-up", header, tuple(rows), "lrrr",
        "What changes between power-ups is in the sd of the next one; a calibration that is used "
        "after switching off is good to that.",
    )  # fmt: skip
    words = tuple(Text(_words(one, count)) for one in sessions.between)
    plots = tuple(_plot(one, sessions.names) for one in sessions.between)
    return Section("Sessions", (*words, table, *plots))


def _words(one: Between, count: int) -> str:
    low, high = one.interval
    what = one.effect
    return (
        f"Between {count} power-ups the {what} scatters by {one.sd:.2g} {one.unit} an axis "
        f"(95 %: {low:.2g} to {high:.2g})."
    )


def _plot(one: Between, names: tuple[str, ...]) -> Plot:
    at = np.arange(1.0, len(names) + 1.0)
    series = tuple(
        Series(
            axis,
            at + 0.08 * (k - 1),
            off,
            "bars",
            low=off - sd,
            high=off + sd,
            names=names,
        )
        for k, (axis, off, sd) in enumerate(
            zip("xyz", one.offsets.T, one.offsets_sd.T, strict=True)
        )
    )
    return Plot(
        f"{one.effect.capitalize()} of each session", "session",
        f"{one.effect} less the mean, {one.unit}", series,
        "Offset of each power-up from the mean, with its sd.",
    )  # fmt: skip
