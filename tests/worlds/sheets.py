"""Bench sheets in plain numpy, with and without a slip of hand: nothing of the code under test.

A reading is A u + b + effect + noise, u = (cos i sin t, cos i cos t, sin i) at the angles as they
truly stood (paper 004, formulae 1 and 2), in mg; the sheet holds the angles as they were meant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EFFECTS = (
    "none", "inclination_zero", "inclination_scale", "tool_face_eccentricity", "quadratic", "cubic",
    "asymmetry", "cross_axis", "bias_drift", "hysteresis", "backlash", "sweep_zero",
)  # fmt: skip
NOISES = ("gauss", "t4", "ar")
LAYOUTS = ("paper", "sweeps", "spread")


@dataclass(frozen=True)
class Slip:
    """What went wrong: its kind, the rows (from 1), and what the sheet should say."""

    kind: str = "none"
    rows: tuple[int, ...] = ()
    line: str = ""
    value: float = np.nan


@dataclass(frozen=True)
class Sheet:
    """inclination, tool_face : (n,) deg; reading : (n, 3) mg; slip : what was planted"""

    inclination: Array
    tool_face: Array
    reading: Array
    slip: Slip = Slip()

    def write(self, path: Path, heading: str = "inclination,tool_face,x_mg,y_mg,z_mg") -> Path:
        rows = np.column_stack([self.inclination, self.tool_face, self.reading])
        text = "\n".join(",".join(f"{v:.10g}" for v in row) for row in rows)
        path.write_text(f"{heading}\n{text}\n", encoding="utf-8")
        return path


def direction(i: Array, t: Array) -> Array:
    i, t = np.deg2rad(i), np.deg2rad(t)
    return np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=-1)


def layout(name: str, rng: np.random.Generator) -> tuple[Array, Array]:
    """Angles as meant, deg. paper: its Table 1; sweeps: meridian and rings; spread: any."""
    ring = np.arange(30.0, 331.0, 30.0)
    if name == "paper":
        i = np.concatenate([np.arange(0.0, 91.0, 10.0), np.full(11, 50.0), np.zeros(11)])
        return i, np.concatenate([np.zeros(10), ring, ring[::-1]])
    if name == "sweeps":
        levels = rng.choice([-60.0, -45.0, -30.0, 0.0, 30.0, 45.0, 60.0], 3, replace=False)
        turn = np.arange(0.0, 360.0, rng.choice([30.0, 45.0]))
        i = np.concatenate([np.arange(-90.0, 91.0, 20.0), *(np.full(len(turn), v) for v in levels)])
        return i, np.concatenate([np.zeros(10), *[turn] * 3])
    n = int(rng.integers(24, 37))
    i = np.round(np.degrees(np.arcsin(rng.uniform(-0.98, 0.98, n))) / 5.0) * 5.0
    return i, 15.0 * rng.integers(0, 24, n)


def bench(
    seed: int,
    *,
    name: str = "paper",
    effect: str = "none",
    noise: str = "gauss",
    scatter: float = 0.1,
    sigma: float = 1.0,
) -> Sheet:
    """A sheet without a slip. scatter : deg, of both settings; sigma : mg."""
    rng = np.random.default_rng(seed)
    i, t = layout(name, rng)
    n = len(i)
    held_i, held_t = (np.cumsum(np.append(0, np.diff(a) != 0.0)).astype(int) for a in (i, t))
    true_i = i + scatter * rng.standard_normal(n)[held_i]
    true_t = t + scatter * rng.standard_normal(n)[held_t]
    share = np.linspace(0.0, 1.0, n)
    if effect == "inclination_zero":
        true_i = true_i + rng.choice([-1.5, 1.5])
    elif effect == "inclination_scale":
        true_i = true_i + i / 90.0
    elif effect == "tool_face_eccentricity":
        true_t = true_t + 0.3 * np.sin(np.deg2rad(t)) - 0.2 * np.cos(np.deg2rad(t))
    elif effect == "backlash":
        true_t = true_t + 0.2 * np.sign(np.diff(t, prepend=t[0]))
    elif effect == "sweep_zero":
        true_t = true_t + np.where(np.arange(n) > n // 2, 0.5, 0.0)
    u = direction(true_i, true_t)
    small = 0.007 * rng.standard_normal((3, 3))
    turn = np.deg2rad(1.5) * rng.standard_normal(3)
    skew = np.array([[0.0, -turn[2], turn[1]], [turn[2], 0.0, -turn[0]], [-turn[1], turn[0], 0.0]])
    felt = u.copy()
    if effect in ("quadratic", "cubic", "asymmetry"):
        curve = {"quadratic": np.square, "cubic": lambda x: x**3, "asymmetry": np.abs}[effect]
        felt = u + 0.004 * rng.choice([-1.0, 1.0], 3) * curve(u)
    elif effect == "cross_axis":
        felt = u + 0.004 * u * np.roll(u, 1, axis=1)
    elif effect == "bias_drift":
        felt = u + 0.006 * share[:, None] * rng.standard_normal(3)
    elif effect == "hysteresis":
        felt = u - 0.004 * (u - np.vstack([u[:1], u[:-1]]))
    reading = 1000.0 * felt @ (np.eye(3) + small + skew).T + 25.0 * rng.standard_normal(3)
    return Sheet(i, t, reading + sigma * _noise(noise, (n, 3), rng))


def _noise(kind: str, shape: tuple[int, int], rng: np.random.Generator) -> Array:
    if kind == "t4":
        return rng.standard_t(4.0, shape) / np.sqrt(2.0)
    e = rng.standard_normal(shape)
    if kind == "ar":
        for k in range(1, shape[0]):
            e[k] = 0.6 * e[k - 1] + 0.8 * e[k]
    return e


def exchanged(sheet: Sheet, p: int, q: int) -> Sheet:
    """The readings of rows p and q (from 1) exchanged."""
    y = sheet.reading.copy()
    y[[p - 1, q - 1]] = y[[q - 1, p - 1]]
    return replace(sheet, reading=y, slip=Slip("exchange", (p, q), f"--swap {p},{q}"))


def mistyped(sheet: Sheet, row: int, column: str, by: float) -> Sheet:
    """One angle written wrong by some degrees."""
    dial = getattr(sheet, column).copy()
    was = dial[row - 1]
    dial[row - 1] = was + by
    slip = Slip("angle", (row,), f"--fix {row}:{column}={was:g}", was)
    return replace(sheet, **{column: dial}, slip=slip)


def cell(sheet: Sheet, row: int, axis: int, factor: float) -> Sheet:
    """One cell with a lost sign (-1) or a factor ten."""
    y = sheet.reading.copy()
    y[row - 1, axis] *= factor
    line = f"--fix {row}:{'xyz'[axis]}={sheet.reading[row - 1, axis]:.10g}"
    return replace(sheet, reading=y, slip=Slip("cell", (row,), line))


def cells_exchanged(sheet: Sheet, row: int, a: int, b: int) -> Sheet:
    """Two cells of a row exchanged."""
    y = sheet.reading.copy()
    y[row - 1, [a, b]] = y[row - 1, [b, a]]
    low, high = sorted((a, b))
    line = " ".join(f"--fix {row}:{'xyz'[k]}={sheet.reading[row - 1, k]:.10g}" for k in (low, high))
    return replace(sheet, reading=y, slip=Slip("cell", (row,), line))


def digits_exchanged(sheet: Sheet, row: int, axis: int, at: int) -> Sheet:
    """Digit `at` of a cell (from 0) and its right neighbour exchanged."""
    y = sheet.reading.copy()
    text = f"{y[row - 1, axis]:.10g}"
    places = [k for k, letter in enumerate(text) if letter.isdigit()][at : at + 2]
    letters = list(text)
    letters[places[0]], letters[places[1]] = letters[places[1]], letters[places[0]]
    y[row - 1, axis] = float("".join(letters))
    return replace(sheet, reading=y, slip=Slip("cell", (row,), f"--fix {row}:{'xyz'[axis]}={text}"))


def setting_mistyped(sheet: Sheet, first: int, last: int, column: str, by: float) -> Sheet:
    """The angle that rows first to last share written wrong in all of them."""
    dial = getattr(sheet, column).copy()
    was = dial[first - 1]
    dial[first - 1 : last] = was + by
    rows = tuple(range(first, last + 1))
    slip = Slip("setting", rows, f"--fix {first}-{last}:{column}={was:g}", was)
    return replace(sheet, **{column: dial}, slip=slip)


def part_turned(sheet: Sheet, first: int, order: tuple[int, ...], sign: tuple[int, ...]) -> Sheet:
    """From row `first` on, column order[k] of the sheet is sign[k] times axis k."""
    last = len(sheet.reading)
    turned = axes(sheet, order, sign)
    y = np.concatenate([sheet.reading[: first - 1], turned.reading[first - 1 :]])
    line = turned.slip.line.replace("--axes=", f"--axes={first}-{last}:")
    return replace(sheet, reading=y, slip=Slip("part", tuple(range(first, last + 1)), line))


def moved(sheet: Sheet, at: int, to: int) -> Sheet:
    """The reading of row `to` was noted at row `at`, and those between one row farther."""
    order = np.arange(len(sheet.reading))
    rest = np.delete(order, to - 1)
    order = np.insert(rest, at - 1, to - 1)
    slip = Slip("move", tuple(range(min(at, to), max(at, to) + 1)), f"--move {at},{to}")
    return replace(sheet, reading=sheet.reading[order], slip=slip)


def shifted(sheet: Sheet, first: int, last: int, *, late: bool) -> Sheet:
    """Readings of a block one row late (the first noted twice) or early (the last noted twice)."""
    y, a, b = sheet.reading.copy(), first - 1, last - 1
    if late:
        y[a + 1 : b + 1] = sheet.reading[a:b]
    else:
        y[a:b] = sheet.reading[a + 1 : b + 1]
    line = f"--shift readings:{first}-{last}={-1 if late else 1}"
    return replace(sheet, reading=y, slip=Slip("shift", tuple(range(first, last + 1)), line))


def from_vertical(sheet: Sheet) -> Sheet:
    """Inclination noted from the vertical."""
    slip = Slip("vertical", (), "--inclination-zero vertical")
    return replace(sheet, inclination=90.0 - sheet.inclination, slip=slip)


def in_radians(sheet: Sheet) -> Sheet:
    """Both angles in radians under headings that do not say so."""
    i, t = np.round(np.deg2rad(sheet.inclination), 6), np.round(np.deg2rad(sheet.tool_face), 6)
    return replace(sheet, inclination=i, tool_face=t, slip=Slip("radians", (), "--angle-unit rad"))


def angles_exchanged(sheet: Sheet) -> Sheet:
    """The headings of the two angles exchanged."""
    i, t = sheet.tool_face, sheet.inclination
    return replace(sheet, inclination=i, tool_face=t, slip=Slip("angles", (), "--swap-angles"))


def other_sense(sheet: Sheet) -> Sheet:
    """Tool-face counted the other way."""
    t = np.mod(360.0 - sheet.tool_face, 360.0)
    return replace(sheet, tool_face=t, slip=Slip("sense", (), "--toolface-sense counter-clockwise"))


def axes(sheet: Sheet, order: tuple[int, ...], sign: tuple[int, ...]) -> Sheet:
    """Columns permuted and inverted: column order[k] of the sheet is sign[k] times axis k."""
    y = np.empty_like(sheet.reading)
    y[:, list(order)] = sheet.reading * np.array(sign)
    line = ",".join(("-" if s < 0 else "") + "xyz"[k] for s, k in zip(sign, order, strict=True))
    return replace(sheet, reading=y, slip=Slip("axes", (), f"--axes={line}"))


def angle_late(sheet: Sheet, column: str) -> Sheet:
    """One angle noted a row too early: each reading stands at the angle of the row before."""
    dial = getattr(sheet, column)
    moved = np.append(dial[1:], dial[0])
    return replace(sheet, **{column: moved}, slip=Slip("late", (), f"--shift {column}=1"))


def apart(sheet: Sheet, p: int, q: int) -> float:
    """Distance (mg) of the positions of two rows (from 1)."""
    u = direction(sheet.inclination, sheet.tool_face)
    return float(1000.0 * np.linalg.norm(u[p - 1] - u[q - 1]))


def _any_rows(sheet: Sheet, kind: str, rng: np.random.Generator) -> Sheet | None:
    """A slip about two rows drawn at random; None where it would change little."""
    n = len(sheet.reading)
    p, q = (int(r) for r in rng.choice(n, 2, replace=False) + 1)
    low, high = min(p, q), max(p, q)
    if apart(sheet, p, q) < 50.0 or (kind != "exchange" and high - low < 2):
        return None
    if kind == "exchange":
        return exchanged(sheet, low, high)
    if kind == "move":
        return moved(sheet, p, q)
    return shifted(sheet, low, high, late=bool(rng.integers(2)))


def _any_cell(sheet: Sheet, kind: str, rng: np.random.Generator) -> Sheet | None:
    """A slip in cells of one row drawn at random; None where it would change little."""
    row = int(rng.integers(1, len(sheet.reading) + 1))
    a, b = (int(k) for k in rng.choice(3, 2, replace=False))
    y = sheet.reading[row - 1]
    if kind == "cells":
        return cells_exchanged(sheet, row, a, b) if abs(y[a] - y[b]) > 30.0 else None
    if abs(y[a]) < 60.0:
        return None
    if kind == "digits":
        made = digits_exchanged(sheet, row, int(a), int(rng.integers(3)))
        return made if abs(made.reading[row - 1, a] - y[a]) > 30.0 else None
    return cell(sheet, row, a, -1.0 if kind == "sign" else float(rng.choice([10.0, 0.1])))


def _any_angle(sheet: Sheet, kind: str, rng: np.random.Generator) -> Sheet | None:
    """An angle off by 5 to 90 deg; none of tool-face where the tool stands upright."""
    row = int(rng.integers(1, len(sheet.reading) + 1))
    column = str(rng.choice(["inclination", "tool_face"]))
    by = float(rng.choice([-1.0, 1.0]) * rng.choice([5, 10, 20, 30, 60, 90]))
    blind = column == "tool_face" and abs(sheet.inclination[row - 1]) > 80.0
    return None if blind else mistyped(sheet, row, column, by)


def _any_axes(sheet: Sheet, kind: str, rng: np.random.Generator) -> Sheet | None:
    order, sign = rng.permutation(3), rng.choice([-1, 1], 3)
    if np.array_equal(order, np.arange(3)) and (sign > 0).all():
        return None
    return axes(sheet, tuple(map(int, order)), tuple(map(int, sign)))


def _any_setting(sheet: Sheet, kind: str, rng: np.random.Generator) -> Sheet | None:
    """A setting that neighbouring rows share off by 2 to 90 deg, where there are some that do."""
    column = str(rng.choice(["inclination", "tool_face"]))
    dial = getattr(sheet, column)
    runs = np.split(np.arange(len(dial)), np.flatnonzero(np.diff(dial)) + 1)
    run = runs[int(rng.integers(len(runs)))]
    blind = column == "tool_face" and np.abs(sheet.inclination[run]).max() > 80.0
    by = float(rng.choice([-1.0, 1.0]) * rng.choice([2, 5, 10, 20, 30, 90]))
    if len(run) < 3 or 2 * len(run) > len(dial) or blind or (dial == dial[run[0]] + by).any():
        return None
    return setting_mistyped(sheet, int(run[0]) + 1, int(run[-1]) + 1, column, by)


def _any_part(sheet: Sheet, kind: str, rng: np.random.Generator) -> Sheet | None:
    """Other axes from a row in the second half on, where they are other to see in each reading."""
    n = len(sheet.reading)
    first = int(rng.integers(n // 2 + 2, n - 2))
    order, sign = tuple(map(int, rng.permutation(3))), tuple(map(int, rng.choice([-1, 1], 3)))
    made = part_turned(sheet, first, order, sign)
    moved_by = np.linalg.norm(made.reading - sheet.reading, axis=1)[first - 1 :]
    return None if moved_by.min() < 100.0 else made


def _any_late(sheet: Sheet, kind: str, rng: np.random.Generator) -> Sheet | None:
    return angle_late(sheet, str(rng.choice(["inclination", "tool_face"])))


def slipped(sheet: Sheet, kind: str, rng: np.random.Generator) -> Sheet:
    """A slip of a kind somewhere in the sheet, large enough to matter (some 50 mg)."""
    while True:
        made = WHOLE[kind](sheet) if kind in WHOLE else _ANYWHERE[kind](sheet, kind, rng)
        if made is not None:
            return made


_ANYWHERE = {
    "exchange": _any_rows, "move": _any_rows, "shift": _any_rows,
    "sign": _any_cell, "factor ten": _any_cell, "cells": _any_cell,
    "digits": _any_cell, "angle": _any_angle, "setting": _any_setting,
    "axes": _any_axes, "part": _any_part, "late": _any_late,
}  # fmt: skip
WHOLE = {
    "vertical": from_vertical,
    "radians": in_radians,
    "angles": angles_exchanged,
    "sense": other_sense,
}
KINDS = (*_ANYWHERE, *WHOLE)
