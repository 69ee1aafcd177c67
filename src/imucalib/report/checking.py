"""The report of `imucal check`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.checking.check import POWER, SIGNIFICANT, Check, SensorCheck
from imucalib.calibration.checking.e_value import ALPHA
from imucalib.calibration.checking.misfit import FAMILIES
from imucalib.calibration.checking.next_rests import NextRests
from imucalib.calibration.checking.statistic import ANYTHING
from imucalib.calibration.plain import plain
from imucalib.report.document import Block, Document, Section, Table, Text, Tone
from imucalib.significant_digits import plus_minus, two_digits
from imucalib.units import MG

SCHEMA = "imucal/check/1"
_TONE: dict[str, Tone] = {"still good": "ok", "changed": "bad", "undecided": "warning"}
_WORDS = {"bias": "the bias", "scale": "the scale", "mounting": "the mounting"}
_FACES = ("x", "y", "z")


def check_document(check: Check, log: str, calibration: str) -> Document:
    """The verdict, what changed or could have hidden, every rest, and what to record next."""
    tested = _change_table(check, check.sensors)
    array = bool(check.sensors[0].name)
    first = (_each(check) if array else tested, Text(_evidence_words(check)))
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
    verdict = Text(_verdict(check), _TONE[check.verdict])
    footer = (("calibration", calibration), ("log", log))
    return Document(f"Check of {calibration} with {log}", verdict, tuple(sections), footer)


def _verdict(check: Check) -> str:
    p = f"p {check.p:.2g}"
    if check.verdict == "changed":
        return f"Changed ({p}): {'; '.join(causes_in_words(check))}."
    short = [
        f"{_limit(name, limit)} of {_plain(name)}"
        for name, limit in check.limits.items()
        if max(s.seen[name] for s in check.sensors) > limit
    ]
    if check.disturbed:
        words = [
            f"{f'{s.name}: ' if s.name else ''}{s.misfits.label[s.alone]}"
            for s in check.disturbed if s.alone is not None
        ]  # fmt: skip
        return (
            f"Undecided ({p}): only {' and '.join(words)} does not belong to the others; without it "
            "nothing shows. Hold that attitude again."
        )
    if check.verdict == "undecided":
        return (
            f"Undecided ({p}): nothing shows, but these readings could not have shown a change of "
            f"{' or '.join(short)}; they could see {_seen_words(check)}."
        )
    return (
        f"Still good ({p}): a change of {_seen_words(check)} would have been found in "
        f"{100 * POWER:.0f} % of such checks."
    )


def _plain(name: str) -> str:
    return {"bias": "bias", "scale": "scale", "mounting": "mounting"}[name]


def _limit(name: str, value: float) -> str:
    return f"{value:.2g} {FAMILIES[name]}"


def _seen_words(check: Check) -> str:
    found = []
    for name in check.limits:
        size = max(s.seen[name] for s in check.sensors)
        shown = "no" if math.isinf(size) else f"{two_digits(size)} {FAMILIES[name]} of"
        found.append(f"{shown} {_plain(name)}")
    return " or ".join(found)


def causes_in_words(check: Check) -> list[str]:
    """What changed, sensor by sensor."""
    said = [f"{f'{s.name}: ' if s.name else ''}{_causes(s)}" for s in check.changed]
    for sensor in check.drifted:
        assert sensor.gyro is not None
        axis = int(np.argmax(np.abs(sensor.gyro.bias)))
        size = plus_minus(float(sensor.gyro.bias[axis]), float(sensor.gyro.sd[axis]), "deg/s")
        said.append(f"{sensor.name}: the gyroscope's bias {_FACES[axis]} moved by {size}")
    return said


def _causes(sensor: SensorCheck) -> str:
    if not sensor.causes:
        kinds = [_plain(name) for name in sensor.tests if name != ANYTHING]
        text = f"neither {' nor '.join(kinds)} alone explains it, "
        return text + ("all together do" if sensor.together else "nor do all together")
    first = f"{_WORDS[sensor.causes[0]]} has changed{_sizes(sensor, sensor.causes[0])}"
    if len(sensor.causes) == 1:
        return first
    others = [f"{_WORDS[name]}{_sizes(sensor, name)}" for name in sensor.causes[1:]]
    return f"{first}, or {', or '.join(others)}: these readings cannot tell them apart"


def _sizes(sensor: SensorCheck, name: str) -> str:
    test = sensor.tests[name]
    if np.isnan(test.size).any():
        return ""
    each = (
        f"{axis} {plus_minus(float(v), float(s))}"
        for axis, v, s in zip(_FACES, test.size, test.sd, strict=True)
    )
    return f" ({', '.join(each)} {FAMILIES[name]})"


def _each(check: Check) -> Table:
    """An array's IMUs, a row each."""
    rows = tuple(
        (s.name, f"{s.p:.2g}", _sizes(s, "bias").strip(" ()") or "open", two_digits(s.seen["bias"]))
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
            size = "" if name == ANYTHING else _sizes(sensor, name).strip(" ()")
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


def _evidence_words(check: Check) -> str:
    looks = "this check" if check.looks == 1 else f"{check.looks} checks together"
    bar = 1.0 / ALPHA
    said = "enough" if check.e >= bar else "not enough"
    return (
        f"Evidence of a change by {looks}: e = {check.e:.3g}, {said}: {bar:.0f} is reached by "
        f"chance in at most {100 * ALPHA:.0f} % of calibrations, however often one looks."
    )


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


def attitude_words(direction: Array) -> str:
    """An attitude of the hand: "+z up", "edge +x -y up"."""
    axes = [f"{'+' if v > 0 else '-'}{_FACES[k]}" for k, v in enumerate(direction) if abs(v) > 0.1]
    shape = {1: "", 2: "edge ", 3: "corner "}[len(axes)]
    return f"{shape}{' '.join(axes)} up"


def _following(check: Check, following: NextRests) -> list[Block]:
    count = len(following.direction)
    rows = tuple((str(k + 1), attitude_words(d)) for k, d in enumerate(following.direction))
    seen = " or ".join(
        f"{'nothing' if math.isinf(v) else two_digits(v)} {FAMILIES[n]} of {_plain(n)}"
        for n, v in following.seen.items()
    )
    table = Table("", ("rest", "attitude"), rows, "rl", "Up: the axis that then reads +g.")
    if following.enough:
        more = f"{count} more rest{'s' * (count != 1)}" if count > 1 else "One more rest"
        return [Text(f"{more} would decide: together with these they could see {seen}."), table]
    return [
        Text(
            f"No recording decides this: even {count} more rests could see {seen}. What the "
            "calibration itself does not know is larger: calibrate again, or accept a wider limit.",
            "warning",
        )
    ]


def check_dict(check: Check, log: str, calibration: str, sha256: str) -> dict[str, Any]:
    """Plain types, ready for JSON."""
    following = check.following
    content: Mapping[str, Any] = {
        "schema": SCHEMA,
        "calibration": calibration,
        "calibration_sha256": sha256,
        "log": log,
        "verdict": check.verdict,
        "exit_code": check.exit_code,
        "p": check.p,
        "e_value": check.e,
        "looks": check.looks,
        "alpha": ALPHA,
        "power": POWER,
        "limits": {n: {"value": v, "unit": FAMILIES[n]} for n, v in check.limits.items()},
        "limits_stated": check.stated,
        "explanation": causes_in_words(check),
        "sensors": [_sensor_dict(s) for s in check.sensors],
        "next": None if following is None else {
            "enough": following.enough,
            "rests": [
                {"attitude": attitude_words(d), "direction": d} for d in following.direction
            ],
            "could_see": dict(following.seen),
        },
        "notes": [*check.noise.words, *check.notes],
    }  # fmt: skip
    found: dict[str, Any] = plain(content)
    return found


def _sensor_dict(sensor: SensorCheck) -> dict[str, Any]:
    misfits = sensor.misfits
    return {
        "name": sensor.name,
        "p": sensor.p,
        "causes": list(sensor.causes),
        "one_reading_alone": None if sensor.alone is None else misfits.label[sensor.alone],
        "dof": misfits.dof,
        "readings": misfits.n,
        "directions_known": misfits.directed,
        "changes": [
            {"kind": name, "unit": FAMILIES.get(name, ""), "f": test.f, "p": test.p,
             "rank": test.rank, "p_of_what_is_left": test.rest, "estimate": test.size,
             "sd": test.sd, "could_see": sensor.seen.get(name)}
            for name, test in sensor.tests.items()
        ],
        "misfits": [
            {"reading": misfits.label[o], "mg": v / MG, "sd_mg": s / MG}
            for o, v, s in zip(misfits.owner, misfits.value,
                               np.sqrt(np.diag(misfits.covariance)), strict=True)
        ],
        "gyroscope": None if sensor.gyro is None else {
            "bias_deg_per_s": sensor.gyro.bias, "sd_deg_per_s": sensor.gyro.sd, "p": sensor.gyro.p,
        },
    }  # fmt: skip
