"""Worn sensors: a raw recording of one to three days at a low rate, postures with movement between
them, with a walk of the bias or without.

What acts on the sensor is taken in the middle of a posture, and holds through it. The walk belongs
to the truth: a sensor is judged as it is at the time, and an oracle predicts the walk from the rows
beside it.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
from bench import PLAIN, WARM
from defects import OUTSIDE_SENSOR, Array, Conditions
from numpy.typing import NDArray
from world import ATTITUDES, Attitudes, Recipe, World, drawn_sensor, sphere

HOUR = 3600.0
RATE = 4.0  # Hz
EVERY = 60.0  # s, step of the courses
SEEN = 10.0  # s, between samples of the recording on which a calibration is judged
START = 1_700_000_000.0  # s since 1970


def effects(kind: str) -> tuple[str, ...]:
    """Names of the catalogue that a recording can carry."""
    return (*PLAIN, *WARM, "thermal_lag", "time_of_day")


def outside(kind: str) -> tuple[str, ...]:
    """What no catalogue holds."""
    return tuple(OUTSIDE_SENSOR)


class Worn(World):
    """One recording: its postures (rows), and the course of all that drifts, minute by minute."""

    def __init__(self, recipe: Recipe) -> None:
        self.recipe = recipe
        rng = np.random.default_rng(recipe.seed)
        self.sensor = drawn_sensor(rng, mounted=False)
        names = set(recipe.planted)
        least = 1.7 if "time_of_day" in names else 1.0
        self.span = 24 * HOUR * float(rng.uniform(least, max(least, 2.0) + 0.5))
        self.warm = bool(rng.random() < 0.6 or names & {*WARM, "thermal_lag", "thermal_loop"})
        self.grain = float(rng.uniform(2.0, 4.0))  # mg, of a sample
        self.scatter = float(rng.uniform(0.3, 0.7))  # mg, of a posture
        self.drift = float(rng.uniform(0.3, 0.8)) if rng.random() < 0.5 else 0.0
        self.memory = HOUR * float(np.exp(rng.uniform(np.log(2.0), np.log(12.0))))
        self._postures(rng)
        self._courses(rng)
        self.phase, self.v = rng.uniform(0.0, 2 * np.pi, 3), sphere(rng, 1)[0]
        self.at = float(rng.integers(len(self.time) // 4, 3 * len(self.time) // 4))
        self.c = self._conditions(self.time)
        self.plant(rng)
        off = self.scatter * rng.standard_normal(self.facing.shape)
        self.off = off + self._wandered(self.time)
        self.away = self.observed(self.off)
        self._noise = int(rng.integers(1 << 31))

    def _postures(self, rng: np.random.Generator) -> None:
        """Start, stop and middle of each (n,) s, and where it faces (n, 3): people have habits."""
        start, stop, now = [], [], float(rng.uniform(0.0, 300.0))
        while True:
            lasts = float(np.exp(rng.uniform(np.log(180.0), np.log(1200.0))))
            if now + lasts > self.span - 60.0:
                break
            start.append(now)
            stop.append(now + lasts)
            now += lasts + float(np.exp(rng.uniform(np.log(20.0), np.log(600.0))))
        habits = sphere(rng, int(rng.integers(12, 27)))
        facing = habits[rng.integers(0, len(habits), len(start))]
        facing = facing + 0.15 * rng.standard_normal(facing.shape)
        self.facing: Array = facing / np.linalg.norm(facing, axis=1, keepdims=True)
        self.start, self.stop = np.array(start), np.array(stop)
        self.time = 0.5 * (self.start + self.stop)

    def _courses(self, rng: np.random.Generator) -> None:
        """Temperature, what trails it, a walk of unit size and the walk of the bias, by minutes."""
        self.grid = np.arange(0.0, self.span + EVERY, EVERY)
        n = self.grid.size
        day = 2 * np.pi * self.grid / (24 * HOUR) + rng.uniform(0.0, 6.3)
        course = 30.0 + rng.uniform(1.0, 3.0) * np.sin(day)
        hours = rng.standard_normal(n // 90 + 2)  # off the wrist and on it again, a cold room
        course = course + 2.0 * np.repeat(hours, 90)[:n]
        self.temperature = relaxed(course, 600.0)
        self.late = relaxed(self.temperature, HOUR * float(np.exp(rng.uniform(0.0, np.log(3.0)))))
        self.unit_walk = np.cumsum(rng.standard_normal((n, 3)), axis=0) / np.sqrt(n)
        steps = rng.standard_normal((n, 3))
        keep = np.exp(-EVERY / self.memory)
        for k in range(1, n):
            steps[k] = keep * steps[k - 1] + np.sqrt(1.0 - keep**2) * steps[k]
        self.walk = self.drift * steps

    def _at(self, course: Array, time: Array) -> Array:
        if course.ndim == 1:
            return np.asarray(np.interp(time, self.grid, course))
        return np.column_stack([np.interp(time, self.grid, one) for one in course.T])

    def _wandered(self, time: Array) -> Array:
        return self._at(self.walk, time)

    def _conditions(self, time: Array) -> Conditions:
        n = time.size
        warm = self._at(self.temperature, time)
        return Conditions(
            inclination=np.zeros(n),
            tool_face=np.zeros(n),
            temperature=warm,
            late=self._at(self.late, time),
            order=time / self.span,
            row=np.asarray(np.searchsorted(self.time, time + 1e-6) - 1.0, float),
            hour=(START + time) / HOUR % 24.0,
            approach_i=np.zeros(n),
            approach_t=np.zeros(n),
            previous=np.zeros((n, 3)),
            walk=self._at(self.unit_walk, time),
            phase=self.phase,
            v=self.v,
            at=self.at,
            middle=float(np.median(self.temperature)),
        )

    def truth(self) -> Array:
        """Where the postures face."""
        return self.facing

    def variance(self) -> Array:
        """Of postures, along the norm's normal, and of a walk that goes on from one to the next."""
        count = np.maximum(1.0, RATE * (self.stop - self.start))
        own = np.diag(self.scatter**2 + self.grain**2 / count)
        return np.asarray(own + self._shared(self.time, self.time) * self._cosines(self.normals()))

    def _shared(self, one: Array, other: Array) -> Array:
        return np.asarray(self.drift**2 * np.exp(-np.abs(one[:, None] - other) / self.memory))

    def _cosines(self, normals: Array) -> Array:
        return np.asarray(normals @ self.normals().T)

    def _judged_at(self) -> tuple[Array, Array]:
        """Moments (n,) s of the recording that is corrected, and the forces there (n, 3) g."""
        rng = np.random.default_rng((self.recipe.seed, 1))
        time = np.arange(SEEN, self.span, SEEN)
        return time, sphere(rng, time.size)

    def attitudes(self) -> Attitudes:
        """Attitudes at moments spread over the recording."""
        time, force = self._judged_at()
        time, force = time[self._some()], force[self._some()]
        c = self._conditions(time)
        walk = self._wandered(time)
        reading = self.sensor.sensed(force, c) + walk
        known = {
            "time": time,
            "order": c.order,
            "time_of_day": 2 * np.pi * c.hour / 24.0,
            **({"temperature": c.temperature} if self.warm else {}),
        }
        return Attitudes(force, reading, c, known, walk)

    def apart(self, seen: Attitudes) -> tuple[Array, Array]:
        """The walk at other moments, as the postures tell it."""
        time = seen.covariates["time"]
        weights = self._shared(time, self.time)[:, None, :] * self.normals().T
        return weights, self._wandered(time)

    def picked(self, corrected: Array) -> Array:
        """Of the corrected recording the rows of `attitudes`."""
        return corrected[self._some()]

    def _some(self) -> NDArray[np.intp]:
        n = self._judged_at()[0].size
        return np.linspace(0, n - 1, ATTITUDES).astype(np.intp)

    def write(self, folder: Path) -> list[str]:
        """The raw recording."""
        rng = np.random.default_rng(self._noise)
        n = int(self.span * RATE)
        time = np.arange(n) / RATE
        moved = np.interp(time, self.time, np.arange(len(self.time))).astype(int)
        reading = 1000.0 * self.facing[moved] + 250.0 * rng.standard_normal((n, 3))
        plain = self.sensor.sensed(self.facing, self.c) + self.off
        for a, b, mean in zip(self.start, self.stop, plain, strict=True):
            rows = slice(int(np.ceil(a * RATE)), int(b * RATE))
            reading[rows] = mean + self.grain * rng.standard_normal((rows.stop - rows.start, 3))
        with h5py.File(folder / "worn.h5", "w") as file:
            file["time"] = START + time
            file["time"].attrs["units"] = "s"
            file["acceleration"] = np.round(reading / 1000.0, 6)
            file["acceleration"].attrs["units"] = "g"
            if self.warm:
                file["temperature"] = np.round(self._at(self.temperature, time), 2)
                file["temperature"].attrs["units"] = "degC"
        return ["actigraph", str(folder / "worn.h5")]

    def corrected_by(self, folder: Path) -> tuple[list[str], Path]:
        """A recording of the truth at its own times: the arguments that correct it, and where."""
        time, force = self._judged_at()
        c = self._conditions(time)
        reading = (self.sensor.sensed(force, c) + self._wandered(time)) / 1000.0
        columns = [START + time, *reading.T]
        heading = "time_s,x_g,y_g,z_g"
        if self.warm:
            columns, heading = [*columns, c.temperature], heading + ",temperature_C"
        np.savetxt(
            folder / "seen.csv",
            np.column_stack(columns),
            fmt="%.9f",
            delimiter=",",
            header=heading,
            comments="",
        )
        calibration, out = folder / "out" / "calibration.yaml", folder / "corrected.csv"
        return ["apply", str(calibration), str(folder / "seen.csv"), "-o", str(out)], out


def relaxed(course: Array, memory: float) -> Array:
    """What follows a course by minutes with a time constant in s."""
    out = course.copy()
    share = 1.0 - np.exp(-EVERY / memory)
    for k in range(1, out.size):
        out[k] = out[k - 1] + share * (course[k] - out[k - 1])
    return out
