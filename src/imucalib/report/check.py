"""The report of `imucal check`, as a document and as plain types."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.checking.check import ALPHA, POWER, SIGNIFICANT, Check, SensorCheck
from imucalib.calibration.checking.next_rests import MANY, NextRests
from imucalib.calibration.checking.noise import FAMILIES
from imucalib.calibration.checking.statistic import ANYTHING, DRAWS
from imucalib.calibration.plain import fields, plain
from imucalib.report.document import (
    Block,
    Card,
    Document,
    Plot,
    Section,
    Series,
    Table,
    Text,
    Tone,
    Worth,
    capital,
)
from imucalib.significant_digits import plus_minus, probability, signed_components, two_digits
from imucalib.units import MG

SCHEMA = "imucal/check/1"
_TONE: dict[str, Tone] = {"still good": "ok", "changed": "bad", "undecided": "warning"}
_HEADLINE = {
    "still good": "Still good.",
    "changed": "The sensor is not what the calibration says.",
    "undecided": "Undecided: these readings are too few, or one of them is off.",
}
#: Standard deviations on either side of what holds 95 %.
_NORMAL_95 = 1.96
#: Rests that a card names.
_RESTS = 6
_OFTEN = f"{100 * POWER:.0f} %"


def check_document(check: Check, log: Path, calibration: Path, command: str = "") -> Document:
    """Verdict and card, what changed or could have hidden, every rest, what to record next.

    command : the line that was typed
    """
    tested, array = _change_table(check), bool(check.sensors[0].name)
    parts = (
        Section("What was tested", (_each(check) if array else tested,)),
        Section("Every kind of change", (tested,) if array else (), brief=False),
        Section("Readings", tuple(map(_readings, check.sensors)), brief=False),
        Section("Gyroscopes", _gyros(check)),
        Section("Record this next", _following(check.following) if check.following else ()),
        Section("Notes", Text.sentences((*check.noise.words, *check.notes))),
    )
    typed = (("command", command),) if command else ()
    footer = (("calibration", str(calibration)), ("log", str(log)), *typed)
    title = f"Check of {calibration.name} with {log.name}"
    card = _card(check, calibration, command)
    return Document(title, _verdict(check), parts, footer, card, drawn="--html")


def _how(check: Check) -> str:
    """Where the limits come from."""
    return "as stated" if check.stated else f"{SIGNIFICANT:g} sd of one corrected reading"


def _of(sensor: SensorCheck) -> str:
    """The name of one of several sensors, to lead a sentence."""
    return f"{sensor.name}: " if sensor.name else ""


def _least(check: Check, name: str) -> float:
    """The change of a kind that would have been found in every sensor."""
    return max(sensor.seen[name] for sensor in check.sensors)


def _sizes(sizes: Iterable[tuple[str, float]]) -> str:
    """Changes by kind, in words; an infinite one is none."""
    return " or ".join(
        f"{'no' if math.isinf(size) else f'{two_digits(size)} {FAMILIES[name]} of'} {name}"
        for name, size in sizes
    )


def _odd(check: Check) -> list[str]:
    """The readings that do not belong to the others of their sensor."""
    return [f"{_of(s)}{s.misfits.label[s.alone]}" for s in check.disturbed if s.alone is not None]


def _verdict(check: Check) -> Text:
    """The headline."""
    lead, tone = f"(p {probability(check.p, DRAWS)})", _TONE[check.verdict]
    least = {name: _least(check, name) for name in check.limits}
    if check.verdict == "changed":
        return Text(f"Changed {lead}: {'; '.join(_changes(check))}.", tone)
    if check.disturbed:
        words = (
            f"Undecided {lead}: only {' and '.join(_odd(check))} does not belong to the others; "
            "without it nothing shows. Hold that attitude again."
        )
    elif check.verdict == "undecided":
        short = " or ".join(
            f"{limit:.2g} {FAMILIES[name]} of {name}"
            for name, limit in check.limits.items()
            if least[name] > limit
        )
        words = (
            f"Undecided {lead}: nothing shows, but these readings could not have shown a change of "
            f"{short}; they could see {_sizes(least.items())}."
        )
    else:
        words = (
            f"Still good {lead}: a change of {_sizes(least.items())} would have been found in "
            f"{_OFTEN} of such checks."
        )
    return Text(words, tone)


def _card(check: Check, calibration: Path, command: str) -> Card:
    """What it could have seen; what shows, and the reading that fits least; what to do."""
    worths = []
    for name, limit in check.limits.items():
        size, unit = _least(check, name), FAMILIES[name]
        shown = "no size" if math.isinf(size) else f"{two_digits(size)} {unit}"
        detail = f"seen by {_OFTEN} of such checks; limit {limit:.2g} {unit}, {_how(check)}"
        worths.append(Worth(f"see a change of {name}", shown, detail))
    found = Text.sentences(_changes(check), "bad")
    found += Text.each((f"{odd} does not belong to the others." for odd in _odd(check)), "warning")
    if not found:
        words = "Nothing shows: the readings are as the calibration foretells them."
        found = (Text(words, "ok" if check.verdict == "still good" else "plain"),)
    if moved := [s.name or "the gyroscope" for s in check.turned_on if s not in check.drifted]:
        words = f"The gyroscope's bias of {', '.join(moved)} moved, as at every switching on."
        found += (Text(words),)
    steps = _to_do(check, shlex.quote(str(calibration)))
    picture, headline = _picture(check), _HEADLINE[check.verdict]
    return Card(tuple(worths), found, steps, command, headline=headline, picture=picture)


def _picture(check: Check) -> Plot:
    """By how much every reading of the least likely sensor is off what the calibration foretells,
    with the 95 % of an unchanged one."""
    sensor = min(check.sensors, key=lambda s: s.p)
    misfits = sensor.misfits
    rows, half = np.arange(1.0, misfits.n + 1.0), np.zeros(misfits.n)
    # Of a reading's axes the one that is known least.
    np.maximum.at(half, misfits.owner, _NORMAL_95 * np.sqrt(np.diag(misfits.covariance)) / MG)
    names = tuple(misfits.label[row] for row in misfits.owner)
    series = (
        Series.about("unchanged, 95 %", rows, np.zeros(misfits.n), half, "band"),
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
        return ("Hold that attitude again, and check all readings together.",)
    if check.verdict != "undecided":
        return (f"Go on with it: `imucal apply {calibration} RECORDING -o corrected.mcap`.",)
    if following is not None and following.enough:
        rests = "; ".join(map(_attitude, following.direction[:_RESTS]))
        more = "; ..." if len(following.direction) > _RESTS else ""
        return (f"Record these rests too, and check all of them together: {rests}{more}.",)
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
    if not sensor.causes:
        kinds = [name for name in sensor.tests if name != ANYTHING]
        text = f"neither {' nor '.join(kinds)} alone explains it, "
        if sensor.together is None:
            return text + "and these are too few readings to tell more"
        return text + ("all together do" if sensor.together else "nor do all together")
    sizes = {name: _size(sensor, name) for name in sensor.causes}
    name, *others = (f"the {name}" for name in sizes)
    size, *rest = (f" ({size})" if size else "" for size in sizes.values())
    first = f"{name} has changed{size}"
    if not others:
        return first
    named = ", or ".join(map(str.__add__, others, rest))
    return f"{first}, or {named}: these readings cannot tell them apart"


def _size(sensor: SensorCheck, name: str) -> str:
    """Each axis with its sd; nothing where it is open."""
    test = sensor.tests[name]
    if np.isnan(test.size).any():
        return ""
    axes = zip("xyz", map(plus_minus, test.size, test.sd), strict=True)
    return f"{', '.join(map(' '.join, axes))} {FAMILIES[name]}".strip()


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
    limit = check.limits.get("bias")
    more = "" if limit is None else f"; limit {limit:.2g} mg, {_how(check)}"
    note = (
        f"Could see: change of bias, mg, found in {_OFTEN} of such checks at a level of "
        f"{100 * ALPHA:.0f} % over all IMUs{more}."
    )
    header = ("sensor", "p", "change of bias", "could see")
    tones = Table.marked("bad", (s in check.changed for s in check.sensors))
    return Table("", header, rows, "lrlr", note, tones)


def _change_table(check: Check) -> Table:
    several, every = bool(check.sensors[0].name), [(s, n) for s in check.sensors for n in s.tests]

    def row(sensor: SensorCheck, name: str) -> tuple[str, ...]:
        limit, seen = check.limits.get(name), sensor.seen.get(name, math.nan)
        size = "" if name == ANYTHING else _size(sensor, name)
        shown = "-" if math.isnan(seen) else "none" if math.isinf(seen) else two_digits(seen)
        cells = (name, f"{sensor.tests[name].p:.2g}", size or "open", shown)
        last = ("-" if limit is None else f"{limit:.2g}", FAMILIES.get(name, ""))
        return (*[sensor.name] * several, *cells, *last)

    level = ALPHA / len(check.sensors)
    tones = Table.marked("bad", (s.tests[n].p <= level and s in check.changed for s, n in every))
    note = (
        f"Could see: change in the direction that shows least, found in {_OFTEN} of "
        f"such checks at a level of {100 * ALPHA:.0f} % over all kinds. Limit: {_how(check)}. "
        "A scale of 1 mg/g is a thousandth."
    )
    header = (*["sensor"] * several, "change", "p", "estimate", "could see", "limit", "unit")
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
            signed_components(force),
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
        title, header, rows, "llrrr", note, Table.marked("warning", np.abs(z[worst]) > 3.0)
    )


def _gyros(check: Check) -> tuple[Table, ...]:
    resting = [(s, s.gyro) for s in check.sensors if s.gyro is not None]
    rows = tuple(
        (s.name, *map(plus_minus, gyro.bias, gyro.sd), f"{gyro.p:.2g}") for s, gyro in resting
    )
    note = (
        "Rate at rest beyond the calibrated bias, deg/s; sd by the scatter between rests. "
        "Gyroscopes move at every switching on: it counts as changed beyond a limit only "
        "(--limit 0.5deg/s)."
    )
    tones = Table.marked("warning", (s in check.turned_on for s, _ in resting))
    header = ("sensor", "x", "y", "z", "p")
    return (Table("", header, rows, "lrrrr", note, tones),) if rows else ()


def _following(following: NextRests) -> tuple[Block, ...]:
    count, seen = len(following.direction), _sizes(following.seen.items())
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
        **fields(check, "verdict exit_code p"),
        "alpha": ALPHA,
        "power": POWER,
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
    test = "f p rank p_of_what_is_left=rest estimate=size sd"
    bias = "bias_deg_per_s=gyro.bias sd_deg_per_s=gyro.sd p=gyro.p"
    return {
        **fields(sensor, "name p causes"),
        "one_reading_alone": None if sensor.alone is None else misfits.label[sensor.alone],
        **fields(misfits, "dof readings=n directions_known=directed"),
        "changes": [
            {"kind": name, "unit": FAMILIES.get(name, ""), **fields(one, test)}
            | {"could_see": sensor.seen.get(name)}
            for name, one in sensor.tests.items()
        ],
        "misfits": [
            {"reading": misfits.label[o], "mg": v / MG, "sd_mg": s / MG} for o, v, s in each
        ],
        "gyroscope": None if sensor.gyro is None else fields(sensor, bias),
    }
