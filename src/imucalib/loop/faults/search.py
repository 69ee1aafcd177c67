"""All slips of hand, tried on a sheet one after the other until none is left."""

from __future__ import annotations

from imucalib.arrays import Array
from imucalib.loop.faults.angles import angles
from imucalib.loop.faults.axes import other_axes
from imucalib.loop.faults.cells import cells
from imucalib.loop.faults.found import ENOUGH, Fault, with_rivals
from imucalib.loop.faults.noise_grid import base_of
from imucalib.loop.faults.readings import blocks, exchanges, records
from imucalib.loop.faults.setting import settings
from imucalib.loop.faults.sheet import Sheet

#: A sheet with more slips than this is better written anew.
_MOST = 5
#: Rows up to which all rows are compared with all; longer sheets are recordings.
_LONGEST = 250


def row_faults(
    sheet: Sheet, cell: Array, unit: tuple[float, float] = (1.0, 1.0)
) -> tuple[Fault, ...]:
    """Readings and angles of single rows, or of blocks of rows, that stand in the wrong place.

    cell : (N, 3) the readings of the whole table in its own unit; unit : as in `angles.angles`
    Faults that touch the same rows are told one at a time: their lines would not add up. A record
    that is wrong in no nameable way is left out and not told: the search for records tells it.
    """
    found: list[Fault] = []
    touched: set[int] = set()
    for _ in range(_MOST):
        if sheet.n > _LONGEST:
            break
        base = base_of(sheet)
        if base is None:
            break
        own = cell[sheet.place]
        every = [*exchanges(base), *cells(base, own), *blocks(base), *angles(base, unit)]
        every += [*other_axes(base), *settings(base, unit)]
        best, stray = with_rivals(every), with_rivals(records(base))
        if stray and (best is None or stray.fault.score > best.fault.score + ENOUGH):
            sheet = stray.repaired
            continue
        if best is None or touched & set(best.fault.rows):
            break
        found.append(best.fault)
        touched |= set(best.fault.rows)
        sheet = best.repaired
    return tuple(found)
