"""A bench whose second half is warmer, in plain numpy: a bias that follows the temperature looks
like a step or a drift until it is cooled again."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HEADING = "inclination,tool_face,temperature_C,x (mg),y (mg),z (mg)"
NOISE, DIAL = 0.3, 0.02


@dataclass(frozen=True)
class WarmBench:
    """slope : (3,) mg/°C of the bias; rows are inclination, tool-face (deg), °C, readings (mg)"""

    rng: np.random.Generator
    slope: Array = field(default_factory=lambda: np.array([0.10, -0.08, 0.12]))

    def first(self) -> str:
        """Three rings of eight, cool and then warm."""
        i = np.repeat([0.0, 45.0, -45.0], 8)
        t = np.tile(np.arange(0.0, 360.0, 45.0), 3) + np.repeat([0.0, 15.0, 30.0], 8)
        warm = np.where(np.arange(24) < 12, 20.0, 30.0) + 0.5 * self.rng.standard_normal(24)
        return "\n".join((HEADING, *self.lines(i, t, warm))) + "\n"

    def lines(self, inclination: Array, tool_face: Array, warm: Array) -> list[str]:
        off = DIAL * self.rng.standard_normal((2, len(warm)))
        i, t = np.radians(inclination + off[0]), np.radians(tool_face + off[1])
        u = np.column_stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)])
        gain = np.array([[1.004, 0.002, -0.003], [-0.001, 0.997, 0.001], [0.004, 0.0, 1.002]])
        reading = 1000.0 * u @ gain.T + np.array([12.0, -25.0, 31.0])
        reading = reading + (warm - 25.0)[:, None] * self.slope
        reading = reading + NOISE * self.rng.standard_normal(reading.shape)
        rows = np.column_stack([inclination, tool_face, warm, reading])
        return [",".join(f"{v:.4f}" for v in row) for row in rows]
