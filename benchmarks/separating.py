"""Plans that separate rivals, beside plans that do not: what the benchmarks of benches and of worn
sensors have in common."""

from __future__ import annotations

import numpy as np

from imucalib.effects.shape import is_form
from imucalib.loop.found import FitLoop
from imucalib.loop.separation.choice import Pool, exchanged, informative, one_by_one
from imucalib.loop.separation.plan import Separation
from imucalib.loop.separation.products import Ambiguity


def right(loop: FitLoop | None, truth: str) -> str:
    """ "alone", "form" where a form without a cause stands beside the name, or nothing."""
    steps = loop.named if loop else ()
    if len(steps) != 1 or steps[0].effect != truth:
        return ""
    beside = [name for name in steps[0].aliases if not is_form(name)]
    return "" if beside else "form" if steps[0].aliases else "alone"


def told_of(made: Separation, ambiguity: Ambiguity, truth: str) -> dict[str, object]:
    """What a plan promises."""
    return {
        "rests": len(made.plan),
        "first": made.soon.count if made.soon else len(made.plan),
        "now": float(made.now.min(initial=np.inf)),
        "apart": made.least,
        "promised": made.ended.get(truth, 0.0),
        "informative": made.informative,
        "random": made.random,
        "rivals": tuple(ambiguity.rivals),
    }


def best_of(ambiguity: Ambiguity, pool: Pool, count: int) -> np.ndarray:
    """The plan that determines the base model's parameters best."""
    worth = informative(ambiguity.products.gram, ambiguity.first)
    return np.array(exchanged(pool, one_by_one(pool, worth, count), worth))


def row(head: tuple[str, ...], devices: int, told: list[dict]) -> str:
    """A line of the table: medians, and how often the name is right and alone."""
    few = [o for o in told if 0 < o["rests"] <= 8]
    rests = np.median([o["rests"] for o in told])
    now, then = (np.median([o[k] for o in told]) for k in ("now", "apart"))
    longer = [o["rests"] * 8 + 1 for o in told]
    other = [
        np.median([o[k].needed or most for o, most in zip(told, longer, strict=True)])
        for k in ("informative", "random")
    ]
    ways = ("right", "right first", "informative 2", "random 2")
    first = np.median([o["first"] for o in told])
    counts = [
        f"{sum(o.get(way) == 'alone' for o in told)} + {sum(o.get(way) == 'form' for o in told)}"
        for way in ways
    ]
    cells = [*head, f"{len(told)} of {devices}", f"{rests:.0f}", f"{now:.1f} -> {then:.1f}",
             f"{100.0 * np.mean([o['promised'] for o in told]):.0f}", counts[0],
             f"{first:.0f}", counts[1], f"{len(few)}",
             *(f"{v:.0f}" for v in other), *counts[2:]]  # fmt: skip
    return "| " + " | ".join(cells) + " |"
