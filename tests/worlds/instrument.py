"""A tool's accelerometer in plain numpy, before and after something changed: nothing of the code
under test.

    reading = b + (I + S + K) x + noise,  x = R f

f is the specific force in the tool's frame, g (cos i sin t, cos i cos t, sin i) (docs/lab.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
G = 9.80665  # m/s²
MG, DEG = G * 1e-3, np.pi / 180.0


@dataclass(frozen=True)
class Instrument:
    """bias : (3,) m/s²; gain : (3, 3) I + S + K; turn : (3, 3) R"""

    bias: Array
    gain: Array
    turn: Array

    def read(self, force: Array, noise: float, rng: np.random.Generator) -> Array:
        """(n, 3) m/s² of specific force (n, 3) in the tool's frame; noise : mg"""
        clean = force @ self.turn.T @ self.gain.T + self.bias
        return clean + noise * MG * rng.standard_normal(force.shape)

    def changed(self, kind: str, size: float, along: Array) -> Instrument:
        """After a shift along a unit vector: mg of "bias", mg/g of "scale", deg of "mounting"."""
        if kind == "bias":
            return replace(self, bias=self.bias + size * MG * along)
        if kind == "scale":
            return replace(self, gain=self.gain + 1e-3 * size * np.diag(along))
        c, s = np.cos(size * DEG), np.sin(size * DEG)
        k = np.array([[0, -along[2], along[1]], [along[2], 0, -along[0]], [-along[1], along[0], 0]])
        return replace(self, turn=(np.eye(3) + s * k + (1.0 - c) * k @ k) @ self.turn)


def instrument(rng: np.random.Generator) -> Instrument:
    """As they come: 20 mg, 6 per mille, 0.3 deg, 1.5 deg."""
    gain = np.eye(3) + np.diag(0.006 * rng.standard_normal(3))
    gain[1, 0], gain[2, 0], gain[2, 1] = 0.005 * rng.standard_normal(3)
    turn = rotation(1.5 * rng.standard_normal(3))
    return Instrument(20.0 * MG * rng.standard_normal(3), gain, turn)


def rotation(angles: Array) -> Array:
    """A turn by the size of angles (deg) about the axis along them."""
    x, y, z = angles * DEG
    size = float(np.linalg.norm(angles)) * DEG
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    if size == 0.0:
        return np.eye(3)
    return np.eye(3) + np.sin(size) / size * k + (1.0 - np.cos(size)) / size**2 * k @ k


def positions(n: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Inclination and tool-face (deg), even over the sphere, in random order."""
    share = (np.arange(n) + 0.5) / n
    inclination = np.degrees(np.arcsin(0.97 * (2.0 * rng.permutation(share) - 1.0)))
    return inclination, 360.0 * ((np.arange(n) * 0.618034 + rng.random()) % 1.0)


def four(rng: np.random.Generator) -> tuple[Array, Array]:
    """A tetrahedron, turned at random: what a careful hand does."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3.0)
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    u = corners @ (q * np.sign(np.diag(r))).T
    return np.degrees(np.arcsin(u[:, 2])), np.degrees(np.arctan2(u[:, 0], u[:, 1]))


def vectors(inclination: Array, tool_face: Array) -> Array:
    """(n, 3) m/s² of angles in deg."""
    i, t = inclination * DEG, tool_face * DEG
    return G * np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=-1)


@dataclass(frozen=True)
class Bench:
    """known : positions with angles, else rests in unknown attitudes; noise mg, setting deg"""

    known: bool = False
    noise: float = 0.25
    setting: float = 0.0

    def sheet(
        self, tool: Instrument, angles: tuple[Array, Array], rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Inclination and tool-face as set (n,) deg, readings (n, 3) m/s²."""
        inclination, tool_face = angles
        off = self.setting * rng.standard_normal((2, inclination.size))
        force = vectors(inclination + off[0], tool_face + off[1])
        return inclination, tool_face, tool.read(force, self.noise, rng)

    def table(self, tool: Instrument, angles: tuple[Array, Array], rng: np.random.Generator) -> str:
        """The sheet as CSV, readings in mg."""
        inclination, tool_face, reading = self.sheet(tool, angles, rng)
        rows = np.column_stack([inclination, tool_face, reading / MG])
        rows = rows if self.known else rows[:, 2:]
        head = "inclination,tool_face,x_mg,y_mg,z_mg" if self.known else "x_mg,y_mg,z_mg"
        return "\n".join([head, *(",".join(f"{v:.9g}" for v in row) for row in rows)]) + "\n"
