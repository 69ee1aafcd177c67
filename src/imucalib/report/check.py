"""The report of `imucal check`, as a document and as plain types."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.checking.check import ALPHA, POWER, SIGNIFICANT, Check, SensorCheck
from imucalib.calibration.checking.next_rests import MANY, NextRests
from imucalib.calibration.checking.noise import FAMILIES
from imucalib.calibration.checking.statistic import ANYTHING, DRAWS
from imucalib.calibration.plain import fields, plain
from imucalib.report.document import Block, Card, Document, Section, Table, Text, Tone, Worth
from imucalib.significant_digits import plus_minus, probability, two_digits
from imucalib.units import MG

SCHEMA = "imucal/check/1"
_TONE: dict[str, Tone] = {"still good": "ok", "changed": "bad", "undecided": "warning"}
_HEADLINE = {
    "still good": "Still good.",
    "changed": "The sensor is not what the calibration says.",
    "undecided": "Undecided: these readings are too few, or one of them is off.",
}
#: Rests that a card names.
_RESTS = 6


def check_document(check: Check, log: Path, calibration: Path, command: str = "") -> Document:
    """Verdict and card, what changed or could have hidden, every rest, what to record next.

    command : the line that was typed
    """
    tested, array = _change_table(check), bool(check.sensors[0].name)
    parts = [
        Section("What was tested", (_each(check) if array else tested,)),
        Section("Every kind of change", (tested,) if array else (), brief=False),
        Section("Readings", tuple(_readings(s) for s in check.sensors), brief=False),
        Section("Gyroscopes", _gyros(check)),
        Section("Record this next", _following(check.following) if check.following else ()),
    ]
    lines = (f"{t[0].upper()}{t[1:]}." for t in (*check.noise.words, *check.notes))
    parts.append(Section("Notes", tuple(map(Text, lines))))
    typed = (("command", command),) if command else ()
    footer = (("calibration", str(calibration)), ("log", str(log)), *typed)
    title = f"Check of {calibration.name} with {log.name}"
    card = _card(check, calibration, command)
    return Document(title, _verdict(check), tuple(parts), footer, card, drawn="--html")


def _how(check: Check) -> str:
    """Where the limits come from."""
    return "as stated" if check.stated else f"{SIGNIFICANT:g} sd of one corrected reading"


def _of(sensor: SensorCheck) -> str:
    """The name of one of several sensors, to lead a sentence."""
    return f"{sensor.name}: " if sensor.name else ""


def _verdict(check: Check) -> Text:
    """The headline."""
    lead, tone = f"(p {probability(check.p, DRAWS)})", _TONE[check.verdict]
    if check.verdict == "changed":
        return Text(f"Changed {lead}: {'; '.join(_changes(check))}.", tone)
    sizes = {name: max(s.seen[name] for s in check.sensors) for name in check.limits}
    seen = " or ".join(
        f"{'no' if math.isinf(size) else f'{two_digits(size)} {FAMILIES[name]} of'} {name}"
        for name, size in sizes.items()
    )
    if check.disturbed:
        odd = (
            f"{_of(s)}{s.misfits.label[s.alone]}" for s in check.disturbed if s.alone is not None
        )
        words = (
            f"Undecided {lead}: only {' and '.join(odd)} does not belong to the others; without "
            "it nothing shows. Hold that attitude again."
        )
    elif check.verdict == "undecided":
        short = " or ".join(
            f"{limit:.2g} {FAMILIES[name]} of {name}"
            for name, limit in check.limits.items()
            if sizes[name] > limit
        )
        words = (
            f"Undecided {lead}: nothing shows, but these readings could not have shown a change of "
            f"{short}; they could see {seen}."
        )
    else:
        words = (
            f"Still good {lead}: a change of {seen} would have been found in {100 * POWER:.0f} % "
            "of such checks."
        )
    return Text(words, tone)


def _card(check: Check, calibration: Path, command: str) -> Card:
    """What it could have seen; what shows, and the reading that fits least; what to do."""
    worths = []
    for name, limit in check.limits.items():
        size, unit = max(s.seen[name] for s in check.sensors), FAMILIES[name]
        shown = "no size" if math.isinf(size) else f"{two_digits(size)} {unit}"
        detail = f"seen by {100 * POWER:.0f} % of such checks; limit {limit:.2g} {unit}"
        worths.append(Worth(f"see a change of {name}", shown, f"{detail}, {_how(check)}"))
    lines = [Text(f"{said[0].upper()}{said[1:]}.", "bad") for said in _changes(check)]
    for sensor in check.disturbed:
        if sensor.alone is not None:
            label = f"{_of(sensor)}{sensor.misfits.label[sensor.alone]}"
            lines.append(Text(f"{label} does not belong to the others.", "warning"))
    if not lines:
        words = "Nothing shows: the readings are as the calibration foretells them."
        lines.append(Text(words, "ok" if check.verdict == "still good" else "plain"))
    if moved := [s.name or "the gyroscope" for s in check.turned_on if s not in check.drifted]:
        words = f"The gyroscope's bias of {', '.join(moved)} moved, as at every switching on."
        lines.append(Text(words))
    steps = _to_do(check, shlex.quote(str(calibration)))
    headline = _HEADLINE[check.verdict]
    return Card(tuple(worths), tuple(lines), steps, command, headline=headline)


def _to_do(check: Check, calibration: str) -> tuple[str, ...]:
    if check.verdict == "changed":
        return (
            "Calibrate again; recordings since the last good check are in doubt.",
            f"See then what has changed: `imucal compare {calibration} NEW`.",
        )
    if check.disturbed:
        return ("Hold that attitude again, and check all readings together.",)
    following = check.following
    if check.verdict == "undecided" and following is not None and following.enough:
        rests = "; ".join(_attitude(np.asarray(d)) for d in following.direction[:_RESTS])
        more = "; ..." if len(following.direction) > _RESTS else ""
        return (f"Record these rests too, and check all of them together: {rests}{more}.",)
    if check.verdict == "undecided":
        many = None if following is None else following.many
        lead = "No recording decides this" if many is None else f"It would take about {many} rests"
        return (f"{lead}: calibrate again, or accept a wider limit (--limit).",)
    return (f"Go on with it: `imucal apply {calibration} RECORDING -o corrected.mcap`.",)


def _changes(check: Check) -> list[str]:
    """What changed, sensor by sensor."""
    said = [f"{_of(s)}{_causes(s)}" for s in check.changed]
    for sensor in check.drifted:
        assert sensor.gyro is not None
        axis = int(np.argmax(np.abs(sensor.gyro.bias)))
        size = plus_minus(sensor.gyro.bias[axis], sensor.gyro.sd[axis], "deg/s")
        said.append(f"{sensor.name}: the gyroscope's bias {'xyz'[axis]} moved by {size}")
    return said


def _causes(sensor: SensorCheck) -> str:
    if not sensor.causes:
        kinds = [name for name in sensor.tests if name != ANYTHING]
        text = f"neither {' nor '.join(kinds)} alone explains it, "
        if sensor.together is None:
            return text + "and these are too few readings to tell more"
        return text + ("all together do" if sensor.together else "nor do all together")
    named = []
    for name in sensor.causes:
        size = _size(sensor, name)
        named.append((name, f" ({size})" if size else ""))
    (name, size), *rest = named
    first = f"the {name} has changed{size}"
    if not rest:
        return first
    others = ", or ".join(f"the {name}{size}" for name, size in rest)
    return f"{first}, or {others}: these readings cannot tell them apart"


def _size(sensor: SensorCheck, name: str) -> str:
    """Each axis with its sd; nothing where it is open."""
    test = sensor.tests[name]
    if np.isnan(test.size).any():
        return ""
    axes = zip("xyz", test.size, test.sd, strict=True)
    each = ", ".join(f"{axis} {plus_minus(v, s)}" for axis, v, s in axes)
    return f"{each} {FAMILIES[name]}".strip()


def _attitude(direction: Array) -> str:
    """An attitude of the hand: "+z up", "edge +x -y up"."""
    axes = [f"{'+' if v > 0 else '-'}{'xyz'[k]}" for k, v in enumerate(direction) if abs(v) > 0.1]
    return f"{('', 'edge ', 'corner ')[len(axes) - 1]}{' '.join(axes)} up"


def _each(check: Check) -> Table:
    """An array's IMUs, a row each."""
    rows = tuple(
        (s.name, f"{s.p:.2g}", _size(s, "bias") or "open", two_digits(s.seen["bias"]))
        for s in check.sensors
    )
    tones: dict[int, Tone] = {k: "bad" for k, s in enumerate(check.sensors) if s in check.changed}
    limit = check.limits.get("bias")
    more = "" if limit is None else f"; limit {limit:.2g} mg, {_how(check)}"
    note = (
        f"Could see: change of bias, mg, found in {100 * POWER:.0f} % of such checks at a level of "
        f"{100 * ALPHA:.0f} % over all IMUs{more}."
    )
    header = ("sensor", "p", "change of bias", "could see")
    return Table("", header, rows, "lrlr", note, tones)


def _change_table(check: Check) -> Table:
    sensors, named = check.sensors, bool(check.sensors[0].name)
    tones: dict[int, Tone] = {}
    rows: list[tuple[str, ...]] = []
    for sensor, name in ((s, name) for s in sensors for name in s.tests):
        test, limit = sensor.tests[name], check.limits.get(name)
        seen = sensor.seen.get(name, math.nan)
        size = "" if name == ANYTHING else _size(sensor, name)
        shown = "-" if math.isnan(seen) else "none" if math.isinf(seen) else two_digits(seen)
        if test.p <= ALPHA / len(sensors) and sensor in check.changed:
            tones[len(rows)] = "bad"
        last = ("-" if limit is None else f"{limit:.2g}", FAMILIES.get(name, ""))
        lead = [sensor.name] * named
        rows.append((*lead, name, f"{test.p:.2g}", size or "open", shown, *last))
    note = (
        f"Could see: change in the direction that shows least, found in {100 * POWER:.0f} % of "
        f"such checks at a level of {100 * ALPHA:.0f} % over all kinds. Limit: {_how(check)}. "
        "A scale of 1 mg/g is a thousandth."
    )
    header = ("change", "p", "estimate", "could see", "limit", "unit")
    lead = ["sensor"] * named
    return Table("", (*lead, *header), tuple(rows), "l" * named + "lrlrrl", note, tones)


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
        where = "  ".join(f"{v:+.2f}" for v in force)
        size = (f"{misfits.value[worst] / MG:+.2f}", f"{sd[worst] / MG:.2f}")
        rows.append((label, where, *size, f"{z:+.1f}"))
    what = "largest component" if misfits.directed else "along gravity"
    title = f"Misfits, {what}" + (f" ({sensor.name})" if sensor.name else "")
    header = ("reading", "direction", "misfit, mg", "sd, mg", "z")
    note = "Reading minus what the calibration foretells; sd: of an unchanged sensor."
    return Table(title, header, tuple(rows), "llrrr", note, tones)


def _gyros(check: Check) -> tuple[Table, ...]:
    rows: list[tuple[str, ...]] = []
    tones: dict[int, Tone] = {}
    for sensor in check.sensors:
        if sensor.gyro is not None:
            if sensor in check.turned_on:
                tones[len(rows)] = "warning"
            axes = zip(sensor.gyro.bias, sensor.gyro.sd, strict=True)
            each = (plus_minus(v, s) for v, s in axes)
            rows.append((sensor.name, *each, f"{sensor.gyro.p:.2g}"))
    note = (
        "Rate at rest beyond the calibrated bias, deg/s; sd by the scatter between rests. "
        "Gyroscopes move at every switching on: it counts as changed beyond a limit only "
        "(--limit 0.5deg/s)."
    )
    header = ("sensor", "x", "y", "z", "p")
    return (Table("", header, tuple(rows), "lrrrr", note, tones),) if rows else ()


def _following(following: NextRests) -> tuple[Block, ...]:
    count = len(following.direction)
    seen = " or ".join(
        f"{'nothing' if math.isinf(v) else two_digits(v)} {FAMILIES[n]} of {n}"
        for n, v in following.seen.items()
    )
    if following.enough:
        more = f"{count} more rest{'s' * (count != 1)}" if count > 1 else "One more rest"
        words = f"{more} would decide: together with these they could see {seen}."
        rows = tuple((str(k), _attitude(d)) for k, d in enumerate(following.direction, start=1))
        note = "Up: the axis that then reads +g."
        return Text(words), Table("", ("rest", "attitude"), rows, "rl", note)
    if following.many is not None:
        words = (
            f"{count} more rests could see {seen}, which is not enough; about {following.many}, "
            "all round, would be: as many as a new calibration takes, which also mends what has "
            "changed."
        )
    else:
        words = (
            f"No recording decides this: {count} more rests could see {seen}, and {MANY[-1]} are "
            "not enough. What the calibration itself does not know is larger: calibrate again, or "
            "accept a wider limit."
        )
    return (Text(words, "warning"),)


def check_dict(check: Check, log: str, calibration: str, sha256: str) -> dict[str, Any]:
    """Plain types, ready for JSON."""
    next_rests = None
    if (following := check.following) is not None:
        rests = [{"attitude": _attitude(d), "direction": d} for d in following.direction]
        next_rests = {
            **fields(following, "enough rests_all_round_that_would_do=many"),
            "rests": rests,
            "could_see": following.seen,
        }
    content = {
        "schema": SCHEMA,
        "calibration": calibration,
        "calibration_sha256": sha256,
        "log": log,
        **fields(check, "verdict exit_code p"),
        "alpha": ALPHA,
        "power": POWER,
        "limits": {n: {"value": v, "unit": FAMILIES[n]} for n, v in check.limits.items()},
        "limits_stated": check.stated,
        "explanation": _changes(check),
        "sensors": [_sensor_dict(s) for s in check.sensors],
        "next": next_rests,
        "notes": [*check.noise.words, *check.notes],
    }
    return dict(plain(content))


def _sensor_dict(sensor: SensorCheck) -> dict[str, Any]:
    misfits, changes = sensor.misfits, []
    for name, test in sensor.tests.items():
        test_ = fields(test, "f p rank p_of_what_is_left=rest estimate=size sd")
        kind = {"kind": name, "unit": FAMILIES.get(name, "")}
        changes.append({**kind, **test_, "could_see": sensor.seen.get(name)})
    sd = np.sqrt(np.diag(misfits.covariance))
    each = zip(misfits.owner, misfits.value, sd, strict=True)
    bias = "bias_deg_per_s=gyro.bias sd_deg_per_s=gyro.sd p=gyro.p"
    return {
        **fields(sensor, "name p causes"),
        "one_reading_alone": None if sensor.alone is None else misfits.label[sensor.alone],
        **fields(misfits, "dof readings=n directions_known=directed"),
        "changes": changes,
        "misfits": [
            {"reading": misfits.label[o], "mg": v / MG, "sd_mg": s / MG} for o, v, s in each
        ],
        "gyroscope": None if sensor.gyro is None else fields(sensor, bias),
    }
