"""How much of a calibration a form may lose unasked."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.errors import LimitBroken, UsageError
from imucalib.exports import Exported, exported
from imucalib.units import MG

#: Of what the calibration leaves: there, nine tenths of an exported correction's variance are the
#: form's.
_TIMES = 3.0
_TO_MG = {"mg": 1.0, "m/s²": 1.0 / MG}


def demand_carried(
    made: Exported, form: str, calibration: Calibration, largest: float | None
) -> None:
    """Raise LimitBroken where a form loses more than `largest` mg; None: than three times the error
    that the calibration itself leaves."""
    if largest is not None:
        bound, why = largest, ""
    else:
        left = error_left(calibration)
        bound, why = _TIMES * left, f", three times the {left:.2g} mg that the calibration leaves"
    if made.made.loss > bound:
        raise LimitBroken(
            f"{form} loses {made.made.loss:.3g} mg, more than {bound:.3g} mg{why}: "
            + "; ".join(made.lost),
            remedy="write it all the same with --force, or allow more with `imucal export "
            f"--largest-loss {math.ceil(made.made.loss)}`; imucal apply carries everything",
        )


def carries(calibration: Calibration, form: str) -> bool:
    """Whether a form is written unasked."""
    try:
        demand_carried(exported(calibration, "", form), form, calibration, None)
    except (LimitBroken, UsageError):
        return False
    return True


def error_left(calibration: Calibration) -> float:
    """mg that the calibration leaves of a force: held out, else fitted, else the standard deviation
    of its biases; infinite where nothing is known."""
    for error in calibration.facts.get("errors", ()):
        if to_mg := _TO_MG.get(error["unit"]):
            for value in (error["held_out"].get("final"), error.get("final")):
                if _known(value):
                    return float(value) * to_mg
    if calibration.triads:
        return math.inf
    sd = float(np.linalg.norm(calibration.matrices().bias_mg_sd))
    return sd if sd > 0.0 else math.inf


def _known(value: Any) -> bool:
    return value is not None and math.isfinite(value)
