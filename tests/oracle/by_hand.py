"""Equations of docs/effects.md that are matrices, turns or delays, written a second time by hand.

Each stands beside the text that it was written from: a test compares that with the page. Units as
in `equations`; a delay and a low-pass act to first order, ω(t - τ) = ω - τ dω/dt.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Known = Mapping[str, Array]


def turned(x: Array, axis: Array, deg: Array | float) -> Array:
    """x (n, 3) turned about unit axes (n, 3), right-handed."""
    a = np.deg2rad(np.broadcast_to(deg, len(x)))[:, None]
    along = np.sum(axis * x, axis=1, keepdims=True) * axis
    return np.asarray(along + np.cos(a) * (x - along) + np.sin(a) * np.cross(axis, x))


def direction(i: Array, t: Array) -> Array:
    """(n, 3) the specific force of docs/conventions.md at dial angles in deg, in g."""
    i, t = np.deg2rad(i), np.deg2rad(t)
    return np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=-1)


def inclination_axis(t: Array) -> Array:
    """(n, 3) about which the tool is inclined, in the tool's frame: where its force does not point
    at any inclination, (cos t, -sin t, 0)."""
    t = np.deg2rad(t)
    return np.stack([np.cos(t), -np.sin(t), 0.0 * t], axis=-1)


def _lower(p: Array, k: Known) -> Array:
    yx, zx, zy = p
    x, y, z = k["x"].T
    return np.stack([x, y + yx * x, z + zx * x + zy * y], axis=-1)


def _mounting(p: Array, k: Known) -> Array:
    x, deg = k["x"], float(np.linalg.norm(p))
    return turned(x, np.broadcast_to(p / deg, x.shape), deg) if deg else x


def _crept(p: Array, k: Known) -> Array:
    x = k["x"]
    for axis, deg in zip(np.eye(3), p, strict=True):
        x = turned(x, np.broadcast_to(axis, x.shape), deg * (k["order"] - 0.5))
    return x


def _frame(p: Array, k: Known) -> Array:
    f = np.zeros((3, 3))
    xy, xz, yx, yz, zx, zy, x_less_y, y_less_z = p
    f[0, 1], f[0, 2], f[1, 0], f[1, 2], f[2, 0], f[2, 1] = xy, xz, yx, yz, zx, zy
    f[0, 0], f[1, 1], f[2, 2] = x_less_y, y_less_z - x_less_y, -y_less_z
    return np.asarray(k["ω"] @ (np.eye(3) + f).T)


def _elements(p: Array, k: Known) -> Array:
    w, spin = np.deg2rad(k["ω"]), k["spin"]
    out = k["a"].copy()
    for i in range(3):
        d = np.broadcast_to(p.reshape(3, 3)[i], w.shape)
        out[:, i] += (np.cross(w, np.cross(w, d)) + np.cross(spin, d))[:, i] / 9.80665
    return out


def _swung(d: Array, k: Known) -> Array:
    w = np.deg2rad(k["ω"])
    return np.asarray(k["a"] + (np.cross(w, np.cross(w, d)) + np.cross(k["spin"], d)) / 9.80665)


def _flexing(p: Array, k: Known) -> Array:
    xx, yy, zz, xy, xz, yz = p
    c = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return _swung(k["a"] @ c, k)


def _flung(p: Array, k: Known) -> Array:
    square = np.sum(k["ω"] ** 2, axis=1, keepdims=True) / 1e6
    return _swung(square * p, k)


def _across(p: Array, k: Known) -> Array:
    e = np.deg2rad(p[0])
    return np.asarray(k["x"] * np.cos(e) + inclination_axis(k["t"]) * np.sin(e))


def _square(p: Array, k: Known) -> Array:
    t = np.deg2rad(k["t"])
    return turned(k["x"], np.stack([np.sin(t), np.cos(t), 0.0 * t], axis=-1), p[0])


def _per_sweep(p: Array, k: Known) -> Array:
    each = np.append(0.0, p)
    return direction(k["i"], k["t"] + each[k["sweep"].astype(int)])


#: name -> the printed equation, and what it gives for parameters in g, deg/s, deg, s, m.
def _product_across(p: Array, k: Known) -> Array:
    x, y, z = k["x"].T
    return k["x"] + np.stack([p[0] * y * z, p[1] * z * x, p[2] * x * y], axis=-1)


def _squares_across(p: Array, k: Known) -> Array:
    x, y, z = k["x"].T ** 2
    return k["x"] + np.stack([p[0] * (y - z), p[1] * (z - x), p[2] * (x - y)], axis=-1)


def _tilted(p: Array, k: Known) -> Array:
    yx, zx, zy, xy, xz, yz = p[:, None] * (k["T"] - 25.0)
    x, y, z = k["x"].T
    return np.stack([x + xy * y + xz * z, y + yx * x + yz * z, z + zx * x + zy * y], axis=-1)


BY_HAND: dict[str, tuple[str, Callable[[Array, Known], Array]]] = {
    "product_across": ("y_i = x_i + C_i x_j x_k,  i, j, k in cyclic order", _product_across),
    "squares_across": (
        "y_i = x_i + D_i (x_j² - x_k²),  i, j, k in cyclic order", _squares_across),
    "temperature_non_orthogonality": (
        "y_y = x_y + c_yx x_x (T - 25 °C);  y_z = x_z + (c_zx x_x + c_zy x_y) (T - 25 °C)",
        lambda p, k: _tilted(np.append(p, np.zeros(3)), k)),
    "temperature_misalignment": (
        "y_i = x_i + (c_ij x_j + c_ik x_k) (T - 25 °C)", _tilted),
    "common_accelerometer_scale": (
        "y = (1 + s) a, the same for all", lambda p, k: (1 + p[0]) * k["a"]),
    "common_accelerometer_bias": ("y = a + b, the same for all", lambda p, k: k["a"] + p),
    "common_gyro_scale": ("y = (1 + s) ω, the same for all", lambda p, k: (1 + p[0]) * k["ω"]),
    "gyro_frame": ("y = (I + F) ω, F the same for all, trace F = 0", _frame),
    "sensing_elements": (
        "y_i = a_i + (ω × (ω × d_i) + dω/dt × d_i)_i,  d_i the same in all packages", _elements),
    "flexing": ("y = a + ω × (ω × d) + dω/dt × d,  d = C a, C symmetric", _flexing),
    "moved_by_rate": (
        "y = a + ω × (ω × d) + dω/dt × d,  d = c (|ω| / 1000 deg/s)²", _flung),
    "gyro_delay": (
        "y(t) = ω(t - τ)", lambda p, k: k["ω"] - p[0] * np.rad2deg(k["spin"])),
    "gyro_delay_each": (
        "y_k(t) = ω(t - τ_k)", lambda p, k: k["ω"] - p[0] * np.rad2deg(k["spin"])),
    "accelerometer_delay": (
        "y_k(t) = a_k(t - τ_k)", lambda p, k: k["a"] - p[0] * k["jerk"] / 9.80665),
    "accelerometer_low_pass": (
        "y_k + τ_k dy_k/dt = a_k", lambda p, k: k["a"] - p[0] * k["jerk"] / 9.80665),
    "common_accelerometer_low_pass": (
        "y + τ dy/dt = a, the same for all", lambda p, k: k["a"] - p[0] * k["jerk"] / 9.80665),
    "gyro_low_pass": (
        "y + τ dy/dt = ω, the same for all",
        lambda p, k: k["ω"] - p[0] * np.rad2deg(k["spin"])),
    "gyro_low_pass_each": (
        "y_k + τ_k dy_k/dt = ω", lambda p, k: k["ω"] - p[0] * np.rad2deg(k["spin"])),
    "gyro_sample_age": (
        "y_k(t) = ω(t - T (φ_k(t) mod 1 - 1/2)), φ_k by the beat line of gyro k",
        lambda p, k: k["ω"] - p[0] * k["age"][:, None] * np.rad2deg(k["spin"])),
    "non_orthogonality": ("y_y = x_y + k_yx x_x;  y_z = x_z + k_zx x_x + k_zy x_y", _lower),
    "mounting": ("x' = R(m) x,  m = (m_x, m_y, m_z)", _mounting),
    "clamp_creep": (
        "x' = Rz(c_z s) Ry(c_y s) Rx(c_x s) x,  s = order - 1/2, order from 0 to 1", _crept),
    "base_tilt_across": (
        "x' = x cos e + g e_axis sin e, e_axis along the inclination axis", _across),
    "axis_non_orthogonality": ("x' = R(h about the direction square to both axes) x", _square),
    "tool_face_zero_per_sweep": ("t = t_dial + d_sweep, none in the first", _per_sweep),
}  # fmt: skip
