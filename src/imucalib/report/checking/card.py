"""The card of a check: what it could have seen, what shows, and what to do."""

from __future__ import annotations

import math

import numpy as np

from imucalib.calibration.checking.check import POWER, SIGNIFICANT, Check
from imucalib.calibration.checking.misfit import FAMILIES
from imucalib.report.checking.words import attitude_words, causes_in_words, evidence_words
from imucalib.report.document import Card, Text, Tone, Worth
from imucalib.significant_digits import two_digits

TONE: dict[str, Tone] = {"still good": "ok", "changed": "bad", "undecided": "warning"}
#: Rests that a card names.
_RESTS = 6


def check_card(check: Check, command: str) -> Card:
    """command : the line that was typed"""
    return Card(_worth(check), _found(check), _to_do(check), command)


def _worth(check: Check) -> tuple[Worth, ...]:
    how = "as stated" if check.stated else f"{SIGNIFICANT:g} sd of one corrected reading"
    made = []
    for name, limit in check.limits.items():
        size, unit = max(s.seen[name] for s in check.sensors), FAMILIES[name]
        shown = "no size" if math.isinf(size) else f"{two_digits(size)} {unit}"
        detail = f"seen by {100 * POWER:.0f} % of such checks; limit {limit:.2g} {unit}, {how}"
        made.append(Worth(f"see a change of {name}", shown, detail))
    return tuple(made)


def _found(check: Check) -> tuple[Text, ...]:
    """What shows, the reading that fits least, and the evidence of all looks."""
    lines = [Text(f"{said[0].upper()}{said[1:]}.", "bad") for said in causes_in_words(check)]
    for sensor in check.disturbed:
        if sensor.alone is not None:
            name = f"{sensor.name}: " if sensor.name else ""
            label = sensor.misfits.label[sensor.alone]
            lines.append(Text(f"{name}{label} does not belong to the others.", "warning"))
    if not lines:
        calm: Tone = "ok" if check.verdict == "still good" else "plain"
        lines.append(
            Text("Nothing shows: the readings are as the calibration foretells them.", calm)
        )
    if moved := [s.name or "the gyroscope" for s in check.turned_on if s not in check.drifted]:
        lines.append(Text(f"The gyroscope's bias of {', '.join(moved)} moved, as at every "
                          "switching on."))  # fmt: skip
    lines.append(Text(evidence_words(check)))
    return tuple(lines)


def _to_do(check: Check) -> tuple[str, ...]:
    if check.verdict == "changed":
        return (
            "Calibrate again; recordings since the last good check are in doubt.",
            "See what has changed: `imucal compare CALIBRATION NEW`.",
        )
    if check.disturbed:
        return ("Hold that attitude again, and check all readings together.",)
    following = check.following
    if check.verdict == "undecided" and following is not None and following.enough:
        rests = "; ".join(attitude_words(np.asarray(d)) for d in following.direction[:_RESTS])
        more = "; ..." if len(following.direction) > _RESTS else ""
        return (f"Record these rests too, and check all of them together: {rests}{more}.",)
    if check.verdict == "undecided":
        many = None if following is None else following.many
        lead = "No recording decides this" if many is None else f"It would take about {many} rests"
        return (f"{lead}: calibrate again, or accept a wider limit (--limit).",)
    return (
        "Use it: `imucal apply CALIBRATION RECORDING -o corrected.mcap`.",
        "At the next check give --history FILE, so that the evidence of all looks counts.",
    )[: 1 if check.looks > 1 else 2]
