"""What is known beside the readings of each observation: order, time, temperature, settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array

#: Parts of the truth that are there only where the sensors move.
MOTION = ("rate", "spin", "jerk")
#: Covariates that are the time of a recording, the last of which comes again each day.
DAILY = "time_of_day"
CLOCKS = ("order", "record", "time", DAILY)


@dataclass(frozen=True)
class Context:
    """Covariates by name, each (n,) in SI units (angles in rad, temperature in °C, time in s), or
    (n, K) where every triad has its own.

    Names with a meaning for the catalogue: "order" (0..1 over the recording), "time",
    "temperature", "inclination", "tool_face", "inclination_dial" and "tool_face_dial" (as the
    bench's dials say them, where these count otherwise), "inclination_sense" and "tool_face_sense"
    (-1 where they count the other way), "sweep" (number of the run of rows with the same held
    angle), "inclination_approach" and "tool_face_approach" (-1, 0, +1: the direction from
    which the setting was reached), "previous_x", "previous_y", "previous_z" (m/s²), "approach_x",
    "approach_y", "approach_z" (-1, 0, +1: the side from which an axis came to its reading, where
    nothing lay between), "sample_age"
    ((n, K) sawtooth of unit span, the beat of each gyro's clock).
    `sweeps` counts those of the whole recording, so that a subset keeps the parameters' meaning.
    attitude : (K, 3, 3) from each triad's axes to the common ones, or None where they are the same
    moving : whether the truth has a motion beside the specific force
    """

    n: int
    covariates: Mapping[str, Array] = field(default_factory=dict)
    triads: tuple[str, ...] = ("imu0",)
    sweeps: int = 1
    attitude: Array | None = None
    moving: bool = False

    def __getitem__(self, name: str) -> Array:
        return self.covariates[name]

    def __contains__(self, name: object) -> bool:
        return name in self.covariates or (self.moving and name in MOTION)

    def dial(self, name: str) -> Array:
        """(n,) rad, "inclination" or "tool_face" as its dial counts it."""
        return self.covariates.get(f"{name}_dial", self.covariates[name])

    def sense(self, name: str) -> Array:
        """(n,) +1, or -1 where the dial counts against the angle."""
        return self.covariates.get(f"{name}_sense", np.ones(self.n))

    def take(self, rows: NDArray[np.intp]) -> Context:
        """The context of a subset of the observations; order and time keep their values."""
        picked = {name: values[rows] for name, values in self.covariates.items()}
        return replace(self, n=len(rows), covariates=picked)

    def in_common(self, vectors: Array) -> Array:
        """(n, K, 3) in the common axes, of vectors (n, K, 3) in each triad's own."""
        if self.attitude is None:
            return vectors
        return np.asarray((self.attitude @ vectors[..., None])[..., 0])

    def in_own(self, columns: Array) -> Array:
        """(n, K, 3, m) in each triad's own axes, of columns (n, 1 or K, 3, m) in common ones."""
        shape = (len(columns), len(self.triads), *columns.shape[2:])
        if self.attitude is None:
            return np.broadcast_to(columns, shape)
        return np.asarray(self.attitude.transpose(0, 2, 1) @ columns)
