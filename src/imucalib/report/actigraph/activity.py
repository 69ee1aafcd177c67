"""What the calibration does to what is made of the recording, and the field's rule beside it."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.actigraph.run import ActigraphRun
from imucalib.exports.per_axis import nearest_row
from imucalib.report.document import Block, Facts, Plot, Section, Series, Table
from imucalib.units import MG


def activity_section(run: ActigraphRun) -> Section:
    """Wear, ENMO and |a| at night, before and after; empty where the samples were not seen."""
    found = run.activity
    if found is None:
        return Section("Wear and activity", ())
    wear = found.wear
    night = "cannot be named: too little of a day was seen"
    if found.night is not None:
        night = f"{_clock(found.night[0])} to {_clock(found.night[1])}, the least active five hours"
    off = ", ".join(f"{a / 3600:.2f} to {b / 3600:.2f} h" for a, b in wear.off[:4])
    if len(wear.off) > 4:
        off += f" and {len(wear.off) - 4} more"
    facts = Facts((
        ("worn", f"{wear.worn:.1f} of {wear.hours:.1f} h"),
        ("not worn", f"{off}, from the start" if off else "never an hour in a row"),
        ("night", night),
    ))  # fmt: skip
    rows = [(f"ENMO, {name}", f"{a:.2f}", f"{b:.2f}", f"{b - a:+.2f}")
            for name, (a, b) in found.enmo.items()]  # fmt: skip
    if found.night_runs:
        a, b = found.night_error
        name = f"error of |a| at rest, night ({found.night_runs} runs)"
        rows.append((name, f"{a:.2f}", f"{b:.2f}", f"{b - a:+.2f}"))
    note = (
        "ENMO: mean of max(|a| - 1 g, 0) over the samples of worn time. The error at rest is held "
        "out: each run predicted without its block of time."
    )
    header = ("mg", "raw", "corrected", "change")
    table = Table("Before and after", header, tuple(rows), "lrrr", note)
    blocks: tuple[Block, ...] = (facts, table, _profile(found.profile))
    return Section("Wear and activity", blocks)


def _clock(seconds: float) -> str:
    return f"{int(seconds // 3600):02d}:{int(seconds % 3600 // 60):02d}"


def _profile(profile: Array) -> Plot:
    hour, ends = np.arange(25.0), np.concatenate([profile, profile[-1:]])
    series = (
        Series("raw", hour, ends[:, 0], "step"),
        Series("corrected", hour, ends[:, 1], "step"),
    )
    caption = "Mean of each hour of the recording's clock, worn time."
    return Plot("ENMO over the day", "hour of the day (h)", "ENMO (mg)", series, caption)


def rule_section(run: ActigraphRun) -> Section:
    """Our coefficients in GGIR's form beside those of its own rule; empty without windows."""
    rule = run.rule
    if rule is None:
        return Section("Beside GGIR's rule", ())
    row = nearest_row(run.calibration)
    rows = [
        (f"{name} {axis}", f"{ours[k]:.5f}", f"{theirs[k]:.5f}", f"{ours[k] - theirs[k]:+.5f}")
        for name, ours, theirs in (("scale", row.scale, rule.scale),
                                   ("offset", row.offset, rule.offset))
        for k, axis in enumerate("xyz")
    ]  # fmt: skip
    note = (
        "corrected = scale (raw + offset), g. Ours: the row that `--export ggir-csv` writes, "
        f"nearest to the whole calibration, which it misses by {row.lost:.2f} mg on average."
    )
    table = Table("Six coefficients", ("", "imucal", "GGIR's rule", "difference"), tuple(rows),
                  "lrrr", note)  # fmt: skip
    fitted = np.mean(np.abs(rule.norm_error(run.runs.mean))) / MG
    held = run.outcome.error.held_out.final
    words = [
        ("windows of its rule", f"{rule.points}, {rule.before:.2f} mg before, {rule.after:.2f} mg "
         "after, on the windows that were fitted"),
        ("on the posture runs", f"{fitted:.2f} mg with its coefficients, which have seen them; "
         f"{held:.2f} mg with ours on time held out"),
    ]  # fmt: skip
    if not rule.enough:
        words.append(("its own condition", "not met: an axis has not seen both signs of 0.3 g"))
    return Section("Beside GGIR's rule", (table, Facts(tuple(words))), brief=False)
