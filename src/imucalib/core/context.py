"""What is known beside the readings of each observation: order, time, temperature, settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Context:
    """Covariates by name, each (n,) in SI units (angles in rad, temperature in °C, time in s).

    Names with a meaning for the catalogue: "order" (0..1 over the recording), "time",
    "temperature", "inclination", "tool_face", "sweep" (number of the run of rows with the same
    held angle), "inclination_approach" and "tool_face_approach" (-1, 0, +1: the direction from
    which the setting was reached), "previous_x", "previous_y", "previous_z" (m/s²).
    `sweeps` counts those of the whole recording, so that a subset keeps the parameters' meaning.
    """

    n: int
    covariates: Mapping[str, Array] = field(default_factory=dict)
    triads: tuple[str, ...] = ("imu0",)
    sweeps: int = 1

    def __getitem__(self, name: str) -> Array:
        return self.covariates[name]

    def __contains__(self, name: object) -> bool:
        return name in self.covariates

    def take(self, rows: NDArray[np.intp]) -> Context:
        """The context of a subset of the observations; order and time keep their values."""
        picked = {name: values[rows] for name, values in self.covariates.items()}
        return Context(len(rows), picked, self.triads, self.sweeps)
