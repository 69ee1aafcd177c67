"""What limits a worn sensor's calibration, and what to record to lift the limit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from imucalib.calibration.outcome import Limit
from imucalib.calibration.power import advice_of, hidden
from imucalib.calibrators.actigraph.calibrate import ActigraphResult
from imucalib.calibrators.actigraph.coverage import Coverage
from imucalib.calibrators.actigraph.errors import mean_error
from imucalib.calibrators.actigraph.weak import open_words
from imucalib.core.context import CLOCKS
from imucalib.effects.shape import in_words
from imucalib.loop.found import FitLoop
from imucalib.units import MG

#: The field calls a calibration good below this error (mg); a tenth of it is well known.
_GOOD, _WELL_KNOWN = 10.0, 1.0
#: What to do about what moves with time, by its kind, or where no temperature was recorded, the
#: most telling first.
_TOLD = {
    "cold": "The error moves with time and no temperature was recorded: export the temperature "
    "channel too, or calibrate in parts with --every 1d.",
    "probe": "The error moves with time, in too few stretches to prove a cause: --every 6h shows "
    "which parts differ, a longer recording whether it comes back.",
}


def reasons(result: ActigraphResult, coverage: Coverage) -> tuple[str, ...]:
    """Why the calibration is not simply good."""
    found = [coverage_words(result, coverage)] if result.weak else []
    missing, largest = coverage.unseen, coverage.worst_sd
    if largest > _WELL_KNOWN and not result.weak:
        where = f"; no posture with {', '.join(missing)}" if missing else ""
        found.append(f"the error in some directions is known to {largest:.1f} mg only{where}")
    held = mean_error(result.final_held)
    if held > _GOOD:
        found.append(f"the held-out error of {held:.1f} mg is above the field's 10 mg")
    raw = result.error.held_out.raw
    if held > raw:
        found.append(f"on held-out time it is worse than no calibration ({raw:.2f} mg)")
    if result.light > 0.02 * result.runs.n:
        found.append(
            f"{result.light} of {result.runs.n} posture runs are unlike the rest and count less"
        )
    return tuple(found)


def coverage_words(result: ActigraphResult, coverage: Coverage) -> str:
    """What weak coverage of the sphere leaves open, in the field's terms."""
    missing = coverage.unseen
    count = f"{result.runs.n} posture run" + "s" * (result.runs.n != 1)
    never = f" (never {', '.join(missing)})" if missing else ""
    text = f"weak coverage of the sphere: {count}{never} leave open {open_words(result.base)}"
    if result.beside_fleet:
        text += "; what is open stays as devices of its kind have it"
    elif result.base.prior is not None:
        text += "; what is open stays near its nominal value, with a data sheet's uncertainty"
    return f"{text}; |a| is known to {coverage.worst_sd:.1f} mg in the worst direction"


def advice(result: ActigraphResult, coverage: Coverage) -> tuple[str, ...]:
    """The next steps, most useful first."""
    found = []
    missing = coverage.unseen
    if result.beside_fleet:
        found.append("What the model lacks is not searched for beside a fleet.")
    elif result.weak and result.loop is None:
        found.append(
            "What the nine parameters lack was not searched for: that takes postures which "
            "determine all of them."
        )
    elif result.few:
        found.append(
            "What the nine parameters lack was not searched for: that takes twice as many posture "
            "runs as parameters."
        )
    if missing and coverage.worst_sd > _WELL_KNOWN:
        found.append(
            f"Rest the sensor for ten seconds with {', '.join(missing)}, or record more nights."
        )
    elif coverage.worst_sd > _WELL_KNOWN:
        found.append("More postures at rest, in new directions, make the parameters better known.")
    loop = result.loop
    if loop is not None:
        found += _open_ends(loop, warm="temperature" in result.final.observations.context)
        found += advice_of(hidden(loop.scores, loop.final.model.names))
    return tuple(found)


def _open_ends(loop: FitLoop, *, warm: bool) -> list[str]:
    """What to do about what the search left open; warm : whether a temperature was recorded."""
    kinds = {u.kind for u in loop.unexplained if u.driver in CLOCKS}
    if kinds and not warm:
        kinds.add("cold")
    kind = next((kind for kind in _TOLD if kind in kinds), "")
    found = [_TOLD[kind]] if kind else []
    if loop.steps and loop.steps[0].aliases:
        step = loop.steps[0]
        name = in_words(step.effect)
        found.append(
            f"{name[0].upper()}{name[1:]} cannot be told from "
            f"{', '.join(map(in_words, step.aliases))}: "
            "both correct this recording alike; a longer one, with more postures, separates them."
        )
    return found


def limits_of(result: ActigraphResult, asked: Mapping[str, float]) -> tuple[Limit, ...]:
    """The user's limits against what was found."""
    held = mean_error(result.final_held)
    value = {
        "max-error": held,
        "max-worst-error": float(np.abs(result.final_held.error).max()) / MG,
    }
    return tuple(Limit(name, value[name], limit, "mg") for name, limit in asked.items())
