"""Mistyped angles: of one row, or of all rows that share a setting, read anew over the dial.

A reading that was taken at another angle differs from what the sheet says by the response to the
other force: one change of the readings for every degree of the dial. Half of the prior is on values
that the sheet has already. The value between the degrees follows from the curvature of the misfit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.references import unit_vector
from imucalib.posterior.odds import DIAL_STEPS, MISTYPED, ON_STEP
from imucalib.posterior.sheet.sheet import Fault, Sheet, Trial
from imucalib.posterior.slips.cells import BaseProducts, prior_of, select_leading

_NAMES = ("inclination", "tool_face")


def angles(base: BaseProducts, unit: tuple[float, float] = (1.0, 1.0)) -> Iterator[Trial]:
    """Every row's and every shared setting's inclination and tool-face at every degree of the dial.

    unit : what one degree is in the sheet's columns of inclination and tool-face (π/180 for rad)
    """
    sheet = base.sheet
    alone = [np.array([row]) for row in np.flatnonzero(~sheet.find_copies())]
    for column in (0, 1):
        for groups in (alone, _group_shared(sheet, column)):
            tried = [_over_the_dial(base, rows, column, 2.0 * len(groups)) for rows in groups]
            tops = np.array([score.max() for _, score, _ in tried])
            for k in select_leading(tops):
                dial, score, prior = tried[k]
                at = int(np.argmax(score))
                fault, mended = _mend(base, groups[k], column, dial[at], score[at], unit[column])
                yield Trial(fault, mended, float(prior[at]))


def _group_shared(sheet: Sheet, column: int) -> list[Index]:
    """The rows of every setting that neighbours share, with as many rows beside it as in it."""
    held = getattr(sheet, f"{_NAMES[column]}_setting")
    runs = np.split(np.arange(sheet.n), np.flatnonzero(np.diff(held)) + 1)
    whole = [rows for rows in runs if np.sum(held == held[rows[0]]) == len(rows)]
    return [rows for rows in whole if 2 <= len(rows) <= sheet.n // 2]


def _over_the_dial(
    base: BaseProducts, rows: Index, column: int, groups: float
) -> tuple[Array, Array, Array]:
    """Degrees (d,), the nats (d,) that the rows gain there, and the log prior odds (d,) in them."""
    own = getattr(base.sheet, _NAMES[column])
    dial = dial_of(column, own)
    seen = np.isin(dial, np.round(own))
    share = np.where(seen, 0.5 / max(seen.sum(), 1), 0.5 / len(dial))
    prior = prior_of(groups) + np.log(share)
    score = base.gain(_misfit(base, rows, column, dial), groups) + np.log(share)
    same = apart(dial, float(own[rows[0]]), column) < MISTYPED
    return dial, np.where(same, -np.inf, score), prior


def _misfit(base: BaseProducts, rows: Index, column: int, dial: Array) -> Array:
    """(G, d) sums of squares with some rows at each value of a dial."""
    sheet = base.sheet
    both = [np.tile(a[rows], (len(dial), 1)) for a in (sheet.inclination, sheet.tool_face)]
    both[column] = np.repeat(dial[:, None], len(rows), axis=1)
    force = unit_vector(*sheet.inside(both[0].ravel(), both[1].ravel()))
    moved = force.reshape(len(dial), len(rows), 3) - sheet.truth()[rows] / sheet.gravity
    return base.misfit(rows, -sheet.gravity * moved @ base.response.T)


def _mend(
    base: BaseProducts, rows: Index, column: int, at: float, score: float, unit: float
) -> tuple[Fault, Sheet]:
    sheet, name = base.sheet, _NAMES[column]
    dial, settings = getattr(sheet, name).copy(), getattr(sheet, f"{name}_setting").copy()
    own = float(dial[rows[0]])
    value, sd = _refine(base, rows, column, at)
    shown = round_to_step(value, sd, np.delete(dial, rows))
    if apart(np.array([shown]), own, column)[0] < MISTYPED:
        shown = round(value, 1)  # the dial's step would lead back to what the sheet has
    numbers = tuple(int(row) for row in sheet.row[rows])
    where, lines, says = f"row {numbers[0]}", f"{numbers[0]}", "reading says"
    if len(numbers) > 1:
        where, says = f"rows {numbers[0]} to {numbers[-1]}", "readings say"
        lines = f"{numbers[0]}-{numbers[-1]}"
    what = (
        f"{where}: {name.replace('_', '-')} is {own:g} on the sheet where the {says} "
        f"{value:.2f} ± {sd:.2g} deg"
    )
    line = f"--fix {lines}:{name}={shown * unit:.10g}"
    fault = Fault("angle" if len(numbers) == 1 else "setting", what, numbers, float(score), line)
    dial[rows] = shown
    if sheet.ordered:
        settings = np.concatenate([[0], np.cumsum(np.diff(dial) != 0.0)]).astype(np.intp)
    else:
        settings[rows] = settings.max() + 1
    return fault, replace(sheet, **{name: dial, f"{name}_setting": settings})


def _refine(base: BaseProducts, rows: Index, column: int, at: float) -> tuple[float, float]:
    """The value between the whole degrees, and its sd (deg), at the likeliest noise."""
    k = int(np.argmax(base.each(base.rss)))
    low, middle, high = _misfit(base, rows, column, at + np.array([-0.5, 0.0, 0.5]))[k]
    bend = max(float(low - 2.0 * middle + high) / 0.25, 1e-12)
    value = at + float(np.clip((low - high) / bend, -1.0, 1.0))
    left = max(float(_misfit(base, rows, column, np.array([value]))[k, 0]), 1e-12)
    return value, float(np.sqrt(2.0 * left / base.dof / bend))


def dial_of(column: int, set_to: Array) -> Array:
    """Whole degrees that the dial shows: a turn of tool-face, 270 degrees of inclination."""
    if column:
        low = -180.0 if set_to.min() < 0.0 else 0.0
        return np.arange(low, low + 360.0)
    return np.arange(-90.0, 91.0) if set_to.max() <= 95.0 else np.arange(-90.0, 181.0)


def apart(value: Array, own: float, column: int) -> Array:
    """(...) deg, how far values are from one, around the turn for a tool-face."""
    away = np.abs(value - own)
    return np.abs(np.mod(away + 180.0, 360.0) - 180.0) if column else away


def round_to_step(value: float, sd: float, set_to: Array) -> float:
    """A value on the steps to which the column is set; finer steps where neither three sd nor a
    fifth of the step (2 deg at most: what a dial may be off) reach one."""
    for step in DIAL_STEPS:
        on = np.abs(set_to / step - np.round(set_to / step)) < 1e-6
        near = round(value / step) * step
        if on.mean() >= ON_STEP and abs(near - value) <= max(3.0 * sd, min(step / 5.0, 2.0)):
            return float(round(near, 6)) + 0.0  # no -0
    return float(round(value, 1 if sd < 1.0 else 0))
