"""What to do about what an inspection found: each line names the option or command to use."""

from __future__ import annotations

import math
from collections.abc import Iterator

from imucalib.inspection.inspection import ChannelFacts, Inspection
from imucalib.readers.zero_g import zero_g
from imucalib.rests.refused import refusals
from imucalib.units import STANDARD_GRAVITY

_FAR = 0.1  # a norm at rest this far from 1 g (relative) is a wrong unit or scale, not a bad sensor
_LONG_GAPS = 0.01  # share of the recording


def problems(found: Inspection) -> tuple[str, ...]:
    """What stands against a calibration or a correction, most serious first."""
    return tuple(_problems(found))


def _problems(found: Inspection) -> Iterator[str]:
    accelerometers = _of(found, "acceleration")
    if not accelerometers:
        yield "there is no acceleration in it"
    unscaled = [f.triad for f in accelerometers if f.unit != "m/s2"]
    if unscaled:
        yield f"no scale is known for the acceleration of {_some(unscaled)}"
    if accelerometers and (found.still is None or not found.still.n):
        candidates = found.still.candidates if found.still else ()
        yield found.why_not_still or f"no rest in it: {refusals(candidates)}"
    off = [f.triad for f in accelerometers if f.unit == "m/s2" and _is_off(f)]
    if off:
        yield f"the norm at rest of {_some(off)} is not that of gravity"
    if found.repeats:
        held = [note.partition(":")[0] for note in found.repeats]
        yield f"samples of {_some(held)} repeat the one before (notes below)"
    if found.losses:
        count = len(found.losses)
        yield f"part of it is lost ({count} note{'s' if count > 1 else ''} below)"
    elif found.gap_seconds > _LONG_GAPS * found.span:
        share = 100 * found.gap_seconds / found.span if found.span else 100.0
        yield f"gaps take {share:.0f} % of it"


def advice(found: Inspection) -> tuple[tuple[str, str], ...]:
    """What to give or run next, and why."""
    return tuple(_advice(found))


def _advice(found: Inspection) -> Iterator[tuple[str, str]]:
    accelerometers = _of(found, "acceleration")
    counts = [f for f in accelerometers if f.unit != "m/s2"]
    if counts:
        yield _scale(counts[0], found)
    if any(f.unit == "m/s2" and _is_off(f) for f in accelerometers):
        yield "--unit UNIT", "m/s2, g, mg, ug or counts, if the unit above is wrong"
    if any(f.unit == "counts" for f in _of(found, "angular_rate")):
        yield "--gyro-unit deg/s", "or rad/s: the file states no unit for the angular rate"
    if found.still is not None and any(c.reason for c in found.still.candidates):
        yield "--rests", "lists what came near a rest, and what refused it"
    if found.losses:
        yield "--strict", "refuses this file instead of reading what is left"
    if len(accelerometers) > 1:
        yield "--triad NAME", "apply corrects one sensor, named as above"
    yield "--save-mapping FILE", "keeps this reading; --mapping FILE repeats it"


def _scale(counts: ChannelFacts, found: Inspection) -> tuple[str, str]:
    """Options that give an accelerometer in counts its scale."""
    why, norm = "with --unit counts: counts a g by the data sheet", counts.norm_at_rest
    if found.still is not None and counts.triad in found.still.triads:
        away = zero_g(found.still.mean[:, found.still.triads.index(counts.triad)])
        if away is not None:
            return "--acc-offset", f"{away.sentence}; try {away.option}"
    if not math.isfinite(norm):
        return "--lsb N", why
    return f"--lsb {norm:.0f}", f"{why}; the norm at rest is that many counts"


def _of(found: Inspection, quantity: str) -> list[ChannelFacts]:
    return [f for f in found.channels if f.quantity == quantity]


def _is_off(facts: ChannelFacts) -> bool:
    return abs(facts.norm_at_rest / STANDARD_GRAVITY - 1.0) > _FAR  # False for NaN: no rest


def _some(names: list[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
