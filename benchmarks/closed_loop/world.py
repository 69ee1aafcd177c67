"""A world: an input file as a user has it, and the truth behind it. Plain numpy; nothing of the
program that is judged is imported here or in what this imports.

    reading = b + (I + S + K) x + effects(x) + walk + noise,   x = Rz Ry Rx f

Strength and oracle come from one linear problem at the truth: what is read, whitened by the noise
as it was drawn (settings that rows share and walks included), on the twelve numbers of the gain and
the bias and on the columns of what is planted. Of a norm only the part along the reading's normal
is seen, and the three turns drop out.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from defects import (
    AXES,
    EVERY_DIAL,
    EVERY_SENSOR,
    LARGEST,
    NUMBER,
    Array,
    Conditions,
    direction,
    turns,
)

#: Attitudes at which a calibration is judged.
ATTITUDES = 200


class NoSuchWorld(Exception):
    """A strength that no credible size of the effect reaches in this layout."""


@dataclass(frozen=True)
class Recipe:
    """kind : bench, norm or worn; row : of the table that the world belongs to; planted : name ->
    strength aimed at; outside : whether no catalogue holds what is planted; slip : of the hand"""

    kind: str
    row: str
    seed: int
    planted: dict[str, float] = field(default_factory=dict)
    outside: bool = False
    slip: str = ""


@dataclass(frozen=True)
class Attitudes:
    """force : (n, 3) g, true; reading : (n, 3) mg of the sensor there, without noise; c : under
    which conditions; covariates : them by the names that a calibration uses, in SI; walk : what of
    the reading is a walk of the bias, mg"""

    force: Array
    reading: Array
    c: Conditions
    covariates: dict[str, Array]
    walk: Array | float = 0.0


@dataclass(frozen=True)
class Bounds:
    """mg rms. oracle : of least squares that know what is planted and predict a walk, or of the
    base where knowing is no help, as a table hardly determines it; base : of least squares that
    know gain and bias alone; response : of the oracle, apart from a walk"""

    oracle: float
    base: float
    response: float


@dataclass
class Sensor:
    """bias : mg; scale, cross (yx, zx, zy) : 1; mounting : deg; size : of every effect"""

    bias: Array
    scale: Array
    cross: Array
    mounting: Array
    size: dict[str, Array] = field(default_factory=dict)

    @property
    def gain(self) -> Array:
        """(3, 3) from the force along the sensor's axes to the reading, mg/mg."""
        yx, zx, zy = self.cross
        low = np.array([[0, 0, 0], [yx, 0, 0], [zx, zy, 0]])
        return np.asarray(np.eye(3) + np.diag(self.scale) + low)

    def axes(self, force: Array) -> Array:
        """(n, 3) from the tool's frame to the sensor's."""
        return turns(force, np.broadcast_to(self.mounting, force.shape))

    def sensed(self, force: Array, c: Conditions) -> Array:
        """(n, 3) mg without noise and walk, of force (n, 3) in g in the tool's frame."""
        x = self.axes(force)
        out = 1000.0 * x @ self.gain.T + self.bias
        for name, p in self.size.items():
            if name in EVERY_SENSOR:
                out = out + EVERY_SENSOR[name][2](x, c, p)
        return np.asarray(out)

    def force(self, c: Conditions, off_i: Array | float = 0.0, off_t: Array | float = 0.0) -> Array:
        """(n, 3) g in the tool's frame, at the angles as they truly stand."""
        i, t = c.inclination + off_i, c.tool_face + off_t
        for name, p in self.size.items():
            if name in EVERY_DIAL:
                di, dt = EVERY_DIAL[name][2](c, p)
                i, t = i + di, t + dt
        f = direction(i, t)
        for name, p in self.size.items():
            if name in AXES:
                f = AXES[name][2](f, c, p)
        return f


def drawn_sensor(rng: np.random.Generator, *, mounted: bool) -> Sensor:
    """Bias 10 to 40 mg an axis, scale 0.5 %, non-orthogonality 0.3 %, mounting 1 deg."""
    return Sensor(
        bias=rng.choice([-1.0, 1.0], 3) * rng.uniform(10.0, 40.0, 3),
        scale=0.005 * rng.standard_normal(3),
        cross=0.003 * rng.standard_normal(3),
        mounting=rng.standard_normal(3) if mounted else np.zeros(3),
    )


def sphere(rng: np.random.Generator, n: int) -> Array:
    """(n, 3) directions, uniform."""
    x = rng.standard_normal((n, 3))
    return np.asarray(x / np.linalg.norm(x, axis=1, keepdims=True))


class World:
    """What every kind shares. A kind gives `c`, `sensor`, `truth` (its forces, where they do not
    follow from dials), `variance`, `attitudes`, `write` and `command`.

    away : (m,) what the noise as drawn did to what is observed
    """

    recipe: Recipe
    c: Conditions
    sensor: Sensor
    away: Array
    repair: tuple[str, ...] = ()
    _low: Array | None = None

    def truth(self) -> Array:
        """(n, 3) g, forces that the rows have."""
        raise NotImplementedError

    def variance(self) -> Array:
        """(m, m) mg2 of what is observed."""
        raise NotImplementedError

    def attitudes(self) -> Attitudes:
        """Where the calibration is judged."""
        raise NotImplementedError

    def write(self, folder: Path) -> list[str]:
        """Write the file; returns the command's arguments."""
        raise NotImplementedError

    def apart(self, seen: Attitudes) -> tuple[Array, Array]:
        """A walk at `seen`: (n, 3, m) what predicts it from V^-1 times the residual, and (n, 3) mg
        as it was drawn. None unless a kind says otherwise."""
        return np.zeros((ATTITUDES, 3, self.away.size)), np.zeros((ATTITUDES, 3))

    def observed(self, change: Array) -> Array:
        """(m, ...) of changes (n, 3, ...) mg: all three axes, or along the norm's normal."""
        if self.recipe.kind == "bench":
            return np.asarray(change.reshape(3 * len(change), *change.shape[2:]))
        return np.asarray(np.einsum("ni,ni...->n...", self.normals(), change))

    def normals(self) -> Array:
        """(n, 3), the direction in which a reading moves the norm that it is corrected to."""
        n = self.truth() @ np.linalg.inv(self.sensor.gain)
        return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))

    def base_columns(self, force: Array) -> Array:
        """(n, 3, 12) mg: gain and bias."""
        x = self.sensor.axes(force)
        every = np.concatenate([1000.0 * x, np.ones((len(x), 1))], axis=1)
        return np.asarray(np.einsum("nj,ik->nijk", every, np.eye(3)).reshape(len(x), 3, 12))

    def planted_columns(self, names: Iterable[str], c: Conditions, force: Array | None) -> Array:
        """(n, 3, p) mg per unit of every parameter, at the truth; force : else by the dials."""
        made = []
        kept = self.sensor.size
        for name in names:
            size = kept.get(name, np.zeros(NUMBER[name]))
            step = 1e-4 * max(1e-3, float(np.linalg.norm(size)))
            for k in range(size.size):
                ends = []
                for sign in (-1.0, 1.0):
                    moved = size + sign * step * np.eye(size.size)[k]
                    self.sensor.size = {**kept, name: moved}
                    at = self.sensor.force(c) if force is None else force
                    ends.append(self.sensor.sensed(at, c))
                made.append((ends[1] - ends[0]) / (2.0 * step))
        self.sensor.size = kept
        return np.stack(made, axis=2) if made else np.zeros((len(c.order), 3, 0))

    def plant(self, rng: np.random.Generator) -> None:
        """Give every effect of the recipe its size, met exactly to first order."""
        free = None if self.recipe.kind == "bench" else self.truth()
        for name, aim in self.recipe.planted.items():
            unit = rng.standard_normal(NUMBER[name])
            columns = self.observed(self.planted_columns([name], self.c, free)) @ unit
            size = unit * aim / self.length(columns)
            if np.abs(size).max() > LARGEST[name]:
                raise NoSuchWorld(name)
            self.sensor.size[name] = size

    def length(self, column: Array) -> float:
        """Strength of a column (m,): its length beside the base, in units of the noise."""
        white = self.white(
            np.column_stack([self.observed(self.base_columns(self.truth())), column])
        )
        basis, scale, _ = np.linalg.svd(white[:, :-1], full_matrices=False)
        basis = basis[:, scale > 1e-9 * scale[0]]
        left = white[:, -1] - basis @ (basis.T @ white[:, -1])
        return float(np.linalg.norm(left))

    def white(self, columns: Array) -> Array:
        """(m, k) in units of the noise."""
        return np.asarray(np.linalg.solve(self.low(), columns))

    def low(self) -> Array:
        """(m, m), the lower Cholesky factor of the variance."""
        if self._low is None:
            self._low = np.asarray(np.linalg.cholesky(self.variance()), float)
        return self._low

    def errors(self, seen: Attitudes) -> Bounds:
        """What least squares at the truth come to at `seen`."""
        names, free = list(self.recipe.planted), self.recipe.kind != "bench"
        mine = self.planted_columns(names, self.c, self.truth() if free else None)
        there = self.planted_columns(names, seen.c, seen.force)
        size = np.concatenate([self.sensor.size[n] for n in names] or [np.zeros(0)])
        base = self.observed(self.base_columns(self.truth()))
        at = self.base_columns(seen.force)
        weights, drawn = self.apart(seen)
        every = np.concatenate([base, self.observed(mine)], axis=1)
        delta, left = self._solved(every, self.away)
        knows = np.concatenate([at, there], axis=2) @ delta + weights @ left - drawn
        delta, _ = self._solved(base, self.away + self.observed(mine) @ size)
        plain = at @ delta - there @ size - drawn
        apart = knows - (weights @ left - drawn)
        base_error = self.size_of(plain, seen)
        return Bounds(
            oracle=min(self.size_of(knows, seen), base_error),
            base=base_error,
            response=self.size_of(apart, seen),
        )

    def _solved(self, design: Array, what: Array) -> tuple[Array, Array]:
        """Parameters, and V^-1 times the residual."""
        white, target = self.white(design), self.white(what[:, None])[:, 0]
        delta = np.asarray(np.linalg.lstsq(white, target, rcond=1e-9)[0], float)
        return delta, np.asarray(np.linalg.solve(self.low().T, target - white @ delta))

    def size_of(self, reading: Array, seen: Attitudes) -> float:
        """mg rms of errors (n, 3) of readings, as errors of the force that is told from them."""
        force = reading @ np.linalg.inv(self.sensor.gain).T
        return self.force_error(force, self.sensor.axes(seen.force))

    def force_error(self, away: Array, force: Array) -> float:
        """mg rms of errors (n, 3) mg of the force: the vector's, or of the norm its size's."""
        if self.recipe.kind == "bench":
            return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))
        return float(np.sqrt(np.mean(np.sum(away * force, axis=1) ** 2)))
