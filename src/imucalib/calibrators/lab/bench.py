"""The bench as it is: position tables become observations, and what users mistake is refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.lab.headings import covariate_name, is_covariate
from imucalib.calibrators.lab.position_table import PositionTable, ranges
from imucalib.calibrators.lab.request import LabRequest
from imucalib.core.angle_conventions import Conventions
from imucalib.core.effect import Context
from imucalib.core.observations import NoisePrior, Observations, add_sessions
from imucalib.core.references import KnownNorm, KnownVector, Reference
from imucalib.core.sphere import KnownDirection
from imucalib.effects.scans import COLUMN, trust_records
from imucalib.effects.table import covariates_before
from imucalib.errors import UnreadableInput, UsageError
from imucalib.posterior.slips.cells import transpositions
from imucalib.readers.fields.conversion import temperature, zero_g
from imucalib.recording.mapping import FieldMapping
from imucalib.rests.thermal import is_power_up_code, remember_in_rows
from imucalib.units import (
    ACCELERATION_UNITS,
    DEG,
    MG,
    STANDARD_GRAVITY,
    detect_acceleration_unit,
    factor,
)

#: A reading at rest differs from the others' size by a tenth at most, through bias and scale.
_FAR = 0.35
#: Readings this many times as large have another unit; a ratio of units is met to this share.
_OTHER_UNIT, _SAME = 5.0, 0.1
#: How close to the others' size a repair brings a row: a factor ten, and digits, of which there are
#: many pairs; and how many repairs are offered.
_TENFOLD, _DIGITS, _REPAIRS = 0.1, 0.04, 3
#: Slips of the pen that a sheet may hold by themselves.
_SLIPS = 2

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


@dataclass(frozen=True)
class PreparedTable:
    """A table before anything is fitted, with temperatures in °C.

    raw : the unit of its readings; whole : all rows as observations; rows : (k,) those that take
    part, from 0; excluded : why others do not
    """

    table: PositionTable
    raw: RawUnit
    whole: Observations
    rows: Index
    excluded: tuple[str, ...]


def prepare_table(
    table: PositionTable, request: LabRequest, emptied: tuple[int, ...] = ()
) -> PreparedTable:
    """A table as observations, and which of its rows take part: those that were not excluded, whose
    size and temperature are plausible. emptied : rows, from 1, whose angles a shift has left blank

    Raises UsageError or UnreadableInput for what users mistake: a dead axis, two units, one that
    cannot be, and without `auto_exclude` a row of another size.
    """
    table = in_celsius(table)
    rows = select_rows(table, (*request.exclude, *emptied))
    _refuse_dead_axis(table, rows)
    _refuse_units(table, rows)
    raw = raw_unit(table, request.unit, request.lsb_per_g)
    bad = implausible_rows(table, rows, refuse=not request.auto_exclude)
    said = [f"row {r}: excluded as asked" for r in request.exclude]
    said += [f"row {r}: left without a value by --shift" for r in emptied]
    said += [f"row {table.row[k]}: excluded automatically ({why})" for k, why in bad.items()]
    whole = observations_of(table, raw, request)
    return PreparedTable(table, raw, whole, np.setdiff1d(rows, list(bad)), tuple(said))


def raw_unit(table: PositionTable, unit: str | None, lsb_per_g: float | None) -> RawUnit:
    """Unit of the raw columns: given, stated in the heading, or detected by the norm at rest.

    Raises UsageError for contradictory options and UnreadableInput when no unit is plausible.
    """
    norm = np.linalg.norm(table.raw(), axis=1)
    stated = {table.unit[a] for a in "xyz" if a in table.unit}
    if lsb_per_g is not None:
        if unit not in (None, "counts"):
            raise UsageError("--lsb goes with --unit counts", remedy="leave one of them out")
        sentence = f"{lsb_per_g:g} counts a g, as given"
        found = RawUnit("counts", STANDARD_GRAVITY / lsb_per_g, sentence)
    elif unit == "counts":
        raise UsageError("--unit counts needs the scale", remedy="add --lsb N")
    elif unit is not None:
        si = factor(unit, ACCELERATION_UNITS, "--unit")
        found = RawUnit(unit, si, f"unit {unit}, as given")
    elif len(stated) == 1 and (name := stated.pop()) in ACCELERATION_UNITS:
        found = RawUnit(name, ACCELERATION_UNITS[name], f"unit {name}, by the heading")
    else:
        _refuse_offset(table)
        guess = detect_acceleration_unit(norm, table.path)
        return RawUnit(guess.unit, ACCELERATION_UNITS[guess.unit], guess.sentence)
    at_rest = float(np.median(norm)) * found.si / STANDARD_GRAVITY
    if not 0.5 < at_rest < 1.5:
        _refuse_offset(table)
        raise UnreadableInput(
            f"at rest the norm would be {at_rest:.4g} g with {found.sentence}",
            where=table.path,
            remedy="check --unit and --lsb; a still accelerometer reads about 1 g",
        )
    return found


def _refuse_offset(table: PositionTable) -> None:
    away = zero_g(table.raw())
    if away is not None:
        raise away.error(table.path)


def number_settings(angle: Array) -> Index:
    """Setting ids: consecutive rows with the same dial value were not re-set in between."""
    return _count(np.diff(angle) != 0.0)


def _count(new: Flags) -> Index:
    return np.concatenate([[0], np.cumsum(new)]).astype(np.intp)


def row_numbers(data: Observations) -> Index:
    """(n,) of the rows, as the file counts them."""
    return np.array([int(label.split()[-1]) for label in data.label], np.intp)


def observations_of(table: PositionTable, raw: RawUnit, request: LabRequest) -> Observations:
    """All rows as observations, with what their sessions share; temperatures are °C
    (`in_celsius`). Raises UsageError for angles that cannot be degrees."""
    reading, gravity = table.raw() * raw.si, request.gravity
    sigma = request.sigma or MG
    exact = request.objective == "vector"
    if request.reference == "norm":
        data = _observations(table, reading, KnownNorm(table.n, gravity), sigma)
    elif request.reference == "direction":
        if request.conventions != Conventions():
            raise UsageError(
                "--reference direction has no angles that a convention could mean",
                remedy="leave the convention out: a face is the axis that reads +g",
            )
        reference = KnownDirection(_directions(table), gravity, not exact)
        data = _observations(table, reading, reference, sigma)
    else:
        data = position_observations(
            in_degrees(table),
            reading,
            request.conventions,
            gravity,
            sigma=sigma,
            setting_errors=not exact,
        )
    if request.trust:
        data = _trust(data, request.trust)
    return add_sessions(data, table.columns["session"].astype(int)) if table.sessions else data


def _trust(data: Observations, rows: tuple[int, ...]) -> Observations:
    """With some rows, as the file counts them, said to stand as they were set."""
    at = np.flatnonzero(np.isin(row_numbers(data), rows))
    if not at.size:
        raise UsageError("--trust names no row of the table")
    context = trust_records(data.context, *data.context["record"][at[[0, -1]]])
    return replace(data, context=context)


def position_observations(
    table: PositionTable,
    reading: Array,
    conventions: Conventions,
    gravity: float,
    *,
    sigma: float = MG,
    setting_errors: bool = True,
) -> Observations:
    """Observations of a bench with known angles (deg).

    reading : (n, 3) m/s²; gravity : m/s²; sigma : m/s², of a reading (relative between rows when
        the table has a column of sample counts)
    """
    dials = table.columns["inclination"], table.columns["tool_face"]
    inclination, tool_face = conventions.inside(*dials)
    i_set = _setting(table, "inclination")
    t_set = _setting(table, "tool_face")
    for row in table.upright:  # a tool-face that is none shares its setting with no other
        t_set[table.row == row] = t_set.max() + 1
    reference = KnownVector(inclination, tool_face, gravity, i_set, t_set, setting_errors)
    covariates = {
        "inclination": inclination,
        "tool_face": tool_face,
        **conventions.dials(*dials),
        "sweep": _sweeps(i_set, t_set),
    }
    return _observations(table, reading, reference, sigma, covariates)


def _observations(
    table: PositionTable,
    reading: Array,
    reference: Reference,
    sigma: float,
    covariates: Mapping[str, Array] | None = None,
) -> Observations:
    known = {**_covariates(table, reading), **(covariates or {})}
    counts = table.columns["samples"] if "samples" in table else np.ones(table.n)
    relative = sigma * np.sqrt(np.median(counts) / np.maximum(counts, 1.0))
    sweeps = int(known["sweep"].max()) + 1 if "sweep" in known else 1
    return Observations(
        reading[:, None],
        np.broadcast_to(relative[:, None, None], (table.n, 1, 3)).copy(),
        reference,
        Context(table.n, known, sweeps=sweeps),
        np.arange(table.n),
        tuple(f"row {row}" for row in table.row),
        noise_prior=NOISE,
    )


def _directions(table: PositionTable) -> Array:
    """(n, 3) unit vectors; raises UnreadableInput for one of no length."""
    direction = np.stack([table.columns[role] for role in ("ux", "uy", "uz")], axis=-1)
    size = np.linalg.norm(direction, axis=1, keepdims=True)
    if not size.all():
        raise UnreadableInput(
            "ux, uy, uz are all zero: no direction",
            where=f"{table.path}, row {table.row[int(np.argmin(size))]}",
            remedy="give the direction of the axis that reads +g, of any length",
        )
    return np.asarray(direction / size)


def _setting(table: PositionTable, dial: str) -> Index:
    if f"{dial}_setting" in table:
        stated = table.columns[f"{dial}_setting"]
        return np.unique(stated, return_inverse=True)[1].astype(np.intp)
    new = np.diff(table.columns[dial]) != 0.0
    if "session" in table:
        new |= np.diff(table.columns["session"]) != 0.0
    return _count(new)


def _covariates(table: PositionTable, reading: Array) -> dict[str, Array]:
    found = {
        "record": np.arange(table.n, dtype=float),
        "order": np.linspace(0.0, 1.0, table.n),
    }
    before = covariates_before(reading)
    for axis in "xyz":
        found |= {name: before[name] for name in (f"previous_{axis}", f"approach_{axis}")}
    dials = ("inclination_approach", "tool_face_approach")
    recorded = ("temperature", "time", "session", *dials)
    found |= {name: table.columns[name] for name in recorded if name in table}
    for role in filter(is_covariate, table.columns):
        found[COLUMN + covariate_name(table.names[role])] = table.columns[role]
    if "temperature" in table and np.ptp(table.columns["temperature"]) > 0.0:
        found |= remember_in_rows(
            table.columns["temperature"],
            table.columns["time"] if table.unit.get("time") == "s" else None,
            table.columns["session"] if "session" in table else np.zeros(table.n),
        )
    return found


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


def in_degrees(table: PositionTable) -> PositionTable:
    """Angle columns whose heading says rad, in degrees; UsageError for what cannot be degrees."""
    columns = dict(table.columns)
    for role in ("inclination", "tool_face"):
        if table.unit.get(role) == "rad":
            columns[role] = columns[role] / DEG
        worst = int(np.argmax(np.abs(columns[role])))
        if abs(columns[role][worst]) > 720.0:
            raise UsageError(
                f"angle {columns[role][worst]:g} is out of range",
                where=f"{table.path}, row {table.row[worst]}, column {table.names[role]}",
                remedy="angles are in degrees, within two turns",
            )
    return replace(table, columns=columns)


def in_celsius(table: PositionTable) -> PositionTable:
    """The temperature by the unit of its heading, with a note where it does not say it. Raises
    UsageError for one without a unit that °C cannot be."""
    if "temperature" not in table:
        return table
    values = table.columns["temperature"]
    read = temperature(FieldMapping(), table.unit.get("temperature", ""), values, table.path)
    if read.unit != "degC":
        raise UsageError(
            f"{values.min():g} to {values.max():g} is no temperature in °C, and no unit is stated",
            where=f"{table.path}, column {table.names.get('temperature', 'temperature')}",
            remedy="head it temperature_K or temperature_F, or otherwise if it is none",
        )
    return replace(
        table,
        columns={**table.columns, "temperature": read.apply(values)},
        unit={**table.unit, "temperature": "degC"},
        notes=(read.note, *table.notes) if read.note else table.notes,
    )


def select_rows(table: PositionTable, exclude: tuple[int, ...]) -> Index:
    """Rows (from 0) that remain; UsageError for one that does not exist."""
    last = max(table.rows, table.n)
    unknown = [r for r in exclude if not 1 <= r <= last]
    if unknown:
        raise UsageError(f"--exclude {unknown[0]}: no such row", remedy=f"rows are 1..{last}")
    return np.flatnonzero(~np.isin(table.row, exclude))


def implausible_rows(table: PositionTable, rows: Index, *, refuse: bool) -> dict[int, str]:
    """Those of some rows (from 0) that are wrong before anything is fitted, and what is wrong: a
    size that no bias or scale explains beside the others', a temperature that none measured.

    A slip of a factor ten bends every parameter until nothing can be judged; a thermometer's code
    hides what the temperature does, and makes another effect of it. With `refuse` raises UsageError
    for such a row, with the slip that would explain it.
    """
    size = np.linalg.norm(table.raw()[rows], axis=1)
    off = np.abs(size / np.median(size) - 1.0) > _FAR
    # Where many are off, it is not a slip of the pen.
    far = rows[off] if off.sum() <= max(1, rows.size // 8) else rows[:0]
    cold = rows[:0]
    if "temperature" in table:
        cold = rows[is_power_up_code(table.columns["temperature"][rows])]
    if refuse and far.size:
        _refuse_size(table, far, float(np.median(size)))
    if refuse and cold.size:
        row, value = int(table.row[cold[0]]), float(table.columns["temperature"][cold[0]])
        raise UsageError(
            f"{value:g} is what a thermometer says that has not measured, and far from all others"
            + _so_are(cold),
            where=f"{table.path}, row {row}, column {table.names.get('temperature')}",
            remedy=f"correct the cell, or --exclude {row} or --auto-exclude",
        )
    return dict.fromkeys(cold.tolist(), "no temperature") | dict.fromkeys(
        far.tolist(), "size of |a|"
    )


def _so_are(bad: Index) -> str:
    return f" (so are {bad.size - 1} more)" if bad.size > 1 else ""


def _refuse_dead_axis(table: PositionTable, rows: Index) -> None:
    """Raise UnreadableInput where an axis reads one value in all rows while others change."""
    reading = table.raw()[rows]
    still = np.ptp(reading, axis=0) == 0.0
    if rows.size < 3 or still.all() or not still.any():
        return
    axis = int(np.argmax(still))
    raise UnreadableInput(
        f"{'xyz'[axis]} reads {reading[0, axis]:g} in every row: the axis is dead, or this is "
        "another column",
        where=table.path,
        remedy=f"name the column of its readings: --columns {'xyz'[axis]}=HEADING",
    )


def _refuse_units(table: PositionTable, rows: Index) -> None:
    """Raise UsageError where some rows read another size of gravity than all others: two units in
    one column."""
    if rows.size < 2:  # nothing to compare
        return
    size = np.linalg.norm(table.raw()[rows], axis=1)
    order = np.argsort(size)
    steps = size[order][1:] / np.maximum(size[order][:-1], 1e-300)
    at = int(np.argmax(steps)) + 1
    few, many = sorted((order[:at], order[at:]), key=len)
    ratio = float(np.median(size[few]) / np.median(size[many]))
    uniform = all(np.ptp(size[part]) <= _FAR * np.median(size[part]) for part in (few, many))
    rare = len(few) <= max(_SLIPS, rows.size // 8 if not _units_of(ratio) else 0)
    if steps[at - 1] < _OTHER_UNIT or not uniform or rare:
        return
    numbers = ranges(table.row[rows[np.sort(few)]]).replace(" ", "")
    raise UsageError(
        f"they read {ratio:.4g} times as much as the others{_units_of(ratio)}",
        where=f"{table.path}, rows {numbers}",
        remedy=f"write the columns x, y, z in one unit, or leave them out: --exclude {numbers}",
    )


def _units_of(ratio: float) -> str:
    """The two units that a ratio of readings stands for."""
    for few, one in ACCELERATION_UNITS.items():
        for many, other in ACCELERATION_UNITS.items():
            if abs(ratio * one / other - 1.0) < _SAME and few != many:
                return f": {few} among {many}"
    return ""


def _refuse_size(table: PositionTable, bad: Index, usual: float) -> None:
    """With every one number that may be ten times too large or too small, or have two digits
    exchanged, the likeliest first: |a| alone does not tell two axes of about one size apart."""
    row, reading = int(table.row[bad[0]]), table.raw()[bad[0]]
    repairs = list[tuple[float, str]]()
    for axis, name in enumerate("xyz"):
        own = float(reading[axis])
        tens = {0.1 * own: "large", 10.0 * own: "small"}
        slips = [(v, f"{name} may be ten times too {word}", _TENFOLD) for v, word in tens.items()]
        slips += [
            (value, f"two digits of {name} may be exchanged", _DIGITS)
            for value in transpositions(own)
            if not np.isclose(value, list(tens)).any()
        ]
        for value, words, close in slips:
            changed = np.where(np.arange(3) == axis, value, reading)
            off = abs(float(np.linalg.norm(changed)) / usual - 1.0)
            if off < close:
                repairs.append((off, f"{words}: --fix {row}:{name}={value:.10g}, "))
    offered = "or ".join(words for _, words in sorted(repairs)[:_REPAIRS])
    raise UsageError(
        f"its |a| is {float(np.linalg.norm(reading)) / usual:.2g} times that of the others"
        + _so_are(bad),
        where=f"{table.path}, row {row}",
        remedy=f"{offered}--exclude {row} or --auto-exclude",
    )
