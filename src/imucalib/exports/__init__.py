"""Coefficients for other programs: each `Export` in a module of this folder is one form.

A form is found by its file being here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import demand_settled
from imucalib.core.discovery import modules_of
from imucalib.errors import LimitBroken, NotConverged, UsageError
from imucalib.recording.pairing import printable
from imucalib.units import DEG, MG

_TO_MG = {"mg": 1.0, "m/s²": 1.0 / MG}
_TO_RATE = {"deg/s": 1.0, "rad/s": 1.0 / DEG}


@dataclass(frozen=True)
class Made:
    """A form's text; what of the calibration it could not carry, in words; and the error of a force
    that this makes, mg: mean over directions and the calibrated ranges, of an array the rms in the
    motion that was calibrated; rate_loss : of a rate there, deg/s. files : name -> text, where the
    other program reads one file an IMU and there are several; the text then holds all. file : its
    usual name."""

    text: str
    lost: tuple[str, ...] = ()
    loss: float = 0.0
    rate_loss: float = 0.0
    files: Mapping[str, str] = field(default_factory=dict)
    file: str = ""


@dataclass(frozen=True)
class Export:
    """One form: its name on the command line, the file it makes, and how from a calibration and the
    name of the recording that it came from. Raises UsageError for a calibration that it cannot
    hold."""

    name: str
    file: str
    make: Callable[[Calibration, str], Made]


@cache
def exports() -> dict[str, Export]:
    """Every form by name."""
    every = (one for module in modules_of(__name__) for one in vars(module).values())
    forms = {one.name: one for one in every if isinstance(one, Export)}
    return dict(sorted(forms.items()))


def export(calibration: Calibration, source: str, name: str) -> Made:
    """A calibration in the form that is named.

    Raises UsageError for an unknown form and for a calibration that it cannot hold, NotConverged
    for the numbers of a fit that did not settle.
    """
    demand_settled(calibration, source)
    if name not in exports():
        raise UsageError(f"no form is called '{name}'", remedy=f"use: {', '.join(exports())}")
    form = exports()[name]
    # Names in a calibration were checked when it was read; a file's name may be anything.
    return replace(form.make(calibration, printable(source)), file=form.file)


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
