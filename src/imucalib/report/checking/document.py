"""The report of a check."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imucalib.calibration.checking.check import POWER, SIGNIFICANT, Check, SensorCheck
from imucalib.calibration.checking.e_value import ALPHA
from imucalib.calibration.checking.misfit import FAMILIES
from imucalib.calibration.checking.next_rests import MANY, NextRests
from imucalib.calibration.checking.statistic import ANYTHING
from imucalib.report.checking.card import TONE, check_card
from imucalib.report.checking.words import attitude_words, size_words, verdict_words
from imucalib.report.document import Block, Document, Section, Table, Text, Tone
from imucalib.significant_digits import plus_minus, two_digits
from imucalib.units import MG


def check_document(check: Check, log: str, calibration: str, command: str = "") -> Document:
    """Verdict and card, what changed or could have hidden, every rest, what to record next."""
    tested = _change_table(check, check.sensors)
    array = bool(check.sensors[0].name)
    first = (_each(check) if array else tested,)
    sections = [
        Section("What was tested", first),
        *((Section("Every kind of change", (tested,), brief=False),) if array else ()),
        Section("Readings", tuple(_readings(s) for s in check.sensors), brief=False),
    ]
    if any(s.gyro is not None for s in check.sensors):
        sections.append(Section("Gyroscopes", (_gyros(check),)))
    if check.following is not None:
        sections.append(Section("Record this next", tuple(_following(check, check.following))))
    lines = [*check.noise.words, *check.notes]
    sections.append(Section("Notes", tuple(Text(f"{t[0].upper()}{t[1:]}.") for t in lines)))
    verdict = Text(verdict_words(check), TONE[check.verdict])
    typed = (("command", command),) if command else ()
    footer = (("calibration", calibration), ("log", log), *typed)
    card = check_card(check, command)
    title = f"Check of {calibration} with {log}"
    return Document(title, verdict, tuple(sections), footer, card, drawn="--html")


def _each(check: Check) -> Table:
    """An array's IMUs, a row each."""
    rows = tuple(
        (
            s.name,
            f"{s.p:.2g}",
            size_words(s, "bias").strip(" ()") or "open",
            two_digits(s.seen["bias"]),
        )
        for s in check.sensors
    )
    tones: dict[int, Tone] = {k: "bad" for k, s in enumerate(check.sensors) if s in check.changed}
    limit = check.limits.get("bias")
    note = (
        f"Could see: change of bias, mg, found in {100 * POWER:.0f} % of such checks at a level of "
        f"{100 * ALPHA:.0f} % over all IMUs"
        + ("" if limit is None else f"; limit {limit:.2g} mg, {_how(check)}")
        + "."
    )
    header = ("sensor", "p", "change of bias", "could see")
    return Table("", header, rows, "lrlr", note, tones)


def _how(check: Check) -> str:
    return "as stated" if check.stated else f"{SIGNIFICANT:g} sd of one corrected reading"


def _change_table(check: Check, sensors: Sequence[SensorCheck]) -> Table:
    rows: list[tuple[str, ...]] = []
    tones: dict[int, Tone] = {}
    for sensor in sensors:
        for name, test in sensor.tests.items():
            seen = sensor.seen.get(name, math.nan)
            size = "" if name == ANYTHING else size_words(sensor, name).strip(" ()")
            shown = "-" if math.isnan(seen) else "none" if math.isinf(seen) else two_digits(seen)
            limit = check.limits.get(name)
            unit = FAMILIES.get(name, "")
            if test.p <= ALPHA / len(check.sensors) and sensor in check.changed:
                tones[len(rows)] = "bad"
            rows.append((
                *((sensor.name,) if sensor.name else ()), name, f"{test.p:.2g}", size or "open",
                shown, "-" if limit is None else f"{limit:.2g}", unit,
            ))  # fmt: skip
    named = bool(sensors[0].name)
    header = ("change", "p", "estimate", "could see", "limit", "unit")
    note = (
        f"Could see: change in the direction that shows least, found in {100 * POWER:.0f} % of "
        f"such checks at a level of {100 * ALPHA:.0f} % over all kinds. Limit: {_how(check)}. "
        "A scale of 1 mg/g is a thousandth."
    )
    align = "l" * named + "lrlrrl"
    return Table("", ("sensor", *header) if named else header, tuple(rows), align, note, tones)


def _readings(sensor: SensorCheck) -> Table:
    misfits = sensor.misfits
    sd = np.sqrt(np.diag(misfits.covariance))
    rows: list[tuple[str, ...]] = []
    tones: dict[int, Tone] = {}
    for k, label in enumerate(misfits.label):
        own = np.flatnonzero(misfits.owner == k)
        worst = own[int(np.argmax(np.abs(misfits.value[own]) / sd[own]))]
        z = misfits.value[worst] / sd[worst]
        if abs(z) > 3.0:
            tones[k] = "warning"
        force = misfits.force[k] / np.linalg.norm(misfits.force[k])
        rows.append((
            label, "  ".join(f"{v:+.2f}" for v in force),
            f"{misfits.value[worst] / MG:+.2f}", f"{sd[worst] / MG:.2f}", f"{z:+.1f}",
        ))  # fmt: skip
    what = "largest component" if misfits.directed else "along gravity"
    header = ("reading", "direction", "misfit, mg", "sd, mg", "z")
    note = "Reading minus what the calibration foretells; sd: of an unchanged sensor."
    title = f"Misfits, {what}" + (f" ({sensor.name})" if sensor.name else "")
    return Table(title, header, tuple(rows), "llrrr", note, tones)


def _gyros(check: Check) -> Table:
    rows: list[tuple[str, ...]] = []
    tones: dict[int, Tone] = {}
    for sensor in check.sensors:
        if sensor.gyro is not None:
            if sensor in check.turned_on:
                tones[len(rows)] = "warning"
            each = (
                plus_minus(float(v), float(s))
                for v, s in zip(sensor.gyro.bias, sensor.gyro.sd, strict=True)
            )
            rows.append((sensor.name, *each, f"{sensor.gyro.p:.2g}"))
    note = (
        "Rate at rest beyond the calibrated bias, deg/s; sd by the scatter between rests. "
        "Gyroscopes move at every switching on: it counts as changed beyond a limit only "
        "(--limit 0.5deg/s)."
    )
    return Table("", ("sensor", "x", "y", "z", "p"), tuple(rows), "lrrrr", note, tones)


def _following(check: Check, following: NextRests) -> list[Block]:
    count = len(following.direction)
    rows = tuple((str(k + 1), attitude_words(d)) for k, d in enumerate(following.direction))
    seen = " or ".join(
        f"{'nothing' if math.isinf(v) else two_digits(v)} {FAMILIES[n]} of {n}"
        for n, v in following.seen.items()
    )
    table = Table("", ("rest", "attitude"), rows, "rl", "Up: the axis that then reads +g.")
    if following.enough:
        more = f"{count} more rest{'s' * (count != 1)}" if count > 1 else "One more rest"
        return [Text(f"{more} would decide: together with these they could see {seen}."), table]
    if following.many is not None:
        return [
            Text(
                f"{count} more rests could see {seen}, which is not enough; about "
                f"{following.many}, all round, would be: as many as a new calibration takes, which "
                "also mends what has changed.",
                "warning",
            )
        ]
    return [
        Text(
            f"No recording decides this: {count} more rests could see {seen}, and {MANY[-1]} are "
            "not enough. What the calibration itself does not know is larger: calibrate again, or "
            "accept a wider limit.",
            "warning",
        )
    ]
