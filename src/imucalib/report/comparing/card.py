"""The card of a comparison: to how much the calibrations agree, and what to do."""

from __future__ import annotations

import math

from imucalib.calibration.comparison.compare import SIGNIFICANT, Comparison
from imucalib.report.comparing.words import due_words
from imucalib.report.document import Card, Text, Tone, Worth
from imucalib.significant_digits import plus_minus, two_digits

_WORTH = {"mg": "difference of force", "deg": "difference of direction",
          "mm": "difference of place", "deg/s": "difference of rate"}  # fmt: skip
TONE: dict[str, Tone] = {"agree": "ok", "differ": "bad", "undecided": "warning"}


def comparison_card(found: Comparison, command: str) -> Card:
    """command : the line that was typed"""
    return Card(_worth(found), _found(found), _to_do(found), command)


def _worth(found: Comparison) -> tuple[Worth, ...]:
    how = "as stated" if found.stated else f"{SIGNIFICANT:g} times the largest stated sd"
    made = []
    for meaning in found.meanings:
        worst, unit = meaning.worst, meaning.worst.unit
        size = plus_minus(worst.value, worst.sd) if worst.sd > 0.0 else two_digits(worst.value)
        at = "  ".join(f"{v:+.2f}" for v in worst.attitude)
        limit = f"limit {meaning.limit:.2g} {unit}, {how}"
        detail = f"at most, where the force is {at}; {limit}"
        sensor = f", {meaning.sensor}" if meaning.sensor else ""
        made.append(Worth(f"{_WORTH[unit]}{sensor}", f"{size} {unit}", detail))
    return tuple(made)


def _found(found: Comparison) -> tuple[Text, ...]:
    fit, z = found.agreement, found.agreement.z_rms
    one = "by more than they state" if found.differ else "by no more than they state"
    lines = [
        Text(
            f"The files differ {one}: all parameters together z rms {z:.2f}, where 1 is what they "
            f"state ({fit.dof} of them).",
            TONE[found.verdict],
        )
    ]
    if found.odd:
        lines.append(Text(f"Without {' and '.join(found.odd)} the others agree.", "warning"))
    if found.drift is not None:
        lines.append(due_words(found.drift))
    return tuple(lines)


def _to_do(found: Comparison) -> tuple[str, ...]:
    last = found.names[-1]
    if found.verdict == "undecided":
        return (
            "Calibrate from more positions: `imucal design` says which.",
            "Or accept a wider limit (--limit).",
        )
    if found.verdict == "differ":
        doubted = " and ".join(found.odd) if found.odd else "each"
        return (
            f"Find out which holds: record four rests and check {doubted} with them, `imucal check "
            "CALIBRATION RESTS`.",
            "Correct every recording with the calibration that is nearest to it in time.",
        )
    steps = [f"Go on with any of them; {last} is the last that was named."]
    if found.drift is not None and math.isfinite(found.drift.due.expected):
        steps.insert(0, "Calibrate again before the limit is reached.")
    return tuple(steps)
