"""A whole column that means something else: angles exchanged, in radians, from the vertical, one
row late; axes permuted, inverted or mirrored.

Angles: the misfit of the plain linear map (12 parameters) under every combination. Axes: no misfit
shows them, for the map takes any; the signed permutation nearest to it does.

Rows of known directions, without dials, whose reading belongs to another direction.

The linear map (12 parameters) of the three quarters of rows that fit it best, found by
concentration steps (Rousseeuw and Van Driessen 1999), says where each reading belongs.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.estimators.starting_point import concentrated
from imucalib.loop.faults.sheet import Fault, Sheet

#: Nats beyond the sheet as it stands below which nothing is said.
ENOUGH = 5.0
#: Share of the rows that make the map.
_SHARE = 0.75
#: Misfit (mg) that any fixture may have: bias, tilt and noise.
_FIXTURE = 20.0
_FACES = {tuple(s * np.eye(3)[a]): f"{'-+'[s > 0]}{'xyz'[a]}" for a in range(3) for s in (1, -1)}


def wrong_directions(reading: Array, direction: Array, row: Index) -> tuple[Fault, ...]:
    """Rows exchanged with each other, and rows whose direction is another one of the table.

    reading : (n, 3) mg; direction : (n, 3) unit vectors; row : (n,) numbers of the table's rows
    """
    every = np.unique(direction, axis=0)
    made = _map(reading, direction)
    if made is None:
        return ()
    own = np.linalg.norm(reading - _read(direction, made), axis=1)
    each = np.linalg.norm(reading[:, None] - _read(every, made)[None], axis=2)
    fits = np.argmin(each, axis=1)
    worth = 3.0 * np.log(np.maximum(own, _FIXTURE) / np.maximum(each.min(axis=1), _FIXTURE))
    wrong = np.flatnonzero(worth > ENOUGH)
    found, told = [], set[int]()
    for k in wrong:
        other = [m for m in wrong if _same(every[fits[m]], direction[k])]
        twin = next((m for m in other if m > k and _same(every[fits[k]], direction[m])), None)
        if k in told:
            continue
        if twin is not None and twin not in told:
            told.add(int(twin))
            found.append(_exchanged(int(row[k]), int(row[twin]), float(worth[k] + worth[twin])))
        elif not _same(every[fits[k]], -direction[k]):  # a lost sign as well, which others tell
            found.append(_noted(int(row[k]), direction[k], every[fits[k]], float(worth[k])))
    return tuple(found)


def _map(reading: Array, direction: Array) -> Array | None:
    """(4, 3) mg, the linear map of the rows that fit it best; None where it stays open."""
    design = np.column_stack([direction, np.ones(len(direction))])
    every = np.arange(len(design))
    return concentrated(design, reading, every, max(5, int(_SHARE * len(design)))).map


def _read(direction: Array, made: Array) -> Array:
    return np.asarray(direction @ made[:3] + made[3])


def _same(one: Array, other: Array) -> bool:
    return bool(np.allclose(one, other, atol=1e-9))


def _exchanged(row: int, other: int, score: float) -> Fault:
    what = f"rows {row} and {other}: their readings are exchanged"
    return Fault("exchange", what, (row, other), score, f"--swap {row},{other}")


def _noted(row: int, said: Array, fits: Array, score: float) -> Fault:
    what = f"row {row}: the sheet says {_named(said)} where the reading fits {_named(fits)}"
    face = _FACES.get(tuple(fits))
    line = (
        f"--fix {row}:face={face}"
        if face
        else " ".join(
            f"--fix {row}:{axis}={value:.10g}"
            for axis, value in zip(("ux", "uy", "uz"), fits, strict=True)
        )
    )
    return Fault("angle", what, (row,), score, line)


def _named(direction: Array) -> str:
    face = _FACES.get(tuple(direction))
    return f"face {face}" if face else ", ".join(f"{v:+.3f}" for v in direction)


class Meaning(NamedTuple):
    """What the angle columns may mean other than said; steps: rows that a column must move down."""

    exchanged: bool = False
    radians: bool = False
    vertical: bool = False
    inclination_steps: int = 0
    tool_face_steps: int = 0


@dataclass(frozen=True)
class Misread:
    """The meaning of the angles that fits, and what it is worth.

    score : nats over the sheet as it stands; misfit, as_given : rms of the linear map, mg
    """

    meaning: Meaning
    score: float
    misfit: float
    as_given: float


def misread_angles(sheet: Sheet) -> Misread | None:
    """The best meaning of the angle columns when it is not the stated one, else None.

    log L = -ν/2 ln RSS with scatter of a bench's size under both: no sheet is better than the
    tenth of a degree to which a bench is set, so a misfit below 2 mg counts as 2 mg.
    """
    steps = (-1, 0, 1) if sheet.ordered else (0,)
    tried = [
        Meaning(*m)
        for m in product((False, True), (False, True), (False, True), steps, steps)
        # Both angles moved by one step is a shift of the readings, and is told as one.
        if not (m[3] and m[3] == m[4])
    ]
    left = {}
    for meaning in tried:
        other = as_meant(sheet, meaning)
        misfit = np.inf if other is None else linear_misfit(other, whole=meaning != Meaning())
        left[meaning] = max(misfit, BENCH)
    plain = left[Meaning()]
    best = min(tried, key=lambda m: (round(left[m], 6), sum(map(bool, m))))
    if best == Meaning() or not np.isfinite(plain):
        return None
    dof = 3 * sheet.n - 15
    score = dof * np.log(plain / left[best]) - np.log(len(tried))
    if score <= ENOUGH or left[best] > plain * _FAR_BETTER:
        return None
    return Misread(best, float(score), left[best], plain)


#: Misfit (mg rms) below which a linear map says nothing; how much better another meaning must fit.
BENCH, _FAR_BETTER = 2.0, 1.0 / 3.0


def as_meant(sheet: Sheet, meaning: Meaning) -> Sheet | None:
    """The sheet with its angles read so; None where they would be out of range."""
    i, t = sheet.inclination, sheet.tool_face
    if meaning.exchanged:
        i, t = t, i
    if meaning.radians:
        i, t = np.degrees(i), np.degrees(t)
    if meaning.vertical:
        i = 90.0 - i
    if max(np.abs(i).max(), np.abs(t).max()) > 720.0:
        return None
    known = np.arange(sheet.n)
    for step in (meaning.inclination_steps, meaning.tool_face_steps):
        if step:
            known = known[1:] if step > 0 else known[:-1]
    i, t = np.roll(i, meaning.inclination_steps), np.roll(t, meaning.tool_face_steps)
    return replace(sheet, inclination=i, tool_face=t).take(known)


def linear_misfit(sheet: Sheet, *, whole: bool = True) -> float:
    """rms length (mg) that the best linear map leaves, per degree of freedom; inf for too few rows
    or, where a `whole` map is asked for, for rows that do not determine it."""
    design = np.column_stack([sheet.truth(), np.ones(sheet.n)])
    found, _, rank, _ = np.linalg.lstsq(design, sheet.reading, rcond=1e-6)
    if (whole and rank < 4) or sheet.n < 6:
        return float("inf")
    rest = sheet.reading - design @ found
    return float(np.sqrt(np.sum(rest**2) / (sheet.n - 4)))


def axes_text(source: Iterable[int], sign: Iterable[float]) -> str:
    """ "-y,x,z": the columns (from 0) and signs of x, y and z."""
    signs = ("-" if s < 0 else "" for s in sign)
    return ",".join(s + "xyz"[k] for s, k in zip(signs, source, strict=True))


@dataclass(frozen=True)
class Axes:
    """The sensor's axes in the tool's frame: the signed permutation nearest to the linear map.

    source : for x, y, z of the tool the column (from 0) that reads it; sign : (3,) of +1 and -1
    mirrored : no turn of the sensor does it; angle : deg, how far the map is from it
    """

    source: tuple[int, int, int]
    sign: tuple[int, int, int]
    mirrored: bool
    angle: float

    @property
    def straight(self) -> bool:
        return self.source == (0, 1, 2) and self.sign == (1, 1, 1)

    @property
    def text(self) -> str:
        """ "-y,x,z": what the columns would have to be."""
        return axes_text(self.source, self.sign)


def nearest_axes(sheet: Sheet) -> Axes | None:
    """None where the rows do not determine the linear map."""
    design = np.column_stack([sheet.truth(), np.ones(sheet.n)])
    found, _, rank, _ = np.linalg.lstsq(design, sheet.reading, rcond=1e-6)
    if rank < 4:
        return None
    u, _, v = np.linalg.svd(found[:3].T)
    turn = u @ v
    every = [
        (sum(s * turn[k, axis] for axis, (k, s) in enumerate(zip(p, signs, strict=True))), p, signs)
        for p in permutations(range(3))
        for signs in product((1, -1), repeat=3)
    ]
    trace, source, sign = max(every)
    mirrored = bool(np.linalg.det(found[:3]) < 0.0)
    angle = float(np.degrees(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))))
    return Axes((source[0], source[1], source[2]), (sign[0], sign[1], sign[2]), mirrored, angle)
