"""Verdict and drift of a comparison in words."""

from __future__ import annotations

import math
from datetime import timedelta

from imucalib.calibration.comparison.compare import Comparison, Drift, Meaning
from imucalib.report.document import Text
from imucalib.significant_digits import plus_minus, two_digits

QUANTITY = {
    "mg": "the size of the corrected force", "deg": "its direction", "mm": "the position",
    "deg/s": "the bias of the gyroscope",
}  # fmt: skip


def verdict_words(found: Comparison) -> str:
    """The headline."""
    fit = found.agreement
    proof = f"χ² {fit.chi2:.3g} with {fit.dof} degrees of freedom, p {fit.p:.2g}"
    worst = "; ".join(_meaning_words(found, m) for m in found.meanings)
    beyond = [m for m in found.meanings if m.beyond]
    if found.verdict == "differ":
        which = f" Without {' and '.join(found.odd)} the others agree." if found.odd else ""
        return f"They differ beyond the limit ({proof}): {worst}.{which}"
    if found.verdict == "undecided":
        kinds = " and ".join(QUANTITY[m.worst.unit] for m in beyond)
        return (
            f"Undecided ({proof}): {kinds} differs by more than the limit, within what the files "
            f"state themselves: {worst}. Calibrate from more positions."
        )
    lead = "They agree" if not found.differ else "They differ, but within the limit"
    return f"{lead} ({proof}): {worst}."


def _meaning_words(found: Comparison, meaning: Meaning) -> str:
    worst = meaning.worst
    size = two_digits(worst.value) if math.isnan(worst.sd) else plus_minus(worst.value, worst.sd)
    pair = f" between {' and '.join(found.names[k] for k in worst.pair)}" * (len(found.names) > 2)
    name = f" ({meaning.sensor})" if meaning.sensor else ""
    return f"{QUANTITY[worst.unit]}{name} by {size} {worst.unit} at most{pair}"


def due_words(drift: Drift) -> Text:
    """Whether a drift shows, and when the limit is reached."""
    due = drift.due
    slope = plus_minus(due.slope.value, due.slope.half)
    where = "  ".join(f"{v:+.2f}" for v in due.attitude)
    if math.isfinite(due.expected):
        when = _day(drift, float(drift.dates.days.max()) + due.expected)
        return Text(
            f"The corrected force drifts by {slope} (95 %) {due.unit} a day at its worst attitude "
            f"({where}): the limit of {due.limit:.2g} {due.unit} is reached on {when}, "
            f"{_early(drift)}.",
            "warning",
        )
    return Text(
        f"No drift shows. The next calibration is due {_early(drift)}: until then these dates "
        f"exclude that the limit of {due.limit:.2g} {due.unit} is reached."
    )


def _early(drift: Drift) -> str:
    if not math.isfinite(drift.due.earliest):
        return "at no time by these dates"
    return f"at the earliest on {_day(drift, float(drift.dates.days.max()) + drift.due.earliest)}"


def _day(drift: Drift, days: float) -> str:
    if days > 36500.0:
        return "a day more than a century away"
    return (drift.dates.start + timedelta(days=days)).strftime("%Y-%m-%d")
