"""From a position table to observations, refusing what users mistake: angles, sizes, rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.lab.bench import (
    RawUnit,
    direction_observations,
    position_observations,
    still_observations,
)
from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.request import LabRequest
from imucalib.core.observations import Observations, with_sessions
from imucalib.errors import UsageError
from imucalib.loop.faults.cells import transposed
from imucalib.readers.conversion import Conversion, temperature
from imucalib.recording.mapping import FieldMapping
from imucalib.rests.thermal import is_power_up_code
from imucalib.units import ACCELERATION_UNITS, DEG, MG

#: A reading at rest differs from the others' size by a tenth at most, through bias and scale.
_FAR = 0.35
#: Readings this many times as large have another unit; a ratio of units is met to this share.
_OTHER_UNIT, _SAME = 5.0, 0.1
#: How near the others' size a repair brings a row: a factor ten, and digits, of which there are
#: many pairs; and how many repairs are offered.
_TENFOLD, _DIGITS, _REPAIRS = 0.1, 0.04, 3
#: Slips of the pen that a sheet may hold by themselves.
_SLIPS = 2


def observations_of(table: PositionTable, raw: RawUnit, request: LabRequest) -> Observations:
    """All rows as observations, with what their sessions share. Raises UsageError for angles that
    cannot be degrees."""
    data = _observations(table, raw, request)
    return with_sessions(data, table.columns["session"].astype(int)) if table.sessions else data


def _observations(table: PositionTable, raw: RawUnit, request: LabRequest) -> Observations:
    table = _in_celsius(table)
    reading = table.raw() * raw.si
    sigma = request.settings.sigma or MG
    if request.reference == "norm":
        return still_observations(table, reading, request.gravity, sigma=sigma)
    exact = request.settings.objective == "vector"
    if request.reference == "direction":
        if request.settings.conventions != Conventions():
            raise UsageError(
                "--reference direction has no angles that a convention could mean",
                remedy="leave the convention out: a face is the axis that reads +g",
            )
        return direction_observations(table, reading, request.gravity, sigma=sigma, tilts=not exact)
    table = _in_degrees(table)
    return position_observations(
        table,
        reading,
        request.settings.conventions,
        request.gravity,
        sigma=sigma,
        setting_errors=not exact,
    )


def _in_degrees(table: PositionTable) -> PositionTable:
    """Angle columns whose heading says rad, in degrees; refuse angles that cannot be degrees."""
    columns = dict(table.columns)
    for role in ("inclination", "tool_face"):
        if table.unit.get(role) == "rad":
            columns[role] = columns[role] / DEG
        if np.abs(columns[role]).max() > 720.0:
            worst = int(np.argmax(np.abs(columns[role])))
            raise UsageError(
                f"angle {columns[role][worst]:g} is out of range",
                where=f"{table.path}, row {table.row[worst]}, column {table.names[role]}",
                remedy="angles are in degrees, within two turns",
            )
    return replace(table, columns=columns)


def _in_celsius(table: PositionTable) -> PositionTable:
    """The temperature by the unit of its heading; refuse one without a unit that °C cannot be."""
    made = _warmth(table)
    if made is None:
        return table
    values = table.columns["temperature"]
    if made.unit != "degC":
        raise UsageError(
            f"{values.min():g} to {values.max():g} is no temperature in °C, and no unit is stated",
            where=f"{table.path}, column {table.names.get('temperature', 'temperature')}",
            remedy="head it temperature_K or temperature_F, or otherwise if it is none",
        )
    return replace(table, columns={**table.columns, "temperature": made.apply(values)})


def _warmth(table: PositionTable) -> Conversion | None:
    if "temperature" not in table:
        return None
    stated = table.unit.get("temperature", "")
    return temperature(FieldMapping(), stated, table.columns["temperature"], table.path)


def warmth_note(table: PositionTable) -> tuple[str, ...]:
    """How the temperature was read where the table does not say it."""
    made = _warmth(table)
    return (made.note,) if made is not None and made.note else ()


def without_temperature(table: PositionTable, rows: Index) -> Index:
    """Those of some rows (from 0) beside which the thermometer had not measured."""
    made = _warmth(table)
    if made is None or made.unit != "degC":
        return rows[:0]
    return rows[is_power_up_code(made.apply(table.columns["temperature"][rows]))]


def refuse_temperatures(table: PositionTable, bad: Index) -> None:
    """Raise UsageError for rows whose temperature no thermometer measured: taken for one it hides
    what the temperature does, and makes another effect of it."""
    if bad.size:
        row, value = int(table.row[bad[0]]), float(table.columns["temperature"][bad[0]])
        name = table.names.get("temperature", "temperature")
        raise UsageError(
            f"{value:g} is what a thermometer says that has not measured, and far from all others"
            + (f" (so are {bad.size - 1} more)" if bad.size > 1 else ""),
            where=f"{table.path}, row {row}, column {name}",
            remedy=f"correct the cell, or --exclude {row} or --auto-exclude",
        )


def implausible_sizes(table: PositionTable, rows: Index) -> Index:
    """Those of some rows (from 0) whose size no bias or scale explains beside the others'.

    A slip of a factor ten bends every parameter until nothing can be judged, so it is looked for
    before anything is fitted.
    """
    size = np.linalg.norm(table.raw()[rows], axis=1)
    off = np.abs(size / np.median(size) - 1.0) > _FAR
    # Where many are off, it is not a slip of the pen.
    return rows[off] if off.sum() <= max(1, rows.size // 8) else rows[:0]


def refuse_sizes(table: PositionTable, bad: Index, rows: Index) -> None:
    """Raise UsageError for records of implausible size, with the slip that would explain each."""
    if not bad.size:
        return
    usual = float(np.median(np.linalg.norm(table.raw()[rows], axis=1)))
    row, reading = int(table.row[bad[0]]), table.raw()[bad[0]]
    raise UsageError(
        f"its |a| is {float(np.linalg.norm(reading)) / usual:.2g} times that of the others"
        + (f" (so are {bad.size - 1} more)" if bad.size > 1 else ""),
        where=f"{table.path}, row {row}",
        remedy=f"{_repair(reading, usual, row)}--exclude {row} or --auto-exclude",
    )


def refuse_units(table: PositionTable, rows: Index) -> None:
    """Raise UsageError where some rows read another size of gravity than the others, each alike:
    two units in one column."""
    if rows.size < 2:  # nothing to compare: too few positions are told as such
        return
    size = np.linalg.norm(table.raw()[rows], axis=1)
    order = np.argsort(size)
    steps = size[order][1:] / np.maximum(size[order][:-1], 1e-300)
    at = int(np.argmax(steps)) + 1
    small, large = order[:at], order[at:]
    few, many = sorted((small, large), key=len)
    ratio = float(np.median(size[few]) / np.median(size[many]))
    alike = all(np.ptp(size[part]) <= _FAR * np.median(size[part]) for part in (few, many))
    rare = len(few) <= max(_SLIPS, rows.size // 8 if not _units_of(ratio) else 0)
    if steps[at - 1] < _OTHER_UNIT or not alike or rare:
        return
    numbers = _ranges(table.row[rows[np.sort(few)]])
    raise UsageError(
        f"they read {ratio:.4g} times as much as the others{_units_of(ratio)}",
        where=f"{table.path}, rows {numbers}",
        remedy=f"write the columns x, y, z in one unit, or leave them out: --exclude {numbers}",
    )


def _ranges(row: Index) -> str:
    """ "3,17-32": ascending numbers of rows as the options take them."""
    runs = np.split(row, np.flatnonzero(np.diff(row) != 1) + 1)
    return ",".join(f"{r[0]}-{r[-1]}" if len(r) > 1 else f"{r[0]}" for r in runs)


def _units_of(ratio: float) -> str:
    """The two units that a ratio of readings stands for."""
    for few, one in ACCELERATION_UNITS.items():
        for many, other in ACCELERATION_UNITS.items():
            if abs(ratio * one / other - 1.0) < _SAME and few != many:
                return f": {few} among {many}"
    return ""


def _repair(reading: Array, usual: float, row: int) -> str:
    """Every one number that may be ten times too large or too small, or have two digits exchanged,
    the likeliest first: |a| alone does not tell two axes of about one size apart."""
    found = list[tuple[float, str]]()
    for axis, name in enumerate("xyz"):
        own = float(reading[axis])
        slips = [(0.1 * own, f"{name} may be ten times too large")]
        slips += [(10.0 * own, f"{name} may be ten times too small")]
        tens = [value for value, _ in slips]
        slips += [
            (value, f"two digits of {name} may be exchanged")
            for value in transposed(own)
            if not np.isclose(value, tens).any()
        ]
        for value, words in slips:
            changed = reading.copy()
            changed[axis] = value
            off = abs(float(np.linalg.norm(changed)) / usual - 1.0)
            if off < (_DIGITS if "digits" in words else _TENFOLD):
                found.append((off, f"{words}: --fix {row}:{name}={value:.10g}, "))
    return "or ".join(words for _, words in sorted(found)[:_REPAIRS])


def kept_rows(table: PositionTable, exclude: tuple[int, ...]) -> Index:
    """Rows (from 0) that are left; UsageError for one that does not exist."""
    last = max(table.rows, table.n)
    unknown = [r for r in exclude if not 1 <= r <= last]
    if unknown:
        raise UsageError(f"--exclude {unknown[0]}: no such row", remedy=f"rows are 1..{last}")
    return np.flatnonzero(~np.isin(table.row, exclude))


def with_train(request: LabRequest, rows: Index) -> LabSettings:
    """The settings with the training rows among those that are left, `rows` by their numbers in the
    file; UsageError when none is."""
    if not request.train:
        return request.settings
    chosen = np.flatnonzero(np.isin(rows, request.train))
    if chosen.size == 0:
        raise UsageError("--train names no row that is left")
    return replace(request.settings, train=chosen)
