"""What a flight controller did to the readings that its log holds, and the parameters that go on
from there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np

from imucalib.arrays import Array
from imucalib.data import Data
from imucalib.errors import UsageError

#: Of a controller's law over temperature: in the readings, or only for what comes after them.
TAKEN, AHEAD = "taken", "ahead"
#: No offset is larger, in SI units, and no scale or its inverse.
_MOST = 1e3


class Onboard(Data, sparse=True):
    """In a flight controller, whose log has scale (raw - offset) of the sensor.

    slot : from 0; device : 0 where the log does not say
    offset, scale : (3,), empty where none are known to act; law : `TAKEN` or `AHEAD`, or empty
    """

    slot: Annotated[int, "Number in its parameters."] = 0
    device: Annotated[int, "Its id."] = 0
    offset: Annotated[tuple[float, ...], "In SI units."] = ()
    scale: tuple[float, ...] = ()
    law: Annotated[str, "A stored one over temperature: taken off before, or ahead."] = ""
    fault: Annotated[str, "Why no parameters are composed."] = ""

    def compose(self, offset: Array, scale: Array) -> tuple[Array, Array]:
        """(3,) offset and scale that correct what the sensor read as (value - offset) scale does
        what the log has. Raises UsageError where there are none."""
        if self.fault:
            raise UsageError(
                f"the parameters of its log cannot be composed with these: {self.fault}",
                remedy="record again without, or use c-header",
            )
        before, by = np.array(self.offset or np.zeros(3)), np.array(self.scale or np.ones(3))
        return before + offset / by, by * scale

    def demand_law(self, *, own: bool) -> None:
        """Raise UsageError unless what the controller would then take off over temperature is taken
        off once. own : whether the calibration has a law of its own, which replaces the stored"""
        if self.law and (self.law == TAKEN) == own:
            held = "is in its log's readings" if own else "is not in its log's readings"
            raise UsageError(
                f"the controller's own law over temperature {held}",
                remedy="record again without it (TC_A_ENABLE, TC_G_ENABLE or INS_TCAL_ENABLE 0)",
            )


def onboard_from(block: Mapping[str, Any]) -> Onboard:
    """A record from its block, which has the right types."""
    known = {one.name for one in fields(Onboard)} & block.keys()
    found: dict[str, Any] = {k: tuple(v) if isinstance(v := block[k], list) else v for k in known}
    return Onboard(**found)


@dataclass(frozen=True)
class Parameters:
    """A controller's parameters by name, the last of each, and those that had several values in a
    log."""

    known: Mapping[str, float]
    changed: frozenset[str] = frozenset()

    def number(self, name: str) -> float:
        """One of them; 0 where it is not stated."""
        return self.known.get(name, 0.0)

    def onboard(self, slot: int, device: int, offset: str, scale: str, law: str = "",
                turns: Iterable[str] = ()) -> Onboard:  # fmt: skip
        """The record of readings that were corrected by them.

        offset, scale : names, with {} for the axis; turns : of what turns axes after that
        """
        used = [name.format(axis) for name in (offset, scale) for axis in "XYZ"]
        changed = [name for name in used if name in self.changed]
        turned = [name for name in turns if self.number(name)]
        values = [self.known.get(name, float(k > 2)) for k, name in enumerate(used)]
        least = (-_MOST,) * 3 + (1.0 / _MOST,) * 3
        odd = [n for n, v, low in zip(used, values, least, strict=True) if not low <= v <= _MOST]
        faults = [
            *(f"{name} {self.number(name):g} turned its axes" for name in turned),
            *(f"{name} changed in it" for name in changed),
            *(f"{name} is {self.number(name):g}" for name in odd),
        ]
        if faults or not self.known:
            return Onboard(slot, device, law=law, fault=next(iter(faults), ""))
        return Onboard(slot, device, tuple(values[:3]), tuple(values[3:]), law)


def in_ardupilot(kind: str, slot: int) -> str:
    """How names of the "ACC" or "GYR" of a slot begin."""
    return f"INS_{kind}{slot + 1 if slot else ''}"


def in_px4(kind: str, slot: int) -> str:
    """How names of the "ACC" or "GYRO" of a slot begin."""
    return f"CAL_{kind}{slot}"


def parameters_from(stated: Iterable[tuple[str, float]]) -> Parameters:
    """Parameters as a log states them, one after the other."""
    known: dict[str, float] = {}
    changed = set()
    for name, value in stated:
        if known.setdefault(name, value) != value:
            changed.add(name)
        known[name] = value
    return Parameters(known, frozenset(changed))
