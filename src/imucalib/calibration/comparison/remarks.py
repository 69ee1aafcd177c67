"""What a reader must know before believing a comparison."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.units import MG


def mounted(calibration: Calibration) -> bool:
    """Whether a calibration ties a frame to a tool."""
    return any(p.effect == "mounting" for p in calibration.parameters)


def remarks(
    calibrations: Sequence[Calibration], names: Sequence[str], *, framed: bool
) -> tuple[str, ...]:
    """One sentence each. framed : whether directions can be compared."""
    notes = []
    provenance = [c.facts.get("provenance") or {} for c in calibrations]
    inputs = [set(b.get("inputs_sha256") or [b.get("sha256")]) - {None, ""} for b in provenance]
    if len(set().union(*inputs)) < sum(map(len, inputs)):
        notes.append(
            "two of them were made from the same recording: their errors are shared, so the "
            "standard deviations of the difference are too large and p too near 1"
        )
    gravities = [c.gravity for c in calibrations]
    if np.ptp(gravities) > 1e-9:
        size = np.ptp(gravities) / MG
        notes.append(
            f"they assume gravities {size:.2g} mg apart ({_each(gravities)} m/s²): right where "
            "they were recorded in different places, else this difference is in all scales"
        )
    units = [f"{c.raw_unit}" for c in calibrations]
    scales = {c.raw_to_si for c in calibrations}
    if len(scales) > 1:
        notes.append(f"their readings are in {', '.join(units)}: compared in m/s²")
    makers = [c.calibrator for c in calibrations]
    if len(set(makers)) > 1:
        notes.append(f"they were made by {', '.join(makers)}")
    if not framed:
        tied = [n for n, c in zip(names, calibrations, strict=True) if mounted(c)]
        notes.append(
            f"only {', '.join(tied)} tie{'s' * (len(tied) == 1)} a frame to a tool: directions are "
            "not compared"
        )
    notes += [
        f"status of {name}: {c.status}" + (f" ({'; '.join(c.reasons)})" if c.reasons else "")
        for name, c in zip(names, calibrations, strict=True) if c.status != "ok"
    ]  # fmt: skip
    return tuple(notes)


def _each(gravities: Sequence[float]) -> str:
    return ", ".join(f"{g:.5f}" for g in gravities)
