"""What simulations plant: effects into a sensor, and faults of a set-up into a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context
from imucalib.core.model import Model
from imucalib.effects import named
from imucalib.errors import UsageError
from imucalib.recording.recording import Channel, Gap, Recording
from imucalib.units import STANDARD_GRAVITY

_KINDS = "gap@START:LENGTH, freeze@START:LENGTH, sign@SENSOR:AXIS, clip@G, exchange@SENSOR:SENSOR"
_PARTS = {"gap": 2, "freeze": 2, "sign": 2, "clip": 1, "exchange": 2}
_NUMBERS = ("gap", "freeze", "clip")


def plant_model(sizes: Mapping[str, tuple[float, ...]], context: Context) -> tuple[Model, Array]:
    """A model of some effects, by name, and its θ of their sizes, in their parameters' units.
    Raises UsageError for a wrong number of parameters, and for what these data do not carry."""
    model = Model(tuple(named(name) for name in sizes))
    theta, slices = model.start(context), model.slices(context)
    for name, values in sizes.items():
        effect, part = named(name), slices[name]
        if len(values) != part.stop - part.start:
            names = ", ".join(p.name for p in effect.parameters(context))
            raise UsageError(f"{name} has {part.stop - part.start} parameters: {names}")
        if reason := effect.missing(context):
            raise UsageError(f"{name} cannot be planted: {reason}")
        theta[part] = values
    return model, theta


@dataclass(frozen=True)
class PlantedFault:
    """gap, freeze : from a time (s) on for a length (s); sign : one axis of one accelerometer is
    inverted; clip : readings beyond so many g are lost; exchange : two sensors' names

    numbers : where, of a kind that counts"""

    kind: str
    where: tuple[str, ...]
    numbers: tuple[float, ...] = ()


def fault_of(text: str) -> PlantedFault:
    """ "gap@100:20" as a fault. Raises UsageError for what is none."""
    kind, at, rest = text.partition("@")
    parts = tuple(rest.split(":"))
    if not at or _PARTS.get(kind) != len(parts):
        raise UsageError(f"'{text}' is no fault", remedy=f"give {_KINDS}")
    if kind == "sign" and parts[1] not in ("x", "y", "z"):
        raise UsageError(f"'{text}': the axis is x, y or z")
    numbers = tuple(map(_number, parts)) if kind in _NUMBERS else ()
    for part, number in zip(parts, numbers, strict=False):
        if not number >= 0.0:
            raise UsageError(f"'{text}': '{part}' is no time or size")
    return PlantedFault(kind, parts, numbers)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def with_faults(recording: Recording, faults: Sequence[PlantedFault]) -> Recording:
    """The recording as these faults leave it. Raises UsageError for a sensor that it lacks."""
    triads = {c.triad for c in recording.channels.values()}
    for fault in faults:
        names = {"sign": fault.where[:1], "exchange": fault.where}.get(fault.kind, ())
        unknown = [name for name in names if name not in triads]
        if unknown:
            raise UsageError(f"no sensor {unknown[0]}", remedy=f"there are: {sorted(triads)}")
        channels = {name: _with(c, fault) for name, c in recording.channels.items()}
        if fault.kind == "exchange":
            other = dict(zip(fault.where, fault.where[::-1], strict=True))
            turned = {}
            for name, c in channels.items():
                triad = other.get(c.triad, c.triad)
                turned[name.replace(c.triad, triad, 1)] = replace(c, triad=triad)
            channels = {name: turned[name] for name in channels}
        if fault.kind == "gap":
            start, length = fault.numbers
            gap = Gap(start, start + length, "planted")
            recording = replace(recording, gaps=(*recording.gaps, gap))
        recording = replace(recording, channels=channels)
    return recording


def _with(channel: Channel, fault: PlantedFault) -> Channel:
    values, own = channel.values.copy(), channel.quantity == "acceleration"
    if fault.kind in ("gap", "freeze"):
        start, length = fault.numbers
        inside = (channel.t >= start) & (channel.t < start + length)
        if fault.kind == "gap":
            return replace(channel, t=channel.t[~inside], values=values[~inside])
        values[inside] = values[inside][:1]
    elif fault.kind == "sign" and own and channel.triad == fault.where[0]:
        values[:, "xyz".index(fault.where[1])] *= -1.0
    elif fault.kind == "clip" and own:
        size = fault.numbers[0] * STANDARD_GRAVITY
        values = np.clip(values, -size, size)
    return replace(channel, values=values)
