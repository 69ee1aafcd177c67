"""What the report of a sensor at rest keeps for a later plan: its reference, its noise, its
covariates, and what it left ambiguous."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imucalib.calibration.ambiguity import ambiguity_block, ambiguity_of
from imucalib.core.context import Context
from imucalib.core.fit import Fit
from imucalib.core.known_direction import KnownDirection
from imucalib.core.references import KnownNorm, KnownVector
from imucalib.errors import UnreadableInput
from imucalib.loop.separation.products import Ambiguity

_KINDS = {KnownVector: "vector", KnownDirection: "direction", KnownNorm: "norm"}


@dataclass(frozen=True)
class Span:
    """A covariate of a recording: its last value, its smallest and its largest."""

    last: float
    low: float
    high: float


@dataclass(frozen=True)
class Recorded:
    """reference : "vector", "direction" or "norm"; gravity, reading : m/s², the latter the noise of
    one reading; settings : component -> rad; wander : mg, by which the bias may have moved when
    the next recording begins; rows : of the table; sweeps : as in a context"""

    reference: str
    gravity: float
    reading: float
    settings: Mapping[str, float]
    wander: float
    rows: int
    sweeps: int
    covariates: Mapping[str, Span]
    ambiguities: tuple[Ambiguity, ...]


def recorded_block(
    fit: Fit, found: Sequence[Ambiguity], reading: float, settings: Mapping[str, float],
    wander: float = 0.0,
) -> dict[str, Any]:  # fmt: skip
    """The block of a finished run; `recorded_of` reads it back. See `Recorded`."""
    data, reference = fit.observations, fit.observations.reference
    assert isinstance(reference, KnownVector | KnownDirection | KnownNorm)
    return {
        "reference": _KINDS[type(reference)],
        "gravity_m_per_s2": reference.gravity,
        "reading_m_per_s2": reading,
        "settings_rad": dict(settings),
        "wander_mg": wander,
        "rows": data.n,
        "sweeps": data.context.sweeps,
        "covariates": _spans(data.context),
        "ambiguities": [ambiguity_block(one) for one in found],
    }


def _spans(context: Context) -> dict[str, dict[str, float]]:
    return {
        name: {"last": float(v[-1]), "low": float(np.min(v)), "high": float(np.max(v))}
        for name, v in context.covariates.items()
        if np.ndim(v) == 1
    }


def recorded_of(block: Mapping[str, Any], where: str) -> Recorded:
    """Read the block. Raises UnreadableInput where it is damaged."""
    try:
        return Recorded(
            reference=str(block["reference"]),
            gravity=float(block["gravity_m_per_s2"]),
            reading=float(block["reading_m_per_s2"]),
            settings={str(k): float(v) for k, v in block["settings_rad"].items()},
            wander=float(block["wander_mg"]),
            rows=int(block["rows"]),
            sweeps=int(block["sweeps"]),
            covariates={
                str(name): Span(float(v["last"]), float(v["low"]), float(v["high"]))
                for name, v in block["covariates"].items()
            },
            ambiguities=tuple(ambiguity_of(one) for one in block["ambiguities"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UnreadableInput(f"what a plan needs is damaged: {error!r}", where=where) from None
