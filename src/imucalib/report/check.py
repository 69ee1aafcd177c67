"""The report of `imucal check`, as a document and as plain types."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.checking.check import SIGNIFICANT, Check, SensorCheck
from imucalib.calibration.checking.misfit import BAD_REST
from imucalib.calibration.checking.noise import FAMILIES
from imucalib.data import fields, plain
from imucalib.posterior.closed_loop.changes import NOISE
from imucalib.posterior.odds import SEEN_IN
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
    list_likely,
    per_cent,
    plus_minus,
    two_digits,
)
from imucalib.units import MG

SCHEMA = "imucal/check/1"
_VERDICT = {
    "still good": Text("Still good.", "ok"),
    "changed": Text("The sensor is not what the calibration says.", "bad"),
    "undecided": Text("Undecided: these readings are too few, or one of them is off.", "warning"),
}
#: Standard deviations on either side of what holds 95 %.
_NORMAL_95 = 1.96
#: In the place of a change.
_UNCHANGED = "none"
_OFTEN = f"{100 * SEEN_IN:.0f} %"


def compose_check_document(
    check: Check, log: Path, calibration: Path, command: str = ""
) -> Document:
    """Verdict and card, what changed or could have hidden, every rest.

    command : the line that was typed
    """
    parts = (
        Section("What was tested", (_change_table(check),)),
        Section("Readings", tuple(map(_readings, check.sensors))),
        Section("Gyroscopes", _gyros(check)),
        Section("Notes", Text.sentences((*check.noise.words, *check.notes))),
    )
    typed = (("command", command),) if command else ()
    footer = (("calibration", str(calibration)), ("log", str(log)), *typed)
    title = f"Check of {calibration.name} with {log.name}"
    card = _compose_card(check, calibration, command)
    return Document(title, _VERDICT[check.verdict], parts, footer, card, drawn="--html")


def _how(check: Check) -> str:
    """Where the limits come from."""
    return "as stated" if check.stated else f"{SIGNIFICANT:g} sd of one corrected reading"


def _of(sensor: SensorCheck) -> str:
    """The name of one of several sensors, to lead a sentence."""
    return f"{sensor.name}: " if sensor.name else ""


def _least(check: Check, name: str) -> float:
    """The change of a kind that would have been found in every sensor."""
    return max(sensor.sizes[name].seen for sensor in check.sensors)


def _odd(check: Check) -> list[str]:
    """What may be off of the sensors that need not have changed."""
    return [
        f"{_of(s)}{s.misfits.label[s.alone]} does not belong to the others"
        if s.alone is not None
        else f"{_of(s)}may have changed: {_others(s, ())}"
        for s in check.disturbed
    ]


def _compose_card(check: Check, calibration: Path, command: str) -> Card:
    """What it could have seen; what shows, and the reading that fits least; what to do."""
    worths = []
    for name, limit in check.limits.items():
        size, unit = _least(check, name), FAMILIES[name]
        shown = "no size" if math.isinf(size) else f"{two_digits(size)} {unit}"
        detail = f"seen by {_OFTEN} of such checks; limit {limit:.2g} {unit}, {_how(check)}"
        worths.append(Worth(f"see a change of {name}", shown, detail))
    found = Text.sentences(_changes(check), "bad")
    found += Text.sentences(_odd(check), "warning")
    if not found:
        words = "Nothing shows: the readings are as the calibration foretells them."
        found = (Text(words, "ok" if check.verdict == "still good" else "plain"),)
    steps = _to_do(check, shlex.quote(str(calibration)))
    return Card(tuple(worths), found, steps, command, picture=_picture(check))


def _picture(check: Check) -> Plot:
    """By how much every reading of the least likely sensor is off what the calibration foretells,
    with the 95 % of an unchanged one."""
    sensor = min(check.sensors, key=lambda s: s.answer.nothing)
    misfits = sensor.misfits
    rows, half = np.arange(1.0, misfits.n + 1.0), np.zeros(misfits.n)
    # Of a reading's axes the one that is known least.
    np.maximum.at(half, misfits.owner, _NORMAL_95 * np.sqrt(np.diag(misfits.covariance)) / MG)
    names = tuple(misfits.label[row] for row in misfits.owner)
    series = (
        Series.from_half("unchanged, 95 %", rows, np.zeros(misfits.n), half, "band"),
        Series("reading", rows[misfits.owner], misfits.value / MG, "points", names=names),
    )
    what = "each axis" if misfits.directed else "|a|"
    caption = f"{_of(sensor)}{what} of every reading less what the calibration foretells."
    return Plot("Misfit of the readings", "reading", "misfit (mg)", series, capital(caption))


def _to_do(check: Check, calibration: str) -> tuple[str, ...]:
    following = check.following
    if check.verdict == "changed":
        return (
            "Calibrate again; recordings since the last good check are in doubt.",
            f"See then what has changed: `imucal compare {calibration} NEW`.",
        )
    if check.disturbed:
        odd = [s.misfits.label[s.alone] for s in check.disturbed if s.alone is not None]
        which = f"the attitude of {', '.join(dict.fromkeys(odd))}" if odd else "these attitudes"
        return (f"Hold {which} again, and check all readings together.",)
    if check.verdict != "undecided":
        return (f"Go on with it: `imucal apply {calibration} RECORDING -o corrected.mcap`.",)
    if following is not None and following.enough:
        rests = "; ".join(map(_attitude, following.direction))
        return (f"Record these rests too, and check all of them together: {rests}.",)
    many = None if following is None else following.many
    lead = "No recording decides this" if many is None else f"It would take about {many} rests"
    return (f"{lead}: calibrate again, or accept a wider limit (--limit).",)


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
    kinds = [name for name in sensor.causes if name in FAMILIES]
    words = [f"the {name} has changed{_sized(sensor, name)}" for name in kinds]
    if NOISE in sensor.causes:
        alone = "these readings scatter more than the calibration says"
        words.append("the rest scatters more" if words else f"{alone}, or change in another way")
    if BAD_REST in sensor.causes:
        words.append("one rest is off")
    more = _others(sensor, sensor.causes)
    return " and ".join(words) + (f" (or else: {more})" if more else "")


def _others(sensor: SensorCheck, told: Sequence[str]) -> str:
    """What else may have changed, with its probability, likeliest first."""
    names = (n for n in (*sensor.sizes, BAD_REST, NOISE) if n not in told)
    return list_likely({n: sensor.answer.of(n) for n in names})


def _sized(sensor: SensorCheck, name: str) -> str:
    size = _size(sensor, name)
    return f" by {size}" if size else ""


def _size(sensor: SensorCheck, name: str) -> str:
    """Each axis with its sd; nothing where it is open."""
    size = sensor.sizes[name]
    if np.isnan(size.value).any():
        return ""
    axes = zip("xyz", map(plus_minus, size.value, size.sd), strict=True)
    return f"{', '.join(map(' '.join, axes))} {FAMILIES[name]}".strip()


def _attitude(direction: Array) -> str:
    """An attitude of the hand: "+z up", "edge +x -y up"."""
    axes = [f"{'+' if v > 0 else '-'}{'xyz'[k]}" for k, v in enumerate(direction) if abs(v) > 0.1]
    return f"{('', 'edge ', 'corner ')[len(axes) - 1]}{' '.join(axes)} up"


def _change_table(check: Check) -> Table:
    several = bool(check.sensors[0].name)
    every = [(s, n) for s in check.sensors for n in (_UNCHANGED, *s.sizes, BAD_REST, NOISE)]

    def row(sensor: SensorCheck, name: str) -> tuple[str, ...]:
        limit, size = check.limits.get(name), sensor.sizes.get(name)
        estimate, shown = "-", "-"
        if size is not None:
            estimate = _size(sensor, name) or "open"
            shown = "none" if math.isinf(size.seen) else two_digits(size.seen)
        answer = sensor.answer
        share = answer.nothing if name == _UNCHANGED else answer.of(name)
        cells = (name, per_cent(share), estimate, shown)
        last = ("-" if limit is None else f"{limit:.2g}", FAMILIES.get(name, ""))
        return (*[sensor.name] * several, *cells, *last)

    tones = Table.mark_rows("bad", (n in s.causes for s, n in every))
    note = (
        "There: probability, whatever else changed. Could see: change in the direction that shows "
        f"least, told in {_OFTEN} of such checks; of unchanged sensors at most "
        f"{per_cent(check.false_alarm)} are told. Limit: {_how(check)}. A scale of 1 mg/g is a "
        "thousandth."
    )
    header = (*["sensor"] * several, "change", "there", "estimate", "could see", "limit", "unit")
    rows = tuple(row(*one) for one in every)
    return Table("", header, rows, "l" * several + "lrlrrl", note, tones)


def _readings(sensor: SensorCheck) -> Table:
    misfits = sensor.misfits
    sd = np.sqrt(np.diag(misfits.covariance))
    z = misfits.value / sd
    owned = (np.flatnonzero(misfits.owner == k) for k in range(len(misfits.label)))
    worst = [own[int(np.argmax(np.abs(z[own])))] for own in owned]
    forces = misfits.force / np.linalg.norm(misfits.force, axis=1, keepdims=True)
    rows = tuple(
        (
            label,
            format_components(force),
            f"{misfits.value[k] / MG:+.2f}",
            f"{sd[k] / MG:.2f}",
            f"{z[k]:+.1f}",
        )
        for label, force, k in zip(misfits.label, forces, worst, strict=True)
    )
    what = "largest component" if misfits.directed else "along gravity"
    title = f"Misfits, {what}" + (f" ({sensor.name})" if sensor.name else "")
    header = ("reading", "direction", "misfit, mg", "sd, mg", "z")
    note = "Reading minus what the calibration foretells; sd: of an unchanged sensor."
    return Table(
        title, header, rows, "llrrr", note, Table.mark_rows("warning", np.abs(z[worst]) > 3.0)
    )


def _gyros(check: Check) -> tuple[Table, ...]:
    resting = [(s, s.gyro) for s in check.sensors if s.gyro is not None]
    limit = check.rate_limit
    rows = tuple(
        (s.name, *map(plus_minus, gyro.bias, gyro.sd))
        + ((per_cent(gyro.chance_beyond(limit)),) if math.isfinite(limit) else ())
        for s, gyro in resting
    )
    note = (
        "Rate at rest beyond the calibrated bias, deg/s; sd by the scatter between rests. "
        "Gyroscopes move at every switching on: it counts as changed where it is likelier beyond "
        "a limit than within (--limit 0.5deg/s)."
    )
    tones = Table.mark_rows("warning", (s in check.drifted for s, _ in resting))
    header = ("sensor", "x", "y", "z", "beyond limit")[: len(rows[0]) if rows else 0]
    return (Table("", header, rows, "lrrrr"[: len(header)], note, tones),) if rows else ()


def check_dict(check: Check, log: str, calibration: str, sha256: str) -> dict[str, Any]:
    """Plain types, ready for JSON."""
    following: Mapping[str, Any] | None = None
    if (found := check.following) is not None:
        rests = [{"attitude": _attitude(d), "direction": d} for d in found.direction]
        many = fields(found, "enough rests_all_round_that_would_do=many")
        following = {**many, "rests": rests, "could_see": found.seen}
    content = {
        "schema": SCHEMA,
        "calibration": calibration,
        "calibration_sha256": sha256,
        "log": log,
        **fields(check, "verdict exit_code unchanged=nothing"),
        "power": SEEN_IN,
        "false_alarm": check.false_alarm,
        "limits": {n: {"value": v, "unit": FAMILIES[n]} for n, v in check.limits.items()},
        "limits_stated": check.stated,
        "explanation": _changes(check),
        "sensors": [_sensor_dict(s) for s in check.sensors],
        "next": following,
        "notes": [*check.noise.words, *check.notes],
    }
    return dict(plain(content))


def _sensor_dict(sensor: SensorCheck) -> dict[str, Any]:
    misfits = sensor.misfits
    sd = np.sqrt(np.diag(misfits.covariance))
    each = zip(misfits.owner, misfits.value, sd, strict=True)
    gyro = sensor.gyro
    return {
        **fields(sensor, "name unchanged=answer.nothing causes"),
        "one_reading_alone": None if sensor.alone is None else misfits.label[sensor.alone],
        **fields(misfits, "readings=n directions_known=directed"),
        "changes": [
            {"kind": name, "unit": FAMILIES[name], "probability": sensor.answer.of(name)}
            | fields(size, "estimate=value sd could_see=seen")
            for name, size in sensor.sizes.items()
        ],
        "one_bad_rest": sensor.answer.of(BAD_REST),
        "more_noise": sensor.answer.of(NOISE),
        "misfits": [
            {"reading": misfits.label[o], "mg": v / MG, "sd_mg": s / MG} for o, v, s in each
        ],
        "gyroscope": gyro and fields(gyro, "bias_deg_per_s=bias sd_deg_per_s=sd"),
    }
