"""Coefficients for other programs: each module of this folder that has an `EXPORT` writes one form.

A form is found by its file being here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import demand_settled
from imucalib.core.discovery import modules_of
from imucalib.errors import UsageError
from imucalib.recording.pairing import printable


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
    return {m.EXPORT.name: m.EXPORT for m in modules_of(__name__) if hasattr(m, "EXPORT")}


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
