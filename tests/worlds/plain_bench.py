"""Benches in plain numpy, with whatever is wrong with them: nothing of the code under test.

    reading = b + (I + S + K) x + defects(x) + noise,  x = Rz Ry Rx f

f is the specific force in the tool's frame, (cos i sin t, cos i cos t, sin i) at the angles as they
truly stood (docs/lab.md); S, K and the turns are those printed in docs/effects.md. The size of a
defect is given by λ: the length of what it does to the readings beside the twelve parameters, in
units of the true noise, errors of the settings included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from worlds.plain_defects import AXES, DIALS, SENSOR, Conditions, form

Array = NDArray[np.float64]

HEADING = (
    "inclination,tool_face,x_mg,y_mg,z_mg,temperature_C,inclination_approach,tool_face_approach"
)
STEP = 4.0  # mg, of a coarse converter
RHO = 0.6


@dataclass(frozen=True)
class Plan:
    """defects : (name or form, λ); noise : gauss, t4, ar or walk; sigma : mg, of a reading;
    scatter : deg, of both settings; coarse : readings come in steps of 4 mg"""

    seed: int
    defects: tuple[tuple[str, float], ...] = ()
    noise: str = "gauss"
    n: int = 36
    sigma: float = 0.5
    scatter: float = 0.05
    coarse: bool = False


class Bench:
    """One sheet and the truth behind it.

    size : parameters of every defect; bias mg, scale 1, cross (yx, zx, zy) 1, mounting deg;
    reading : (n, 3) mg as noted
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        rng = np.random.default_rng(plan.seed)
        self.conditions = conditions(rng, plan.n)
        self.mounting = 1.5 * rng.standard_normal(3)
        self.bias = 25.0 * rng.standard_normal(3)
        self.scale = 0.007 * rng.standard_normal(3)
        self.cross = 0.005 * rng.standard_normal(3)
        self.size: dict[str, Array] = {}
        for name, strength in plan.defects:
            size = rng.standard_normal(_numbers(name)) + 0.5 * rng.choice([-1.0, 1.0])
            size *= 1e-3 / np.linalg.norm(size)  # small, to measure what a unit does
            self.size[name] = size * strength / (self.strength(name, size))
        self.reading = self.noted(self.conditions, rng)

    def noted(self, c: Conditions, rng: np.random.Generator) -> Array:
        """(n, 3) mg of a sheet with settings and noise of its own."""
        held = _held(c)
        off = [self.plan.scatter * rng.standard_normal(plan_ids[-1] + 1)[plan_ids]
               for plan_ids in held]  # fmt: skip
        reading = self.sensed(self.force(c, *off), c)
        out = reading + self.plan.sigma * _noise(self.plan.noise, (c.count, 3), rng)
        return STEP * np.round(out / STEP) if self.plan.coarse else out

    def force(self, c: Conditions, off_i: Array | float = 0.0, off_t: Array | float = 0.0) -> Array:
        """(n, 3) g in the tool's frame, at the angles as they truly stood."""
        i, t = c.inclination + off_i, c.tool_face + off_t
        for name, p in self.size.items():
            kind, act = _act(name)
            if kind == "dial":
                di, dt = act(c, p)  # type: ignore[call-arg, arg-type]
                i, t = i + di, t + dt
        f = direction(i, t)
        for name, p in self.size.items():
            kind, act = _act(name)
            if kind == "axes":
                f = act(f, c, p)  # type: ignore[call-arg, arg-type, assignment]
        return f

    def sensed(self, force: Array, c: Conditions) -> Array:
        """(n, 3) mg without noise, of force (n, 3) in g in the tool's frame."""
        turn = self.turn()
        x = force @ turn.T
        # What the position before did is seen by the sensor too.
        c = replace(c, previous=c.previous @ turn.T)
        yx, zx, zy = self.cross
        gain = np.eye(3) + np.diag(self.scale) + np.array([[0, 0, 0], [yx, 0, 0], [zx, zy, 0]])
        out = 1000.0 * x @ gain.T + self.bias
        for name, p in self.size.items():
            kind, act = _act(name)
            if kind == "sensor":
                out = out + act(x, c, p)  # type: ignore[call-arg, arg-type, operator]
        return np.asarray(out)

    def turn(self) -> Array:
        """(3, 3) from the tool's frame to the sensor's: Rz Ry Rx."""
        a, b, g = np.deg2rad(self.mounting)
        rx = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
        rz = np.array([[np.cos(g), -np.sin(g), 0], [np.sin(g), np.cos(g), 0], [0, 0, 1]])
        return np.asarray(rz @ ry @ rx)

    def strength(self, name: str, size: Array) -> float:
        """λ of one defect of that size alone."""
        kept, self.size = self.size, {}
        without = self.sensed(self.force(self.conditions), self.conditions)
        self.size = {name: size}
        change = self.sensed(self.force(self.conditions), self.conditions) - without
        self.size = kept
        low = np.linalg.cholesky(self._variance())
        c = self.conditions
        design = np.column_stack([direction(c.inclination, c.tool_face), np.ones(c.count)])
        base = np.linalg.qr(np.linalg.solve(low, np.kron(design, np.eye(3))))[0]
        white = np.linalg.solve(low, change.ravel())
        return float(np.linalg.norm(white - base @ (base.T @ white)))

    def _variance(self) -> Array:
        """(3n, 3n) mg², of noise and settings as they are."""
        c, n = self.conditions, self.plan.n
        lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        share = np.eye(n)
        if self.plan.noise == "ar":
            share = RHO**lag
        elif self.plan.noise == "walk":
            share = share + 9.0 / n * (1 + np.minimum.outer(np.arange(n), np.arange(n)))
        out = self.plan.sigma**2 * np.kron(share, np.eye(3))
        small = 1e-3
        for k, ids in enumerate(_held(c)):
            off = [0.0, 0.0]
            off[k] = small
            moved = self.sensed(self.force(c, *off), c) - self.sensed(self.force(c), c)
            each = np.zeros((n, 3, ids[-1] + 1))
            each[np.arange(n), :, ids] = moved / small
            flat = self.plan.scatter * each.reshape(3 * n, -1)
            out = out + flat @ flat.T
        return np.asarray(out)

    def write(self, path: Path) -> Path:
        """The sheet as the technician would save it."""
        c = self.conditions
        rows = np.column_stack(
            [c.inclination, c.tool_face, self.reading, c.temperature, c.approach_i, c.approach_t]
        )
        text = "\n".join(",".join(f"{v:.12g}" for v in row) for row in rows)
        path.write_text(f"{HEADING}\n{text}\n", encoding="utf-8")
        return path

    def fresh(self, n: int, seed: int) -> tuple[Array, Array, Conditions]:
        """Noise-free readings (n, 3) mg of the sensor at directions (n, 3) g that were never set,
        in conditions of rows of the sheet; what fixtures do is not the sensor's."""
        rng = np.random.default_rng((seed, 1))
        f = rng.standard_normal((n, 3))
        f /= np.linalg.norm(f, axis=1, keepdims=True)
        c = taken(self.conditions, rng.integers(0, self.plan.n, n))
        c = replace(
            c,
            inclination=np.degrees(np.arcsin(f[:, 2])),
            tool_face=np.degrees(np.arctan2(f[:, 0], f[:, 1])),
        )
        if "late_reading" in self.size:  # a sensor that was waited for
            c = replace(c, previous=f)
        reading = self.sensed(f, c)
        return (STEP * np.round(reading / STEP) if self.plan.coarse else reading), f, c


def direction(i: Array, t: Array) -> Array:
    i, t = np.deg2rad(i), np.deg2rad(t)
    return np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=-1)


def conditions(rng: np.random.Generator, n: int) -> Conditions:
    """A run over n positions spread over the sphere, its temperature going up and down."""
    i = np.round(np.degrees(np.arcsin(rng.uniform(-0.98, 0.98, n))) / 5.0) * 5.0
    t = 15.0 * rng.integers(0, 24, n)
    share = np.linspace(0.0, 1.0, n)
    warm = 25.0 + 8.0 * np.sin(2 * np.pi * rng.uniform(0.8, 2.5) * share + rng.uniform(0, 6.3))
    warm = warm + 0.5 * rng.standard_normal(n)
    late = np.empty(n)
    late[0] = warm[0]
    for k in range(1, n):
        late[k] = late[k - 1] + 0.25 * (warm[k] - late[k - 1])
    v = rng.standard_normal(3)
    f = direction(i, t)
    return Conditions(
        inclination=i,
        tool_face=t,
        temperature=warm,
        order=share,
        approach_i=rng.choice([-1.0, 1.0], n),
        approach_t=rng.choice([-1.0, 1.0], n),
        row=np.arange(n, dtype=float),
        previous=np.vstack([f[:1], f[:-1]]),
        wait=rng.exponential(1.0, n),
        walk=np.cumsum(rng.standard_normal((n, 3)), axis=0) / np.sqrt(n),
        late=late,
        count=n,
        phase=rng.uniform(0.0, 2 * np.pi, 3),
        v=v / np.linalg.norm(v),
        at=int(rng.integers(n // 4, 3 * n // 4)),
    )


_ROWS = ("inclination", "tool_face", "temperature", "order", "approach_i", "approach_t", "row",
         "previous", "wait", "walk", "late")  # fmt: skip


def taken(c: Conditions, rows: NDArray[np.intp]) -> Conditions:
    return replace(c, **{name: getattr(c, name)[rows] for name in _ROWS})


def _held(c: Conditions) -> list[NDArray[np.intp]]:
    """Ids of the settings of both dials: one that is not touched between rows keeps its error."""
    return [np.cumsum(np.append(0, np.diff(a) != 0.0)) for a in (c.inclination, c.tool_face)]


def _numbers(name: str) -> int:
    return next((t[name][0] for t in (DIALS, AXES, SENSOR) if name in t), 1)


def _act(name: str) -> tuple[str, object]:
    for kind, of in (("dial", DIALS), ("axes", AXES), ("sensor", SENSOR)):
        if name in of:
            return kind, of[name][1]
    return form(name)


def _noise(kind: str, shape: tuple[int, int], rng: np.random.Generator) -> Array:
    if kind == "t4":
        return rng.standard_t(4.0, shape) / np.sqrt(2.0)
    e = rng.standard_normal(shape)
    if kind == "ar":
        for k in range(1, shape[0]):
            e[k] = RHO * e[k - 1] + np.sqrt(1 - RHO**2) * e[k]
    elif kind == "walk":
        e = e + 3.0 * np.cumsum(rng.standard_normal(shape), axis=0) / np.sqrt(shape[0])
    return e
