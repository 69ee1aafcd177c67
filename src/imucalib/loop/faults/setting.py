"""One setting's angle, mistyped in all of the rows that share it.

The plain linear map over every degree of the dial says where the setting was; the whole likelihood
of the sheet, mended so, says what that is worth. A setting that scatters so far is the rival.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.references import unit_vector
from imucalib.loop.faults.angles import apart, dial_of, rounded
from imucalib.loop.faults.conventions import BENCH
from imucalib.loop.faults.found import ENOUGH, Fault, Hypothesis
from imucalib.loop.faults.noise_grid import Base, base_of
from imucalib.loop.faults.sheet import Sheet

#: A typo is at least this far (deg) from what the sheet has.
_NEAREST = 1.0
#: Rows that a setting has at least, and settings that are looked at closely.
_LEAST, _CLOSELY = 2, 2


@dataclass(frozen=True)
class _Reset:
    """A setting that may be mistyped. rows : (m,) from 0; value, sd : deg; gain : nats, roughly"""

    rows: Index
    column: int
    value: float
    sd: float
    gain: float


def settings(base: Base, unit: tuple[float, float] = (1.0, 1.0)) -> list[Hypothesis]:
    """Every setting that neighbouring rows share, read anew at every degree of its dial.

    unit : what one degree is in the sheet's columns of inclination and tool-face (π/180 for rad)
    """
    sheet = base.sheet
    shared = [(rows, column) for column in (0, 1) for rows in _shared(sheet, column)]
    if not shared:
        return []
    tried = [one for rows, column in shared if (one := _reset(sheet, rows, column)) is not None]
    paid = float(np.log(len(shared) * len(dial_of(1, sheet.tool_face))))
    near = sorted((t for t in tried if t.gain - paid > ENOUGH), key=lambda t: -t.gain)
    found = [_mistyped(base, one, paid, unit[one.column]) for one in near[:_CLOSELY]]
    return [h for h in found if h is not None and h.fault.score > ENOUGH]


def _shared(sheet: Sheet, column: int) -> list[Index]:
    """The rows of every setting that neighbours share, with more rows beside it than in it."""
    held = (sheet.inclination_setting, sheet.tool_face_setting)[column]
    runs = np.split(np.arange(sheet.n), np.flatnonzero(np.diff(held)) + 1)
    alone = [len(np.flatnonzero(held == held[rows[0]])) == len(rows) for rows in runs]
    return [
        rows
        for rows, whole in zip(runs, alone, strict=True)
        if whole and _LEAST <= len(rows) <= sheet.n // 2
    ]


def _reset(sheet: Sheet, rows: Index, column: int) -> _Reset | None:
    """The angle at which the plain linear map fits best; None where it is the sheet's own."""
    own = (sheet.inclination, sheet.tool_face)[column]
    dial = dial_of(column, own)
    left = _misfits(sheet, rows, column, np.append(dial, own[rows[0]]))
    best = int(
        np.argmin(np.where(apart(dial, float(own[rows[0]]), column) >= _NEAREST, left[:-1], np.inf))
    )
    dof = 3 * sheet.n - 12
    floor = dof * BENCH**2
    gain = 0.5 * dof * float(np.log(max(left[-1], floor) / max(left[best], floor)))
    fine = dial[best] + np.array([-0.5, 0.0, 0.5])
    a, b, c = _misfits(sheet, rows, column, fine)
    bend = (a - 2.0 * b + c) / 0.25
    if bend <= 0.0:
        return None
    value = float(dial[best] - (c - a) / bend)
    return _Reset(rows, column, value, float(np.sqrt(2.0 * b / dof / bend)), gain)


def _misfits(sheet: Sheet, rows: Index, column: int, dial: Array) -> Array:
    """(d,) sums of squares that the plain linear map leaves, mg², with rows at each value."""
    both = [np.tile(a[rows], len(dial)) for a in (sheet.inclination, sheet.tool_face)]
    both[column] = np.repeat(dial, len(rows))
    truth = sheet.gravity * unit_vector(*sheet.inside(both[0], both[1]))
    plain = np.column_stack([sheet.truth(), np.ones(sheet.n)])
    design = np.broadcast_to(plain, (len(dial), *plain.shape)).copy()
    design[:, rows, :3] = truth.reshape(len(dial), len(rows), 3)
    q = np.linalg.qr(design)[0]
    rest = sheet.reading - q @ (q.swapaxes(1, 2) @ sheet.reading)
    return np.asarray(np.sum(rest**2, axis=(1, 2)))


def _set_to(sheet: Sheet, rows: Index, column: int, value: float) -> Sheet:
    name = ("inclination", "tool_face")[column]
    dial = getattr(sheet, name).copy()
    dial[rows] = value
    return replace(sheet, **{name: dial})


def _mistyped(base: Base, one: _Reset, paid: float, unit: float) -> Hypothesis | None:
    sheet, name = base.sheet, ("inclination", "tool_face")[one.column]
    own = (sheet.inclination, sheet.tool_face)[one.column]
    shown = rounded(one.value, one.sd, np.delete(own, one.rows))
    mended = _set_to(sheet, one.rows, one.column, shown)
    after = base_of(mended)
    if after is None or apart(np.array([shown]), float(own[one.rows[0]]), one.column)[0] < _NEAREST:
        return None
    rows = tuple(int(row) for row in sheet.row[one.rows])
    sd = float(np.hypot(one.sd, _scatter(after, one.column)))
    what = (
        f"rows {rows[0]} to {rows[-1]}: {name.replace('_', '-')} is {own[one.rows[0]]:g} on the "
        f"sheet where the readings say {one.value:.2f} ± {sd:.2g} deg"
    )
    line = f"--fix {rows[0]}-{rows[-1]}:{name}={shown * unit:.10g}"
    score = after.as_it_stands - base.as_it_stands - paid
    return Hypothesis(Fault("setting", what, rows, float(score), line), mended)


def _scatter(base: Base, column: int) -> float:
    """deg, by which the settings of a sheet scatter at the likeliest noise."""
    k = int(np.argmax(base.each(base.rss)))
    ratio = (base.grid.inclination, base.grid.tool_face)[column][k]
    return float(ratio * np.sqrt(base.rss[k] / base.dof))
