"""Angle conventions: what a bench calls inclination and tool-face, and what the readings do then.

Inside, a still reading is g·(cos i sin t, cos i cos t, sin i): paper 004, formulae (1), (2), p. 2.
Other conventions are one affine map of each angle away from it; none is guessed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UsageError
from imucalib.units import DEG

_ZERO_AXIS = {"+y": 0.0, "+x": 90.0, "-y": 180.0, "-x": 270.0}


@dataclass(frozen=True)
class Conventions:
    """How the table's angles are meant. The defaults are paper 004's.

    gravity_sign : "down" when an axis that points down reads +g (gravity), "up" when one that
        points up does (specific force, as MEMS sensors read natively)
    z_axis : "down-hole" or "up-hole", the end of the tool to which z points
    inclination_zero : "horizontal" (paper: 0 when z is level, 90 when it is vertical) or "vertical"
        (drilling: 0 when the tool hangs straight down)
    toolface_zero_axis : the signed axis that reads most at tool-face 0
    toolface_sense : "clockwise" when tool-face grows from +y towards +x, or "counter-clockwise"
    toolface_offset : degrees added to every tool-face of the table
    """

    gravity_sign: Literal["down", "up"] = "down"
    z_axis: Literal["down-hole", "up-hole"] = "down-hole"
    inclination_zero: Literal["horizontal", "vertical"] = "horizontal"
    toolface_zero_axis: Literal["+x", "-x", "+y", "-y"] = "+y"
    toolface_sense: Literal["clockwise", "counter-clockwise"] = "clockwise"
    toolface_offset: float = 0.0

    @property
    def _z_sign(self) -> float:
        return 1.0 if (self.gravity_sign == "down") == (self.z_axis == "down-hole") else -1.0

    @property
    def _sense(self) -> float:
        return 1.0 if self.toolface_sense == "clockwise" else -1.0

    @property
    def senses(self) -> tuple[float, float]:
        """+1, or -1 where the table's inclination or tool-face grows against the internal one: what
        differences of them are multiplied by."""
        level = self._z_sign if self.inclination_zero == "horizontal" else -self._z_sign
        return level, self._sense

    def dials(self, inclination: Array, tool_face: Array) -> dict[str, Array]:
        """Covariates that say how dials (deg, as in the table) count, where not as inside."""
        found = dict[str, Array]()
        columns = ("inclination", "tool_face"), (inclination, tool_face), self.senses
        inside = self.inside(inclination, tool_face)
        for name, dial, sense, own in zip(*columns, inside, strict=True):
            if sense < 0.0 or not np.array_equal(dial * DEG, own):
                found |= {f"{name}_dial": dial * DEG, f"{name}_sense": np.full(dial.size, sense)}
        return found

    def inside(self, inclination: Array, tool_face: Array) -> tuple[Array, Array]:
        """Inclination and tool-face (deg, as in the table) to the internal angles in rad."""
        level = inclination if self.inclination_zero == "horizontal" else 90.0 - inclination
        turned = self._sense * (tool_face + self.toolface_offset)
        zero = _ZERO_AXIS[self.toolface_zero_axis]
        return self._z_sign * level * DEG, (zero + turned) * DEG

    def outside(self, inclination: Array, tool_face: Array) -> tuple[Array, Array]:
        """Internal angles in rad to the table's convention in deg, tool-face in [0, 360)."""
        level = self._z_sign * inclination / DEG
        shown = level if self.inclination_zero == "horizontal" else 90.0 - level
        zero = _ZERO_AXIS[self.toolface_zero_axis]
        turned = self._sense * (tool_face / DEG - zero) - self.toolface_offset
        return shown, np.mod(turned, 360.0)


#: Named sets for `--convention`; single options override them.
PRESETS: dict[str, Conventions] = {
    "paper": Conventions(),
    "drilling-gravity": Conventions(inclination_zero="vertical", toolface_zero_axis="-y"),
    "drilling-force": Conventions(
        gravity_sign="up",
        z_axis="up-hole",
        inclination_zero="vertical",
        toolface_sense="counter-clockwise",
    ),
}


def preset(name: str) -> Conventions:
    """A named set of conventions; raises UsageError for an unknown name."""
    if name not in PRESETS:
        raise UsageError(f"unknown convention '{name}'", remedy=f"use one of: {', '.join(PRESETS)}")
    return PRESETS[name]
