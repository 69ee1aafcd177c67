"""What changes between power-ups, for every report that has several."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.sessions import Between, Sessions
from imucalib.report.document import Plot, Section, Series, Table, Text, Worth
from imucalib.significant_digits import plus_minus


def power_up_worths(sessions: Sessions | None) -> list[Worth]:
    """How far what changes between power-ups lets a calibration carry."""
    found = dict[str, Worth]()
    for p in sorted(sessions.parameters, key=lambda p: p.half) if sessions else ():
        count = len(sessions.names) if sessions else 0
        detail = f"95 %, worst axis, from {count} sessions; their mean ± {1.96 * p.mean:.2g}"
        found[p.effect] = Worth(f"{p.effect} after a power-up", f"± {p.half:.2g} {p.unit}", detail)
    return list(found.values())


def sessions_section(sessions: Sessions | None) -> Section:
    """What changes between power-ups, and the parameters after the next; empty of one session."""
    if sessions is None:
        return Section("Sessions", ())
    count = len(sessions.names)
    rows = tuple(
        (
            p.name.replace("_", " "),
            plus_minus(p.value, p.mean, p.unit),
            plus_minus(p.value, p.sd, p.unit),
            f"{p.value - p.half:.3g} to {p.value + p.half:.3g}",
        )
        for p in sessions.parameters
    )
    header = ("", f"mean of {count} power-ups", "next power-up", "95 %")
    note = (
        "The calibration states the mean of the power-ups. What changes between them is in the sd "
        "of the next one: used after switching off, it is good to that."
    )
    words = [
        Text(
            f"Between {count} power-ups the {one.effect} scatters by {one.sd:.2g} {one.unit} an "
            f"axis (95 %: {one.interval[0]:.2g} to {one.interval[1]:.2g})."
        )
        for one in sessions.between
    ]
    table = Table("After the next power-up", header, rows, "lrrr", note)
    plots = (_session_plot(one, sessions.names) for one in sessions.between)
    return Section("Sessions", (*words, table, *plots))


def _session_plot(one: Between, names: tuple[str, ...]) -> Plot:
    at = np.arange(1.0, len(names) + 1.0)
    axes = enumerate(zip("xyz", one.offsets.T, one.offsets_sd.T, strict=True))
    series = tuple(
        Series.about(axis, at + 0.08 * (k - 1), off, sd, "bars", names)
        for k, (axis, off, sd) in axes
    )
    title, y_label = f"{one.effect.capitalize()} of each session", f"{one.effect} less the mean"
    caption = "Offset of each power-up from the mean, with its sd."
    return Plot(title, "session", f"{y_label}, {one.unit}", series, caption)
