"""Benches with dials, and rests of the same sensor without angles (a norm)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from defects import AXES, DIALS, OUTSIDE_DIALS, OUTSIDE_SENSOR, Array, Conditions, direction
from numpy.typing import NDArray
from slips import slipped
from world import ATTITUDES, Attitudes, Recipe, World, drawn_sensor, sphere

G = 9.80665
#: Of the sensor, what every table can show.
PLAIN = (
    "quadratic",
    "cubic",
    "asymmetry",
    "cross_axis",
    "bias_drift",
    "scale_drift",
    "warm_up",
    "bias_step",
)
WARM = ("temperature_bias", "temperature_scale")
PAST = ("hysteresis", "approach_hysteresis")
BACKLASH = ("inclination_backlash", "tool_face_backlash")
BY_TEMPERATURE = (*WARM, "thermal_loop", "thermal_lag")


def effects(kind: str) -> tuple[str, ...]:
    """Names of the catalogue that a kind's tables can carry."""
    return (*PLAIN, *WARM, *PAST, *DIALS, *AXES) if kind == "bench" else (*PLAIN, *WARM)


def outside(kind: str) -> tuple[str, ...]:
    """What no catalogue holds."""
    return (*OUTSIDE_SENSOR, *OUTSIDE_DIALS) if kind == "bench" else tuple(OUTSIDE_SENSOR)


class Table(World):
    """A table of positions, with dials or without."""

    def __init__(self, recipe: Recipe) -> None:
        self.recipe = recipe
        rng = np.random.default_rng(recipe.seed)
        self.dials = recipe.kind == "bench"
        self.sensor = drawn_sensor(rng, mounted=self.dials)
        self.sigma = float(np.exp(rng.uniform(np.log(0.2), np.log(1.0))))
        self.scatter = np.exp(rng.uniform(np.log(0.02), np.log(0.3), 2)) * self.dials
        names = set(recipe.planted)
        self.warm = bool(rng.random() < 0.6 or names & set(BY_TEMPERATURE))
        self.approached = bool(rng.random() < 0.2 or names & set(BACKLASH))
        dial = positions(rng) if self.dials else angles(sphere(rng, int(rng.integers(24, 121))))
        self.c = conditions(rng, dial, self.sensor.axes(direction(*dial.T)))
        self.plant(rng)
        self.reading, self.away = self._read(rng)
        self.dial, self.noted = dial.copy(), np.round(self.reading, 3)
        if recipe.slip:
            self.repair = slipped(rng, recipe.slip, self.dial, self.noted)

    def truth(self) -> Array:
        """By the dials, with what is wrong with them."""
        return self.sensor.force(self.c)

    def _read(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Readings (n, 3) mg with noise, and what noise did to what is observed."""
        off = [
            s * rng.standard_normal(ids[-1] + 1)[ids]
            for s, ids in zip(self.scatter, held(self.c), strict=True)
        ]
        plain = self.sensor.sensed(self.truth(), self.c)
        moved = self.sensor.sensed(self.sensor.force(self.c, *off), self.c)
        reading = moved + self.sigma * rng.standard_normal(moved.shape)
        return reading, self.observed(reading - plain)

    def variance(self) -> Array:
        """Of readings, and of settings that rows share."""
        if not self.dials:
            return np.asarray(self.sigma**2 * np.eye(len(self.c.order)))
        n = len(self.c.order)
        out = self.sigma**2 * np.eye(3 * n)
        small = 1e-3
        plain = self.sensor.sensed(self.truth(), self.c)
        for k, (s, ids) in enumerate(zip(self.scatter, held(self.c), strict=True)):
            off = small * np.eye(2)[k]
            moved = self.sensor.sensed(self.sensor.force(self.c, *off), self.c) - plain
            each = np.zeros((n, 3, ids[-1] + 1))
            each[np.arange(n), :, ids] = s * moved / small
            flat = each.reshape(3 * n, -1)
            out = out + flat @ flat.T
        return np.asarray(out)

    def attitudes(self) -> Attitudes:
        """Directions that were never set, in the conditions of rows of the table."""
        rng = np.random.default_rng((self.recipe.seed, 1))
        force = sphere(rng, ATTITUDES)
        rows = rng.integers(0, len(self.c.order), ATTITUDES)
        i, t = angles(force).T
        c = replace(self.c.take(rows), inclination=i, tool_face=t)
        x = self.sensor.axes(force)
        step = np.where(np.abs(x - c.previous) > 0.02, np.sign(x - c.previous), 0.0)
        known = {
            "order": c.order,
            "record": c.row,
            "inclination": np.deg2rad(i),
            "tool_face": np.deg2rad(t),
            **({"temperature": c.temperature} if self.warm else {}),
            **{f"previous_{a}": G * c.previous[:, k] for k, a in enumerate("xyz")},
            **{f"approach_{a}": step[:, k] for k, a in enumerate("xyz")},
        }
        return Attitudes(force, self.sensor.sensed(force, c), c, known)

    def write(self, folder: Path) -> list[str]:
        """The sheet as the technician would save it."""
        columns: dict[str, Array] = {}
        if self.dials:
            columns |= {"inclination": self.dial[:, 0], "tool_face": self.dial[:, 1]}
        columns |= {f"{a}_mg": self.noted[:, k] for k, a in enumerate("xyz")}
        if self.warm:
            columns["temperature_C"] = np.round(self.c.temperature, 2)
        if self.dials and self.approached:
            columns |= {
                "inclination_approach": self.c.approach_i,
                "tool_face_approach": self.c.approach_t,
            }
        rows = np.column_stack(list(columns.values()))
        text = "\n".join(",".join(f"{v:.10g}" for v in row) for row in rows)
        path = folder / "sheet.csv"
        path.write_text(f"{','.join(columns)}\n{text}\n", encoding="utf-8")
        return ["lab", str(path), *([] if self.dials else ["--reference", "norm"])]


def angles(force: Array) -> Array:
    """(n, 2) deg, inclination and tool-face of directions (n, 3)."""
    x, y, z = force.T
    return np.column_stack([np.degrees(np.arcsin(z)), np.degrees(np.arctan2(x, y))])


def positions(rng: np.random.Generator) -> Array:
    """(n, 2) deg, 24 to 100 rows: rings of the tool-face at several inclinations, of both signs or
    of one, as a technician works through them; one sheet in five in an order that was drawn."""
    while True:
        every = int(rng.choice([10, 15, 20, 30]))
        top = int(rng.choice([45, 60, 75, 80]))
        low = -top if rng.random() < 0.6 else 0
        rings = np.arange(low, top + 1, every)
        step = int(rng.choice([15, 30, 36, 45, 60]))
        faces = np.arange(0, 360, step)
        if len(rings) >= 3 and 24 <= len(rings) * len(faces) <= 100:
            break
    rows = [
        (i, t)
        for k, i in enumerate(rings)
        for t in (faces if k % 2 == 0 or rng.random() < 0.5 else faces[::-1])
    ]
    table = np.array(rows, float)
    if rng.random() < 0.3 and len(table) <= 96:  # the first positions come again at the end
        table = np.vstack([table, table[: int(rng.integers(1, 5))]])
    return table[rng.permutation(len(table))] if rng.random() < 0.2 else table


def warmth(rng: np.random.Generator, n: int) -> Array:
    """(n,) degC: a room, a sensor that warms up, or a chamber of two temperatures."""
    share = np.linspace(0.0, 1.0, n)
    kind = rng.integers(3)
    course: Array
    if kind == 0:
        course = 4.0 * np.sin(2 * np.pi * rng.uniform(0.5, 2.5) * share + rng.uniform(0.0, 6.3))
    elif kind == 1:
        course = 10.0 * (1.0 - np.exp(-share / rng.uniform(0.1, 0.5)))
    else:
        course = 15.0 * np.where(np.sin(2 * np.pi * rng.uniform(1.0, 2.5) * share) > 0, 1.0, 0.0)
    return np.asarray(22.0 + rng.uniform(0.0, 6.0) + course + 0.3 * rng.standard_normal(n))


def conditions(rng: np.random.Generator, dial: Array, felt: Array) -> Conditions:
    """Of the rows of a table; felt : (n, 3) g along the sensor's axes."""
    n = len(dial)
    warm = warmth(rng, n)
    late = warm.copy()
    for k in range(1, n):
        late[k] = late[k - 1] + 0.25 * (warm[k] - late[k - 1])
    return Conditions(
        inclination=dial[:, 0],
        tool_face=dial[:, 1],
        temperature=warm,
        late=late,
        order=np.linspace(0.0, 1.0, n),
        row=np.arange(n, dtype=float),
        hour=np.zeros(n),
        approach_i=rng.choice([-1.0, 1.0], n),
        approach_t=rng.choice([-1.0, 1.0], n),
        previous=np.vstack([felt[:1], felt[:-1]]),
        walk=np.cumsum(rng.standard_normal((n, 3)), axis=0) / np.sqrt(n),
        phase=rng.uniform(0.0, 2 * np.pi, 3),
        v=sphere(rng, 1)[0],
        at=float(rng.integers(n // 4, 3 * n // 4)),
        middle=float(np.median(warm)),
    )


def held(c: Conditions) -> list[NDArray[np.intp]]:
    """Ids of the settings of both dials: one that is not touched between rows keeps its error."""
    return [np.cumsum(np.append(0, np.diff(a) != 0.0)) for a in (c.inclination, c.tool_face)]
