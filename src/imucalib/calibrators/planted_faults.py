"""Faults of a set-up, planted into a simulated recording: what a program must tell, not fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UsageError
from imucalib.recording.recording import Channel, Gap, Recording
from imucalib.units import STANDARD_GRAVITY

_KINDS = "gap@START:LENGTH, freeze@START:LENGTH, sign@SENSOR:AXIS, clip@G, exchange@SENSOR:SENSOR"


@dataclass(frozen=True)
class Fault:
    """gap, freeze : from a time (s) on for a length (s); sign : one axis of one accelerometer is
    inverted; clip : readings beyond so many g are lost; exchange : two sensors' names"""

    kind: str
    where: tuple[str, ...]


def fault_of(text: str) -> Fault:
    """ "gap@100:20" as a fault. Raises UsageError for what is none."""
    kind, at, rest = text.partition("@")
    parts = tuple(rest.split(":"))
    needed = {"gap": 2, "freeze": 2, "sign": 2, "clip": 1, "exchange": 2}.get(kind)
    if not at or needed != len(parts):
        raise UsageError(f"'{text}' is no fault", remedy=f"give {_KINDS}")
    if kind in ("gap", "freeze", "clip"):
        for number in parts:
            _number(number, text)
    if kind == "sign" and parts[1] not in ("x", "y", "z"):
        raise UsageError(f"'{text}': the axis is x, y or z")
    return Fault(kind, parts)


def _number(text: str, whole: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not value >= 0.0:
        raise UsageError(f"'{whole}': '{text}' is no time or size")
    return value


def with_faults(recording: Recording, faults: Sequence[Fault]) -> Recording:
    """The recording as these faults leave it. Raises UsageError for a sensor that it lacks."""
    triads = {c.triad for c in recording.channels.values()}
    for fault in faults:
        named = {"sign": fault.where[:1], "exchange": fault.where}.get(fault.kind, ())
        unknown = [name for name in named if name not in triads]
        if unknown:
            raise UsageError(f"no sensor {unknown[0]}", remedy=f"there are: {sorted(triads)}")
        recording = _with(recording, fault)
    return recording


def _with(recording: Recording, fault: Fault) -> Recording:
    channels = dict(recording.channels)
    if fault.kind == "exchange":
        names = dict(zip(fault.where, fault.where[::-1], strict=True))
        turned = {}
        for name, c in channels.items():
            triad = names.get(c.triad, c.triad)
            turned[name.replace(c.triad, triad, 1)] = replace(c, triad=triad)
        return replace(recording, channels={name: turned[name] for name in channels})
    if fault.kind == "gap":
        start, length = float(fault.where[0]), float(fault.where[1])
        kept = {name: _without(c, start, start + length) for name, c in channels.items()}
        gap = Gap(start, start + length, "planted")
        return replace(recording, channels=kept, gaps=(*recording.gaps, gap))
    for name, c in channels.items():
        channels[name] = replace(c, values=_values(c, fault))
    return replace(recording, channels=channels)


def _without(channel: Channel, start: float, stop: float) -> Channel:
    keep = (channel.t < start) | (channel.t >= stop)
    return replace(channel, t=channel.t[keep], values=channel.values[keep])


def _values(channel: Channel, fault: Fault) -> Array:
    values, own = channel.values.copy(), channel.quantity == "acceleration"
    if fault.kind == "freeze":
        start, length = float(fault.where[0]), float(fault.where[1])
        rows = np.flatnonzero((channel.t >= start) & (channel.t < start + length))
        values[rows] = values[rows[:1]]
    elif fault.kind == "sign" and own and channel.triad == fault.where[0]:
        values[:, "xyz".index(fault.where[1])] *= -1.0
    elif fault.kind == "clip" and own:
        size = float(fault.where[0]) * STANDARD_GRAVITY
        values = np.clip(values, -size, size)
    return values
