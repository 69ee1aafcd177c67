"""The steps of a search as tables: what was added, how sure, and what each was worth."""

from __future__ import annotations

import math
from collections.abc import Sequence

from imucalib.calibration.findings import Findings, FoundStep
from imucalib.report.document import Table
from imucalib.significant_digits import per_cent, probability


def step_tables(found: Findings) -> list[Table]:
    """Effects that were added; a column of sizes and of nats held out where a calibrator has it."""
    kinds = dict.fromkeys(tuple(c.metric for c in s.checks) for s in found.steps)
    return [
        _table([s for s in found.steps if tuple(c.metric for c in s.checks) == kind], found)
        for kind in kinds
    ]


def _table(steps: Sequence[FoundStep], found: Findings) -> Table:
    checks = steps[0].checks
    sized, nats = (any(getattr(s, name) for s in steps) for name in ("size", "held_out"))
    posterior = not any(math.isnan(s.probability) for s in steps)
    rows = tuple(
        (
            s.effect,
            *((s.size,) if sized else ()),
            per_cent(s.probability) if posterior else probability(s.p, s.draws),
            *((f"{s.evidence:.1f}", ", ".join(f"{v:.0f}" for v in s.held_out)) if nats else ()),
            *_changes(s),
            _others(s) or ("nothing: certain" if s.certain else "-"),
        )
        for s in steps
    )
    errors = (
        ("before", "after") if len(checks) == 1 else tuple(f"{c.metric}, {c.unit}" for c in checks)
    )
    header = (
        "effect added",
        *(("size",) if sized else ()),
        "there" if posterior else "p",
        *(("nats", "held out, nats") if nats else ()),
        *errors,
        "cannot be told from",
    )
    align = "l" + "l" * sized + "r" * (len(header) - 2 - sized) + "l"
    if len(checks) == 1:
        note = f"{_upper(checks[0].metric).removesuffix(', rms')} in {checks[0].unit} rms, "
        note += (
            "of all steps together. There: how likely it is, in this place or beside another."
            if posterior
            else "which took part in the choice; p is the chance in the whole search."
        )
    else:
        note = (
            "p is the chance in the whole search. Held out: what each half of the data gains by "
            "the effect as the other half has it. Residuals: median absolute deviation, held out."
        )
    return Table("Steps of the loop", header, rows, align, note)


def _others(step: FoundStep) -> str:
    """What may stand in a step's place, with its share where there is one."""
    if not step.rivals:
        return ", ".join(step.aliases)
    return ", ".join(f"{n} {per_cent(s)}" for n, s in step.rivals if n != step.effect)


def _changes(step: FoundStep) -> tuple[str, ...]:
    if len(step.checks) == 1:
        (check,) = step.checks
        return f"{check.before:.{check.digits}f}", f"{check.after:.{check.digits}f}"
    return tuple(f"{c.before:.{c.digits}f} -> {c.after:.{c.digits}f}" for c in step.checks)


def _upper(text: str) -> str:
    return text[0].upper() + text[1:]
