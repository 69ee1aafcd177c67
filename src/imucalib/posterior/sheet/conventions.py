"""A whole column that means something else: angles exchanged, in radians, from the vertical, one
row late; axes permuted, inverted or mirrored.

Angles: the misfit of the plain linear map (12 parameters) under every combination. Axes: no misfit
shows them, for the map takes any; the signed permutation nearest to it does.

Rows of known directions, without dials, whose reading belongs to another direction.

The linear map (12 parameters) of the larger part of the rows, those that fit it best, says where
each reading belongs and how the sensor stands.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.estimators.starting_point import larger_part
from imucalib.posterior.odds import BENCH, CLEAR, FAR_BETTER, FIXTURE, WRONG
from imucalib.posterior.sheet.sheet import Fault, Sheet

#: Ways in which the angle columns may mean other than said: exchanged, in radians, from the
#: vertical, and either of them a row early or late.
_DEPARTURES = 7
_FACES = {tuple(s * np.eye(3)[a]): f"{'-+'[s > 0]}{'xyz'[a]}" for a in range(3) for s in (1, -1)}


def wrong_directions(reading: Array, direction: Array, row: Index) -> tuple[Fault, ...]:
    """Rows exchanged with each other, and rows whose direction is another one of the table.

    reading : (n, 3) mg; direction : (n, 3) unit vectors; row : (n,) numbers of the table's rows
    """
    every = np.unique(direction, axis=0)
    design, targets = (np.column_stack([d, np.ones(len(d))]) for d in (direction, every))
    made = larger_part(design, reading).map
    if made is None:
        return ()
    own = np.linalg.norm(reading - design @ made, axis=1)
    each = np.linalg.norm(reading[:, None] - targets @ made, axis=2)
    fits = np.argmin(each, axis=1)
    worth = 3.0 * np.log(np.maximum(own, FIXTURE) / np.maximum(each.min(axis=1), FIXTURE))
    wrong = np.flatnonzero(worth > CLEAR)

    def same(one: Array, other: Array) -> bool:
        return bool(np.allclose(one, other, atol=1e-9))

    found, seen = [], set[int]()
    for k in wrong:
        other = [m for m in wrong if same(every[fits[m]], direction[k])]
        twin = next((m for m in other if m > k and same(every[fits[k]], direction[m])), None)
        if k in seen:
            continue
        if twin is not None and twin not in seen:
            seen.add(int(twin))
            rows = (int(row[k]), int(row[twin]))
            what = f"rows {rows[0]} and {rows[1]}: their readings are exchanged"
            score = float(worth[k] + worth[twin])
            found.append(Fault("exchange", what, rows, score, f"--swap {rows[0]},{rows[1]}"))
        elif not same(every[fits[k]], -direction[k]):  # a lost sign as well, which others tell
            found.append(_note(int(row[k]), direction[k], every[fits[k]], float(worth[k])))
    return tuple(found)


def _note(row: int, said: Array, fits: Array, score: float) -> Fault:
    what = f"row {row}: the sheet says {_name_axis(said)} where the reading fits {_name_axis(fits)}"
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


def _name_axis(direction: Array) -> str:
    face = _FACES.get(tuple(direction))
    return f"face {face}" if face else ", ".join(f"{v:+.3f}" for v in direction)


class AngleMeaning(NamedTuple):
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

    meaning: AngleMeaning
    score: float
    misfit: float
    as_given: float


def misread_angles(sheet: Sheet) -> Misread | None:
    """The likeliest meaning of the angle columns when it is not the stated one, else None.

    log p = -ν/2 ln RSS + ln prior, with scatter of a bench's size under each: no sheet is better
    than the tenth of a degree to which a bench is set, so a misfit below 2 mg counts as 2 mg. Each
    departure from what is stated has a slip's prior odds. All meanings are held against the same
    readings, those whose angles each of them knows. A false row is false under every meaning: one
    is far better where it is so in all rows or in the larger part of them. Of a column that moved
    all rows must say so: most may stand where they stood.
    """
    steps = (-1, 0, 1) if sheet.ordered else (0,)
    tried = [
        AngleMeaning(*m)
        for m in product((False, True), (False, True), (False, True), steps, steps)
        # Both angles moved by one step is a shift of the readings, and is told as one.
        if not (m[3] and m[3] == m[4])
    ]
    rows = sheet.row[1:-1] if sheet.ordered else sheet.row
    misfits = dict.fromkeys(tried, np.inf)
    parts = dict.fromkeys(tried, np.inf)
    for meaning in tried:
        other = as_meant(sheet, meaning)
        if other is not None:
            known = other.take(np.flatnonzero(np.isin(other.row, rows)))
            misfits[meaning] = max(_misfit(known, whole=meaning != AngleMeaning()), BENCH)
            parts[meaning] = max(_misfit_of_part(known), BENCH)
    plain, dof = misfits[AngleMeaning()], 3 * rows.size - 15
    if not np.isfinite(plain):
        return None
    logs = {
        m: sum(map(bool, m)) * np.log(WRONG / _DEPARTURES) - dof * np.log(misfits[m]) for m in tried
    }
    best = max(tried, key=lambda m: logs[m])
    score = float(logs[best] - logs[AngleMeaning()])
    told = (misfits,) if best.inclination_steps or best.tool_face_steps else (misfits, parts)
    far_better = any(each[best] <= each[AngleMeaning()] * FAR_BETTER for each in told)
    if score <= CLEAR or not far_better:
        return None
    return Misread(best, score, misfits[best], plain)


def as_meant(sheet: Sheet, meaning: AngleMeaning) -> Sheet | None:
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


def _linear_map(sheet: Sheet) -> tuple[Array, Array, int]:
    """(n, 4) the design, (4, 3) mg the linear map of the truth, and its rank."""
    design = np.column_stack([sheet.truth(), np.ones(sheet.n)])
    found, _, rank, _ = np.linalg.lstsq(design, sheet.reading, rcond=1e-6)
    return design, np.asarray(found), int(rank)


def _misfit(sheet: Sheet, *, whole: bool) -> float:
    """rms length (mg) that the best linear map leaves, per degree of freedom; inf for too few rows
    or, where a `whole` map is asked for, for rows that do not determine it."""
    design, found, rank = _linear_map(sheet)
    if (whole and rank < 4) or sheet.n < 6:
        return float("inf")
    rest = sheet.reading - design @ found
    return float(np.sqrt(np.sum(rest**2) / (sheet.n - 4)))


def _misfit_of_part(sheet: Sheet) -> float:
    """Mean length (mg) that the linear map of the larger part of the rows leaves on these."""
    part = larger_part(np.column_stack([sheet.truth(), np.ones(sheet.n)]), sheet.reading)
    return part.misfit / part.rows.size


def axes_text(source: Iterable[int], sign: Iterable[float]) -> str:
    """ "-y,x,z": the columns (from 0) and signs of x, y and z."""
    signs = ("-" if s < 0 else "" for s in sign)
    return ",".join(s + "xyz"[k] for s, k in zip(signs, source, strict=True))


@dataclass(frozen=True)
class Axes:
    """The sensor's axes in the tool's frame: the signed permutation nearest to the linear map.

    text : "-y,x,z", what the columns would have to be; mirrored : no turn of the sensor does it
    """

    text: str
    mirrored: bool

    @property
    def straight(self) -> bool:
        return self.text == "x,y,z"


def nearest_axes(sheet: Sheet) -> Axes | None:
    """Of the larger part of the rows; None where these do not determine the linear map."""
    found = larger_part(np.column_stack([sheet.truth(), np.ones(sheet.n)]), sheet.reading).map
    if found is None:
        return None
    u, _, v = np.linalg.svd(found[:3].T)
    turn, axes = u @ v, np.arange(3)
    source, sign = max(
        product(permutations(range(3)), product((1.0, -1.0), repeat=3)),
        key=lambda one: (float(np.dot(one[1], turn[list(one[0]), axes])), one),
    )
    return Axes(axes_text(source, sign), bool(np.linalg.det(found[:3]) < 0.0))
