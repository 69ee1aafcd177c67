"""Coefficients for other programs: each module of this folder that has an `EXPORT` writes one form.

A form is found by its file being here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import write_whole
from imucalib.discovery import modules_of


@dataclass(frozen=True)
class Export:
    """One form: its name on the command line, the file it makes, and the text of that file from a
    calibration and the name of the recording that it came from."""

    name: str
    file: str
    text: Callable[[Calibration, str], str]


@cache
def exports() -> dict[str, Export]:
    """Every form by name."""
    return {m.EXPORT.name: m.EXPORT for m in modules_of(__name__) if hasattr(m, "EXPORT")}


def write_exports(
    calibration: Calibration, source: Path, formats: tuple[str, ...], folder: Path
) -> tuple[Path, ...]:
    """Write the coefficients in the forms that are named; returns the paths."""
    paths = []
    for name in formats:
        form = exports()[name]
        write_whole(folder / form.file, form.text(calibration, source.name))
        paths.append(folder / form.file)
    return tuple(paths)
