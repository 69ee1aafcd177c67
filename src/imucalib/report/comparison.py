"""The report of `imucal compare`, as a document and as plain types."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.calibration.comparison.compare import SIGNIFICANT, CalibrationDrift, Comparison, Slope
from imucalib.data import fields, plain
from imucalib.report.plots import band
from imucalib.report.render.document import (
    Card,
    Document,
    Plot,
    Section,
    Series,
    Table,
    Text,
    Worth,
    capital,
)
from imucalib.significant_digits import (
    format_components,
    format_with_sd,
    list_likely,
    per_cent,
    plus_minus,
    two_digits,
)

SCHEMA = "imucal/comparison/1"
#: Columns of single calibrations that a table has room for.
_ROOM = 3
_HALF = 1.959964
_WORTH = {"mg": "force", "deg": "direction", "mm": "place", "deg/s": "rate"}
_VERDICT = {
    "agree": Text("They agree within the limit.", "ok"),
    "differ": Text("They differ by more than the limit.", "bad"),
    "undecided": Text(
        "Undecided: they differ by more than the limit, but each is no surer than that.", "warning"
    ),
}


def compose_comparison_document(
    found: Comparison, paths: Sequence[Path], command: str = ""
) -> Document:
    """Verdict and card, what differs, parameter by parameter, scatter, drift, control chart.

    paths : of the calibrations; command : the line that was typed
    """
    parts = (
        Section("Parameters", (Text(found.basis.words), _parameters(found))),
        Section("Between calibrations", _scatter(found)),
        Section("Drift", _drift(found)),
    )
    count, footer = len(found.names), (("command", command),)
    title = f"Comparison of {', '.join(found.names) if count <= _ROOM else f'{count} calibrations'}"
    card = _compose_card(found, paths, command)
    return Document(
        title, _VERDICT[found.verdict], parts, footer[: bool(command)], card, drawn="--html"
    )


def _how(found: Comparison) -> str:
    """Where the limit comes from."""
    return "as stated" if found.stated else f"{SIGNIFICANT:g} times the largest stated sd"


def _compose_card(found: Comparison, paths: Sequence[Path], command: str) -> Card:
    """To how much the calibrations agree, what shows, and what to do."""
    worths, several = [], len(found.names) > 2
    for worst in found.meanings:
        unit = worst.unit
        size = plus_minus(worst.value, worst.sd) if worst.sd > 0.0 else two_digits(worst.value)
        limit = f"limit {worst.limit:.2g} {unit}, {_how(found)}"
        pair = f" between {' and '.join(found.names[k] for k in worst.pair)}" * several
        detail = f"at most{pair}, where the force is {format_components(worst.attitude)}; {limit}"
        sensor = f", {worst.sensor}" if worst.sensor else ""
        worths.append(Worth(f"difference of {_WORTH[unit]}{sensor}", f"{size} {unit}", detail))
    named = list_likely(found.differing) if found.differ else ""
    words = (
        f"The files differ by {'more' if found.differ else 'no more'} than they state "
        f"({per_cent(found.agreement.answer.nothing)} that nothing does){named and ': '}{named}."
    )
    said = [Text(words, _VERDICT[found.verdict].tone)]
    if found.odd:
        said.append(Text(f"Unlike the others: {', '.join(found.odd)}.", "warning"))
    if found.drift is not None:
        said.append(_due(found.drift))
    said += Text.sentences(found.notes, "warning")
    steps, chart = _to_do(found, paths), _control_chart(found)
    return Card(tuple(worths), tuple(said), steps, command, picture=chart)


def _to_do(found: Comparison, paths: Sequence[Path]) -> tuple[str, ...]:
    if found.verdict == "undecided":
        return (
            "Calibrate from more positions; this says which: `imucal design --recommend 24`.",
            "Or accept a wider limit (--limit).",
        )
    if found.verdict == "differ":
        first = dict(zip(found.names, paths, strict=True))[(*found.odd, found.names[-1])[0]]
        return (
            "Record four rests to find out which holds, then check each with them: "
            f"`imucal check {shlex.quote(str(first))} RESTS`.",
            "Correct every recording with the calibration that is nearest to it in time.",
        )
    steps = [f"Go on with any of them; {found.names[-1]} is the last that was named."]
    if found.drift is not None and math.isfinite(found.drift.due.expected):
        steps.insert(0, "Calibrate again before the limit is reached.")
    return tuple(steps)


def _parameters(found: Comparison) -> Table:
    basis, fit, count = found.basis, found.agreement, len(found.names)
    sd = np.sqrt(np.einsum("kii->ki", basis.covariance))
    worst = np.argmax(np.abs(fit.z), axis=0) if count > 2 else np.full(fit.z.shape[1], -1)
    z = np.take_along_axis(fit.z, worst[None], axis=0)[0]
    rows = tuple(
        (
            name if unit == "1" else f"{name}, {unit}",
            *map(plus_minus, basis.value[:_ROOM, k], sd[:_ROOM, k]),
            f"{z[k]:+.1f}",
        )
        for k, (name, unit) in enumerate(zip(basis.names, basis.units, strict=True))
    )
    note = "z: the last minus the first over the sd of the difference."
    if count > 2:
        note = "z: the largest of one against the mean of the others."
    if count > _ROOM:
        note += f" Shown are the first {_ROOM} of {count}; all are in the JSON."
    header = ("parameter", *found.names[:_ROOM], "z")
    return Table("", header, rows, "", note, Table.mark_rows("warning", np.abs(z) > 3.0))


def _scatter(found: Comparison) -> tuple[Text | Table, ...]:
    scatter, basis = found.scatter, found.basis
    if scatter is None:
        return ()
    columns = (basis.names, basis.units, scatter.sd, scatter.low, scatter.high, scatter.z_rms)
    rows = tuple(
        (name, two_digits(sd), f"{two_digits(low)} to {two_digits(high)}", f"{z:.2f}", unit)
        for name, unit, sd, low, high, z in zip(*columns, strict=True)
    )
    note = (
        "sd: between calibrations, beyond what each states (Paule and Mandel); 95 % interval by "
        "its χ²; z rms: 1 where the scatter is what they state."
    )
    z = found.agreement.z_rms
    said = f"All parameters together: z rms {z:.2f}, where 1 is what the files state."
    said += " A single calibration is worth less than its sd says." if found.differ else ""
    table = Table("", ("parameter", "sd", "95 %", "z rms", "unit"), rows, "lrrrl", note)
    return Text(said, "warning" if found.differ else "plain"), table


def _drift(found: Comparison) -> tuple[Text | Table, ...]:
    drift, basis = found.drift, found.basis
    if drift is None:
        return ()
    rows = tuple(
        (name, *format_with_sd(s.value, s.half), f"{unit}/day")
        for name, unit, s in zip(basis.names, basis.units, drift.slopes, strict=True)
    )
    tones = Table.mark_rows("warning", (s.shown for s in drift.slopes))
    table = Table("", ("parameter", "drift", "± 95 %", "unit"), rows, "lrrl", "", tones)
    return Text(f"{capital(drift.dates.words)}."), table


def _due(drift: CalibrationDrift) -> Text:
    """Whether a drift shows, and when the limit is reached."""
    due, last = drift.due, float(drift.dates.days.max())

    def day(after: float) -> str:
        far = last + after > 36500.0
        return "a day more than a century away" if far else _day(drift, last + after)

    early = "at no time by these dates"
    if math.isfinite(due.earliest):
        early = f"at the earliest on {day(due.earliest)}"
    if not math.isfinite(due.expected):
        words = (
            f"No drift shows. The next calibration is due {early}: until then these dates exclude "
            f"that the limit of {due.limit:.2g} {due.unit} is reached."
        )
        return Text(words)
    words = (
        f"The corrected force drifts by {plus_minus(due.slope.value, due.slope.half)} (95 %) "
        f"{due.unit} a day at its worst attitude ({format_components(due.attitude)}): the limit of "
        f"{due.limit:.2g} {due.unit} is reached on {day(due.expected)}, {early}."
    )
    return Text(words, "warning")


def _day(drift: CalibrationDrift, days: float) -> str:
    return (drift.dates.start + timedelta(days=days)).strftime("%Y-%m-%d")


def _control_chart(found: Comparison) -> Plot | None:
    """Size of the corrected force at the attitude where the calibrations differ most, against time
    or their order, with its sd and the limit; none where no force was compared."""
    force = next((m for m in found.meanings if m.unit == "mg"), None)
    if force is None:
        return None
    seen = found.seen[force.sensor]
    at = int(np.argmax(seen.attitude @ force.attitude))
    value, sd = seen.size[:, at], seen.size_sd[:, at]
    weight = 1.0 / sd**2
    level = float(weight @ value / weight.sum())
    days = None if found.drift is None else found.drift.dates.days
    x = np.arange(1.0, len(value) + 1.0) if days is None else days
    ends = np.array([x.min(), x.max()])
    series = (
        band("limit about the mean", x, force.limit, level),
        Series("mean", ends, np.full(2, level), "line"),
        Series.from_half("calibrations, 95 %", x, value, _HALF * sd, "points", tuple(found.names)),
    )
    where = ", ".join(f"{v:+.2f}" for v in force.attitude)
    caption = (
        f"The attitude that differs most, force along ({where}): points outside the band have left "
        "the limit about the mean of all; whiskers are 95 % by what each calibration states."
    )
    title = "Control chart" + (f" of {force.sensor}" if force.sensor else "")
    x_label = "calibration" if days is None else "days since the first"
    return Plot(title, x_label, "|f| against the first, mg", series, caption)


def comparison_dict(found: Comparison) -> dict[str, Any]:
    """Ready for JSON; what does not exist is null."""
    fit, basis, between, drift = found.agreement, found.basis, found.scatter, found.drift
    worst = [
        {
            **fields(m, "difference=value sd unit limit beyond sensor"),
            "pair": [found.names[k] for k in m.pair],
            "attitude": m.attitude,
        }
        for m in found.meanings
    ]
    parameters = []
    for k, (name, unit) in enumerate(zip(basis.names, basis.units, strict=True)):
        one: dict[str, Any] = {"name": name, "unit": unit, "value": basis.value[:, k]}
        one |= {"sd": np.sqrt(basis.covariance[:, k, k]), "z": fit.z[:, k]}
        one |= {"mean": fit.mean[k], "mean_sd": fit.mean_sd[k]}
        if between is not None:
            interval = [between.low[k], between.high[k]]
            one |= {"between_sd": between.sd[k], "between_95": interval, "z_rms": between.z_rms[k]}
        if drift is not None:
            own = drift.slopes[k]
            one |= {"per_day": own.value, "per_day_95": _interval(own)}
        parameters.append(one)
    content = {
        "schema": SCHEMA,
        **fields(found, "calibrations=names verdict exit_code basis=basis.words"),
        "as_stated": fit.answer.nothing,
        "differing": found.differing,
        **fields(fit, "chi2 dof z_rms"),
        "differ_from_the_others": found.odd,
        "probability_of_each_file": [fit.differs(k) for k in range(len(found.names))],
        "limits_stated": found.stated,
        "worst": worst,
        "parameters": parameters,
        "drift": drift and _drift_dict(drift),
        "notes": found.notes,
    }
    return dict(plain(content))


def _drift_dict(drift: CalibrationDrift) -> dict[str, Any]:
    due, slope, last = drift.due, drift.due.slope, float(drift.dates.days.max())
    reached, earliest = (
        _day(drift, last + after) if after < 36500.0 else None
        for after in (due.expected, due.earliest)
    )
    return {
        **fields(drift, "dates_from=dates.words days=dates.days per_day=due.slope.value"),
        "per_day_95": _interval(slope),
        **fields(due, "unit attitude limit"),
        "reached": reached,
        "earliest": earliest,
    }


def _interval(slope: Slope) -> list[float]:
    return [slope.value - slope.half, slope.value + slope.half]
