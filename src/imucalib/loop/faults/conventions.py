"""A whole column that means something else: angles exchanged, in radians, from the vertical, one
row late; axes permuted, inverted or mirrored.

Angles: the misfit of the plain linear map (12 parameters) under every combination. Axes: no misfit
shows them, for the map takes any; the signed permutation nearest to it does.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from imucalib.loop.faults.found import ENOUGH
from imucalib.loop.faults.sheet import Sheet


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
