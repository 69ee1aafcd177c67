"""How much of a calibration a form may lose unasked."""

from __future__ import annotations

import math

from imucalib.calibration.calibration import Calibration
from imucalib.errors import LimitBroken, NotConverged, UsageError
from imucalib.exports import Made, export
from imucalib.units import DEG, MG

_TO_MG = {"mg": 1.0, "m/s²": 1.0 / MG}
_TO_RATE = {"deg/s": 1.0, "rad/s": 1.0 / DEG}


def demand_carried(
    made: Made,
    form: str,
    calibration: Calibration,
    largest: float | None,
    largest_rate: float | None = None,
) -> None:
    """Raise LimitBroken for a calibration that leaves a question open, and where a form loses more
    than `largest` mg of a force or `largest_rate` deg/s of a rate; None: where what it loses and
    what the calibration leaves are together no less than the error of the raw reading, which is
    what the device has without it."""
    open_ = calibration.facts.get("undecided", ())
    if open_ or calibration.status in ("weak", "failed"):
        why = "; ".join(open_) or "; ".join(calibration.reasons) or calibration.status
        raise LimitBroken(
            f"this calibration is not decided: {why}",
            remedy="settle that and calibrate again, or write it all the same with --force",
        )
    allowed = str(math.ceil(made.loss))
    for lost, bound, units, unit, words in (
        (made.loss, largest, _TO_MG, "mg", allowed),
        (
            made.rate_loss,
            largest_rate,
            _TO_RATE,
            "deg/s",
            f"{allowed},{math.ceil(made.rate_loss)}",
        ),
    ):
        most, why = bound, ""
        if most is None:
            raw, left = (calibration.find_error(units, of) for of in ("raw", "final"))
            most = math.sqrt(max(raw**2 - min(left, raw) ** 2, 0.0))
            why = f": {raw:.3g} {unit} without a calibration, {left:.3g} {unit} with all of it"
        if lost > most:
            raise LimitBroken(
                f"{form} loses {lost:.3g} {unit}, more than {most:.3g} {unit}{why}; "
                + "; ".join(made.lost),
                remedy="write it all the same with --force, or allow more with `imucal export "
                f"--largest-loss {words}`; imucal apply carries everything",
            )


def carries(calibration: Calibration, form: str) -> bool:
    """Whether a form is written unasked."""
    try:
        demand_carried(export(calibration, "", form), form, calibration, None)
    except (LimitBroken, NotConverged, UsageError):
        return False
    return True
