"""From a file to an outcome: reading, checking what a user mistakes, calibrating, judging."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib import __version__
from imucalib.bench import (
    RawUnit,
    corrected_cells,
    position_observations,
    raw_unit,
    still_observations,
    swapped_angles,
)
from imucalib.calibrators.lab import LabResult, LabSettings, calibrate
from imucalib.calibrators.lab_advice import advice, fix_option, limits_of, reasons
from imucalib.errors import UsageError
from imucalib.observations import Observations
from imucalib.outcome import Outcome, Provenance
from imucalib.position_table import PositionTable
from imucalib.starting_point import misfit
from imucalib.units import DEG, MG, STANDARD_GRAVITY

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LabRequest:
    """Everything that the user chose about the input; `settings` is about the calibration.

    fixes : (row from 1, column role, value in the table's unit); exclude : rows from 1
    train : rows from 1 to choose and fit on; limits : name -> largest allowed value
    """

    unit: str | None = None
    lsb_per_g: float | None = None
    gravity: float = STANDARD_GRAVITY
    gravity_source: str = "standard gravity (give --gravity or --latitude for the local value)"
    reference: str = "vector"
    fixes: tuple[tuple[int, str, float], ...] = ()
    exclude: tuple[int, ...] = ()
    auto_exclude: bool = False
    swap_angles: bool = False
    keep_angles: bool = False
    train: tuple[int, ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)
    settings: LabSettings = field(default_factory=LabSettings)
    seed: int = 0


@dataclass(frozen=True)
class LabRun:
    """A finished run: the outcome that all calibrators share, and what only `lab` reports."""

    outcome: Outcome
    result: LabResult
    table: PositionTable
    raw: RawUnit
    request: LabRequest
    excluded: tuple[str, ...]


def run_lab(
    table: PositionTable,
    request: LabRequest,
    *,
    mapping: Mapping[str, object] | None = None,
    gaps: int = 0,
    notes: tuple[str, ...] = (),
) -> LabRun:
    """Calibrate a position table. Errors as in `calibrate`; UsageError for swapped angles."""
    table = corrected_cells(table, request.fixes)
    table = swapped_angles(table) if request.swap_angles else table
    raw = raw_unit(table, request.unit, request.lsb_per_g)
    whole = _observations(table, raw, request)
    if request.reference == "vector" and not request.keep_angles:
        refuse_swapped(whole, table, raw, request)
    rows = _kept(table, request.exclude)
    rng = np.random.default_rng(request.seed)
    excluded = tuple(f"row {r}: excluded as asked" for r in request.exclude)
    settings = _with_train(request, rows)
    result = calibrate(whole.take(rows), settings, rng)
    records = result.loop.records if result.loop else ()
    if records and request.auto_exclude:
        bad = {r.row for r in records}
        excluded += tuple(
            f"{r.where}: excluded automatically ({r.channel} off by {r.size:.3g} {r.unit}, {r.likely})"
            for r in records
        )
        fitted_rows = rows[result.used]
        rows = np.array([r for r in rows if r not in {fitted_rows[b] for b in bad}])
        settings = _with_train(request, rows)
        result = calibrate(whole.take(rows), settings, np.random.default_rng(request.seed))
        records = result.loop.records if result.loop else ()
    undecided = tuple(
        f"{r.where}: {r.channel} is {r.size:.3g} ± {r.sd:.2g} {r.unit} off what the others predict "
        f"({r.likely}); decide with {fix_option(r, raw)}"
        for r in records
    )
    outcome = Outcome(
        calibrator="lab",
        fit=result.final,
        loop=result.loop,
        error=result.error,
        provenance=_provenance(table, raw, request, mapping or dict(table.names), gaps),
        reasons=reasons(result, raw),
        advice=advice(result, raw),
        undecided=undecided,
        limits=limits_of(result, request.limits),
        notes=(raw.sentence, *notes),
    )
    return LabRun(outcome, result, table, raw, request, excluded)


def as_published(request: LabRequest) -> LabRequest:
    """Paper 004's own method, as found from its printed Table 2: objective (5) on rows 1-20, the
    12-parameter model, g = 9.80610 m/s², no search. No x-aligned row is among the first 20."""
    settings = replace(request.settings, model="linear12", objective="paper", loop=False)
    return replace(
        request, settings=settings, train=tuple(range(1, 21)), gravity=9.80610,
        gravity_source="as the paper used it",
    )  # fmt: skip


def _observations(table: PositionTable, raw: RawUnit, request: LabRequest) -> Observations:
    reading = table.raw() * raw.si
    sigma = request.settings.sigma or MG
    if request.reference == "norm":
        return still_observations(table, reading, request.gravity, sigma=sigma)
    table = _in_degrees(table)
    exact = request.settings.objective == "vector"
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
            row = int(np.argmax(np.abs(columns[role]))) + 1
            raise UsageError(
                f"angle {columns[role][row - 1]:g} is out of range",
                where=f"{table.path}, row {row}, column {table.names[role]}",
                remedy="angles are in degrees, within two turns",
            )
    return replace(table, columns=columns)


def refuse_swapped(
    observations: Observations, table: PositionTable, raw: RawUnit, request: LabRequest
) -> None:
    """Raise UsageError when the angle columns, exchanged or read as radians, fit far better."""
    as_given = misfit(observations)
    if as_given < 0.03 * request.gravity:
        return
    columns = dict(table.columns)
    columns["inclination"] = columns["inclination"] / DEG
    columns["tool_face"] = columns["tool_face"] / DEG
    turned = replace(table, columns=columns)
    option = "without it" if request.swap_angles else "--swap-angles"
    for other, what, remedy in (
        (swapped_angles(table), "exchanged", f"run again {option}, or name them with --columns"),
        (
            turned,
            "read as radians",
            "convert them, or name the columns with the unit (inclination_rad)",
        ),
    ):
        if np.abs(other.columns["inclination"]).max() > 720.0:
            continue
        changed = misfit(_observations(other, raw, request))
        if changed < as_given / 3.0:
            raise UsageError(
                f"the angle columns fit far better {what}: {changed / MG:.0f} instead of "
                f"{as_given / MG:.0f} mg rms",
                where=table.path,
                remedy=f"{remedy}; --keep-angles to insist",
            )


def _kept(table: PositionTable, exclude: tuple[int, ...]) -> NDArray[np.intp]:
    unknown = [r for r in exclude if not 1 <= r <= table.n]
    if unknown:
        raise UsageError(f"--exclude {unknown[0]}: no such row", remedy=f"rows are 1..{table.n}")
    return np.array([k for k in range(table.n) if k + 1 not in exclude], dtype=np.intp)


def _with_train(request: LabRequest, rows: NDArray[np.intp]) -> LabSettings:
    if not request.train:
        return request.settings
    chosen = np.flatnonzero(np.isin(rows + 1, request.train))
    if chosen.size == 0:
        raise UsageError("--train names no row that is left")
    return replace(request.settings, train=chosen)


def _provenance(
    table: PositionTable,
    raw: RawUnit,
    request: LabRequest,
    mapping: Mapping[str, object],
    gaps: int,
) -> Provenance:
    import scipy

    settings = request.settings
    shown: dict[str, object] = {
        "reference": request.reference,
        "model": settings.model,
        "objective": settings.objective,
        "declare": list(settings.declare),
        "loop": settings.loop,
        "unit": raw.name,
        "gravity_m_per_s2": request.gravity,
        "gravity_source": request.gravity_source,
        "conventions": asdict(request.settings.conventions),
        "fix": [f"{row}:{role}={value!r}" for row, role, value in request.fixes],
        "exclude": list(request.exclude),
        "auto_exclude": request.auto_exclude,
        "train": list(request.train),
        "swap_angles": request.swap_angles,
        "alpha": settings.rules.alpha,
        "draws": settings.rules.draws,
    }
    versions = {
        "imucalib": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    path = Path(table.path).name
    return Provenance(
        path, table.sha256, table.n, gaps, mapping, shown, request.seed, versions, now
    )
