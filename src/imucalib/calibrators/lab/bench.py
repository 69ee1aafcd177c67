"""The bench as it is: position tables and still segments become observations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.headings import driver_name, is_driver
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.core.effect import Context
from imucalib.core.observations import NoisePrior, Observations
from imucalib.core.references import KnownNorm, KnownVector
from imucalib.core.sphere import KnownDirection
from imucalib.effects.scans import COLUMN
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.conversion import zero_g
from imucalib.rests.thermal import remembered_in_rows
from imucalib.units import (
    ACCELERATION_UNITS,
    DEG,
    MG,
    STANDARD_GRAVITY,
    detect_acceleration_unit,
    factor,
)

#: m/s² by which a reading moves, from which on its axis comes from a side.
_MOVED = 0.02 * STANDARD_GRAVITY

#: A reading's noise lies within a factor of five of a mg, or of what is declared (converters of
#: 1024 LSB/g, means of MEMS and quartz sensors at rest); half of all hands set an angle to 0.3 deg
#: (0.16-0.4 deg on the table of paper 004).
#: Zero-g levels of sensors with their electronics, sensitivities and axes before any calibration
#: lie within 0.3 g, a tenth and 2 % (data sheets of MEMS triads, one standard deviation or more).
NOISE = NoisePrior(
    spread=float(np.log(5.0)),
    setting=0.3 * DEG,
    parameters={
        **{f"bias_{a}": 300.0 for a in "xyz"},
        **{f"scale_{a}": 0.1 for a in "xyz"},
        **{f"cross_{pair}": 0.02 for pair in ("yx", "zx", "zy")},
    },
)


@dataclass(frozen=True)
class RawUnit:
    """The unit of a table's readings: SI per unit, its name, and how it became known."""

    name: str
    si: float
    sentence: str


def raw_unit(table: PositionTable, unit: str | None, lsb_per_g: float | None) -> RawUnit:
    """Unit of the raw columns: given, stated in the heading, or detected by the norm at rest.

    Raises UsageError for contradictory options and UnreadableInput when no unit is plausible.
    """
    stated = {table.unit[a] for a in "xyz" if a in table.unit}
    if lsb_per_g is not None:
        if unit not in (None, "counts"):
            raise UsageError("--lsb goes with --unit counts", remedy="leave one of them out")
        si = STANDARD_GRAVITY / lsb_per_g
        return _plausible(table, RawUnit("counts", si, f"{lsb_per_g:g} counts a g, as given"))
    if unit == "counts":
        raise UsageError("--unit counts needs the scale", remedy="add --lsb N")
    if unit is not None:
        si = factor(unit, ACCELERATION_UNITS, "--unit")
        return _plausible(table, RawUnit(unit, si, f"unit {unit}, as given"))
    if len(stated) == 1 and (name := stated.pop()) in ACCELERATION_UNITS:
        return _plausible(
            table, RawUnit(name, ACCELERATION_UNITS[name], f"unit {name}, by the heading")
        )
    _refuse_offset(table)
    found = detect_acceleration_unit(np.linalg.norm(table.raw(), axis=1), table.path)
    return RawUnit(found.unit, ACCELERATION_UNITS[found.unit], found.sentence)


def _plausible(table: PositionTable, unit: RawUnit) -> RawUnit:
    norm = float(np.median(np.linalg.norm(table.raw(), axis=1))) * unit.si / STANDARD_GRAVITY
    if not 0.5 < norm < 1.5:
        _refuse_offset(table)
        raise UnreadableInput(
            f"at rest the norm would be {norm:.4g} g with {unit.sentence}",
            where=table.path,
            remedy="check --unit and --lsb; a still accelerometer reads about 1 g",
        )
    return unit


def _refuse_offset(table: PositionTable) -> None:
    away = zero_g(table.raw())
    if away is not None:
        raise UnreadableInput(away.sentence, where=table.path, remedy=f"add {away.option}")


def corrected_cells(
    table: PositionTable, fixes: tuple[tuple[int, str, float], ...]
) -> PositionTable:
    """The table with single cells replaced, as the user asked; rows count from 1."""
    columns = {role: values.copy() for role, values in table.columns.items()}
    for row, role, value in fixes:
        if role not in columns or row not in table.row:
            raise UsageError(
                f"--fix {row}:{role}: no such cell",
                remedy=f"rows are 1..{max(table.rows, table.n)}, columns {', '.join(columns)}",
            )
        columns[role][table.at(row)] = value
    return replace(table, columns=columns)


def swapped_angles(table: PositionTable) -> PositionTable:
    """The table with its two angle columns exchanged."""
    columns = dict(table.columns)
    columns["inclination"], columns["tool_face"] = columns["tool_face"], columns["inclination"]
    return replace(table, columns=columns)


def held_settings(angle: Array) -> Index:
    """Setting ids: consecutive rows with the same dial value were not re-set in between."""
    return _runs(np.diff(angle) != 0.0)


def _runs(new: NDArray[np.bool_]) -> Index:
    return np.concatenate([[0], np.cumsum(new)]).astype(np.intp)


def row_numbers(data: Observations) -> Index:
    """(n,) of the rows, as the file counts them."""
    return np.array([int(label.split()[-1]) for label in data.label], np.intp)


def position_observations(
    table: PositionTable,
    reading: Array,
    conventions: Conventions,
    gravity: float,
    *,
    sigma: float = MG,
    setting_errors: bool = True,
) -> Observations:
    """Observations of a bench with known angles.

    reading : (n, 3) m/s²; gravity : m/s²; sigma : m/s², of a reading (relative between rows when
        the table has a column of sample counts)
    """
    i_table, t_table = table.columns["inclination"], table.columns["tool_face"]
    inclination, tool_face = conventions.inside(i_table, t_table)
    i_set = _setting(table, "inclination_setting", i_table)
    t_set = _setting(table, "tool_face_setting", t_table)
    for row in table.upright:  # a tool-face that is none shares its setting with no other
        t_set[table.row == row] = t_set.max() + 1
    reference = KnownVector(inclination, tool_face, gravity, i_set, t_set, setting_errors)
    covariates = _covariates(table, reading) | {"inclination": inclination, "tool_face": tool_face}
    covariates |= conventions.dials(i_table, t_table)
    sweep = _sweeps(i_set, t_set)
    covariates["sweep"] = sweep
    context = Context(table.n, covariates, sweeps=int(sweep.max()) + 1)
    label = tuple(f"row {row}" for row in table.row)
    return Observations(
        reading[:, None],
        _sigmas(table, sigma),
        reference,
        context,
        np.arange(table.n),
        label,
        noise_prior=NOISE,
    )


def direction_observations(
    table: PositionTable,
    reading: Array,
    gravity: float,
    *,
    sigma: float = MG,
    tilts: bool = True,
) -> Observations:
    """Observations of a fixture whose directions are known up to a small tilt of each row."""
    direction = np.stack([table.columns[role] for role in ("ux", "uy", "uz")], axis=-1)
    size = np.linalg.norm(direction, axis=1, keepdims=True)
    if not size.all():
        raise UnreadableInput(
            "ux, uy, uz are all zero: no direction",
            where=f"{table.path}, row {table.row[int(np.argmin(size))]}",
            remedy="give the direction of the axis that reads +g, of any length",
        )
    direction = direction / size
    context = Context(table.n, _covariates(table, reading))
    label = tuple(f"row {row}" for row in table.row)
    reference = KnownDirection(direction, gravity, tilts)
    return Observations(
        reading[:, None],
        _sigmas(table, sigma),
        reference,
        context,
        np.arange(table.n),
        label,
        noise_prior=NOISE,
    )


def still_observations(
    table: PositionTable, reading: Array, gravity: float, *, sigma: float = MG
) -> Observations:
    """Observations at rest in unknown attitudes: only the size of gravity is known."""
    context = Context(table.n, _covariates(table, reading))
    label = tuple(f"row {row}" for row in table.row)
    reference = KnownNorm(table.n, gravity)
    return Observations(
        reading[:, None],
        _sigmas(table, sigma),
        reference,
        context,
        np.arange(table.n),
        label,
        noise_prior=NOISE,
    )


def _setting(table: PositionTable, role: str, angle: Array) -> Index:
    if role in table:
        return np.unique(table.columns[role], return_inverse=True)[1].astype(np.intp)
    if "session" not in table:
        return held_settings(angle)
    return _runs((np.diff(angle) != 0.0) | (np.diff(table.columns["session"]) != 0.0))


def _sigmas(table: PositionTable, sigma: float) -> Array:
    counts = table.columns["samples"] if "samples" in table else np.ones(table.n)
    relative = np.sqrt(np.median(counts) / np.maximum(counts, 1.0))
    return np.broadcast_to((sigma * relative)[:, None, None], (table.n, 1, 3)).copy()


def _covariates(table: PositionTable, reading: Array) -> dict[str, Array]:
    found: dict[str, Array] = {
        "record": np.arange(table.n, dtype=float),
        "order": np.linspace(0.0, 1.0, table.n),
    }
    for axis, letter in enumerate("xyz"):
        before = np.concatenate([reading[:1, axis], reading[:-1, axis]])
        moved = reading[:, axis] - before
        found[f"previous_{letter}"] = before
        found[f"approach_{letter}"] = np.sign(moved) * (np.abs(moved) > _MOVED)
    optional: Mapping[str, str] = {
        "temperature": "temperature",
        "time": "time",
        "session": "session",
        "inclination_approach": "inclination_approach",
        "tool_face_approach": "tool_face_approach",
    }
    found |= {name: table.columns[role] for name, role in optional.items() if role in table}
    for role in filter(is_driver, table.columns):
        found[COLUMN + driver_name(table.names[role])] = table.columns[role]
    return found | _past_temperatures(table)


def _past_temperatures(table: PositionTable) -> dict[str, Array]:
    """What a sensor that trails its thermometer has: by the table's clock, else by its rows."""
    if "temperature" not in table or np.ptp(table.columns["temperature"]) <= 0.0:
        return {}
    return remembered_in_rows(
        table.columns["temperature"],
        table.columns["time"] if table.unit.get("time") == "s" else None,
        table.columns["session"] if "session" in table else np.zeros(table.n),
    )


def _sweeps(i_set: Index, t_set: Index) -> Array:
    """Number of the sweep of each row: a run of rows that hold one of the two axes.

    All zero when the rows do not come in sweeps of four or more on average.
    """
    sweep, start = np.zeros(len(i_set)), 0
    held = (True, True)
    for k in range(1, len(i_set)):
        held = (held[0] and i_set[k] == i_set[start], held[1] and t_set[k] == t_set[start])
        if not any(held):
            start, held = k, (True, True)
        sweep[k] = sweep[k - 1] + (start == k)
    return sweep if sweep.max(initial=0.0) + 1 <= len(i_set) / 4 else np.zeros(len(i_set))
