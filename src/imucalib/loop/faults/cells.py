"""One cell misread or mistyped: its sign, its decimal point, two of its digits, or two of its row.

Every such change d of row k's reading is exact, at each point of noise:

    RSS' = RSS + 2 d'g_k + d'P_kk d
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.faults.base import Base, prior_of
from imucalib.loop.faults.found import Fault, Hypothesis
from imucalib.loop.faults.readings import by_rows, leading

_PAIRS = ((0, 1), (0, 2), (1, 2))
#: Significant figures of a cell of which two neighbours may have changed places.
_FIGURES = 10


@dataclass(frozen=True)
class _Slip:
    """row : from 0; words : what happened; value : (3,) what the row's cells should say, in the
    sheet's unit; reading : (3,) the same in mg; digits : two of them are exchanged"""

    row: int
    words: str
    value: Array
    reading: Array
    digits: bool = False


def cells(base: Base, si: Array) -> list[Hypothesis]:
    """One cell with the wrong sign, ten times too large or small, or with two digits exchanged; or
    two cells of a row exchanged.

    si : (n, 3) the readings as the sheet has them, for the line to paste
    """
    sheet = base.sheet
    copied = sheet.copied()
    tried = [
        slip
        for row in np.flatnonzero(~copied)
        for slip in _slips(int(row), si[row], sheet.reading[row])
    ]
    row = np.array([slip.row for slip in tried], np.intp)
    if not row.size:
        return []
    d = np.stack([slip.reading for slip in tried]) - sheet.reading[row]
    P, g = by_rows(base)
    own = P[:, np.arange(sheet.n), np.arange(sheet.n)]
    moved = np.einsum("Ghij,hj->Ghi", own[:, row], d)
    rss = base.rss[:, None] + np.einsum("hi,Ghi->Gh", d, 2.0 * g[:, row] + moved)
    digits = np.array([slip.digits for slip in tried])
    # Cells of two digits exchanged are as many as all others, or more, and share their prior.
    count = 2.0 * np.where(digits, max(int(digits.sum()), 1), max(int((~digits).sum()), 1))
    score = base.gain(rss, 1.0) - np.log(count)
    prior = prior_of(1.0) - np.log(count)
    told = [(_told(base, si, tried[k], float(score[k])), float(prior[k])) for k in leading(score)]
    return [replace(one, prior=p) for one, p in told]


def _slips(row: int, si: Array, reading: Array) -> list[_Slip]:
    """Every slip of one row."""
    found = []
    unit = np.divide(reading, si, out=np.zeros(3), where=si != 0.0)
    for axis, name in enumerate("xyz"):
        change = partial(_changed, si, axis)
        found.append((f"{name} lost its sign", change(-si[axis])))
        found.append((f"{name} is ten times too large", change(0.1 * si[axis])))
        found.append((f"{name} is ten times too small", change(10.0 * si[axis])))
    slips = [_Slip(row, words, value, unit * value) for words, value in found]
    for axis, name in enumerate("xyz"):
        for digits in transposed(float(si[axis])):
            value = _changed(si, axis, digits)
            words = f"two digits of {name} are exchanged"
            slips.append(_Slip(row, words, value, unit * value, digits=True))
    for a, b in _PAIRS:
        order = np.arange(3)
        order[[a, b]] = b, a
        words = f"{'xyz'[a]} and {'xyz'[b]} are exchanged"
        slips.append(_Slip(row, words, si[order], reading[order]))
    return slips


def _changed(si: Array, axis: int, value: float) -> Array:
    other = si.copy()
    other[axis] = value
    return other


def transposed(value: float) -> list[float]:
    """The numbers of which two neighbouring digits, exchanged, give this one."""
    text = f"{abs(value):.{_FIGURES}g}"
    if "e" in text:
        return []
    text = f"0{text}"  # a zero in front was not written
    at = [k for k, letter in enumerate(text) if letter.isdigit()]
    found = []
    for a, b in pairwise(at):
        if text[a] != text[b]:
            letters = list(text)
            letters[a], letters[b] = letters[b], letters[a]
            found.append(float(np.copysign(float("".join(letters)), value)))
    return found


def _told(base: Base, si: Array, slip: _Slip, score: float) -> Hypothesis:
    number = int(base.sheet.row[slip.row])
    mended = tuple(
        (axis, float(value))
        for axis, value, old in zip("xyz", slip.value, si[slip.row], strict=True)
        if value != old
    )
    line = " ".join(f"--fix {number}:{axis}={value:.10g}" for axis, value in mended)
    changed = base.sheet.reading.copy()
    changed[slip.row] = slip.reading
    what = f"row {number}: {slip.words}"
    fault = Fault("cell", what, (number,), score, line, cells=mended)
    return Hypothesis(fault, base.sheet.with_reading(changed))
