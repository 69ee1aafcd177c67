"""Sizes that a user states with their unit: "2mg", "0.1deg", "0.5deg/s", "0.2mm"."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from imucalib.errors import UsageError

#: What a size of each unit is about.
UNITS: dict[str, str] = {"mg": "force", "deg": "direction", "deg/s": "rate", "mm": "position"}


@dataclass(frozen=True)
class Limits:
    """What matters, by what it is about; None where nothing was stated.

    force : mg; direction : deg; rate : deg/s; position : mm
    """

    force: float | None = None
    direction: float | None = None
    rate: float | None = None
    position: float | None = None


def size_of(text: str, units: Mapping[str, str] = UNITS) -> tuple[float, str]:
    """Number and unit of "2mg". Raises UsageError."""
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(\S+)\s*", text)
    try:
        number = float(match[1]) if match else math.nan
    except ValueError:
        number = math.nan
    if match is None or match[2] not in units or not 0.0 < number < math.inf:
        raise UsageError(
            f"'{text}' is no size above zero with one of the units {', '.join(units)}",
            remedy=f"write it as one word, for example 0.5{next(iter(units))}",
        )
    return number, match[2]


def limits_of(texts: Sequence[str]) -> Limits:
    """The limits that a user stated, each once. Raises UsageError."""
    found: dict[str, float] = {}
    for text in texts:
        number, unit = size_of(text)
        if UNITS[unit] in found:
            raise UsageError(f"two limits in {unit}", remedy="state each once")
        found[UNITS[unit]] = number
    return Limits(**found)


def sessions_of(texts: Sequence[str]) -> dict[str, float]:
    """Scatter between power-ups by the kind of change: bias (mg), mounting (deg). Raises
    UsageError."""
    sizes = [size_of(text, {"mg": "bias", "deg": "mounting"}) for text in texts]
    return {"bias" if unit == "mg" else "mounting": size for size, unit in sizes}
