"""The report of `imucal design --imu`."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.calibrators.imu.plan import HandPlan
from imucalib.report.document import Document, Section, Table, Text

_NAMES = tuple(f"{a}{b}" for a in "xyz" for b in "xyz")


def hand_plan_document(plan: HandPlan) -> Document:
    """The turns in their order, and what is known of the gains after them."""
    count, added = len(plan.turns), plan.before is not None
    scale, cross = _worst(plan)
    words = f"{count} more turns" if added else f"{count} turns of 135 deg, {count + 1} rests"
    verdict = Text(
        f"{words}: scales to {scale:.2g} %, cross terms to {cross:.2g} % (one standard deviation).",
        "bad" if plan.open_gains else "ok",
    )
    turns = Table(
        "", ("turn", "about", "gravity before", "sd of a gain after, %"),
        tuple(
            (str(k), turn.axis, "  ".join(f"{v:+.2f}" for v in turn.up),
             f"{100.0 * turn.after:.2g}")
            for k, turn in enumerate(plan.turns, start=1)
        ),
        "rllr",
        "135 deg each, by hand, about the sensor's own axis, under the gyroscope's range, with two "
        "seconds of rest on something hard before and after. Gravity: what the accelerometer "
        "reads, in g.",
    )  # fmt: skip
    sds = Table(
        "", ("gain", *(("sd now, %",) if added else ()), "sd then, %"),
        tuple(
            (name, *((f"{100.0 * plan.before[k]:.2g}",) if plan.before is not None else ()),
             f"{100.0 * plan.sd[k]:.2g}")
            for k, name in enumerate(_NAMES)
        ),
        "l" + "r" * (1 + added),
    )  # fmt: skip
    left = tuple(Text(f"These stay open: {words}.", "bad") for words in plan.open_gains)
    return Document(
        "Turns to add" if added else "Turns to take", verdict,
        (Section("Turns", (turns,)), Section("Gains", (*left, sds))),
    )  # fmt: skip


def hand_plan_dict(plan: HandPlan) -> dict[str, Any]:
    """The same for machines."""
    return {
        "turns": [
            {"about": t.axis, "gravity_before": t.up.tolist(), "sd_after": t.after}
            for t in plan.turns
        ],
        "sd": dict(zip(_NAMES, plan.sd.tolist(), strict=True)),
        "sd_before": None
        if plan.before is None
        else dict(zip(_NAMES, plan.before.tolist(), strict=True)),
        "open": list(plan.open_gains),
    }


def _worst(plan: HandPlan) -> tuple[float, float]:
    """%, of the scales and of the cross terms."""
    sd = 100.0 * plan.sd.reshape(3, 3)
    own = np.eye(3, dtype=bool)
    return float(sd[own].max()), float(sd[~own].max())
