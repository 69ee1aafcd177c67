"""How much of a calibration a form may lose unasked."""

from __future__ import annotations

import math

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.errors import LimitBroken, NotConverged, UsageError
from imucalib.exports import Made, exported
from imucalib.units import DEG, MG

#: Of what the calibration leaves: there, nine tenths of an exported correction's variance are the
#: form's.
_TIMES = 3.0
_TO_MG = {"mg": 1.0, "m/s²": 1.0 / MG}
_TO_RATE = {"deg/s": 1.0, "rad/s": 1.0 / DEG}


def demand_carried(
    made: Made,
    form: str,
    calibration: Calibration,
    largest: float | None,
    largest_rate: float | None = None,
) -> None:
    """Raise LimitBroken where a form loses more than `largest` mg of a force or `largest_rate`
    deg/s of a rate; None: than three times the error that the calibration itself leaves."""
    allowed = str(math.ceil(made.loss))
    for lost, bound, own, unit, words in (
        (made.loss, largest, _error_left(calibration), "mg", allowed),
        (
            made.rate_loss,
            largest_rate,
            _rate_left(calibration),
            "deg/s",
            f"{allowed},{math.ceil(made.rate_loss)}",
        ),
    ):
        most, why = bound, ""
        if most is None:
            most = _TIMES * own
            why = f", three times the {own:.2g} {unit} that the calibration leaves"
        if lost > most:
            raise LimitBroken(
                f"{form} loses {lost:.3g} {unit}, more than {most:.3g} {unit}{why}: "
                + "; ".join(made.lost),
                remedy="write it all the same with --force, or allow more with `imucal export "
                f"--largest-loss {words}`; imucal apply carries everything",
            )


def carries(calibration: Calibration, form: str) -> bool:
    """Whether a form is written unasked."""
    try:
        demand_carried(exported(calibration, "", form), form, calibration, None)
    except (LimitBroken, NotConverged, UsageError):
        return False
    return True


def _error_left(calibration: Calibration) -> float:
    """mg that the calibration leaves of a force: held out, else fitted, else the standard deviation
    of its biases; infinite where nothing is known."""
    known = _stated(calibration, _TO_MG)
    if known is None and not calibration.triads:
        known = float(np.linalg.norm(calibration.matrices().bias_mg_sd)) or None
    return math.inf if known is None else known


def _rate_left(calibration: Calibration) -> float:
    """deg/s that an array's calibration leaves of a rate: held out, else fitted, else the gyros'
    noise at rest; infinite where nothing is known."""
    if (known := _stated(calibration, _TO_RATE)) is not None:
        return known
    noise = [triad.gyro_noise / DEG for triad in calibration.triads]
    return float(np.sqrt(np.mean(np.square(noise)))) if any(noise) else math.inf


def _stated(calibration: Calibration, units: dict[str, float]) -> float | None:
    """The first error in one of the units, in that of the factors."""
    for error in calibration.facts.get("errors", ()):
        if factor := units.get(error["unit"]):
            for value in (error["held_out"].get("final"), error.get("final")):
                if value is not None and math.isfinite(value):
                    return float(value) * factor
    return None
