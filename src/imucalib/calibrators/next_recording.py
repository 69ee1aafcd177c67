"""The rests to record next of a sensor at rest, so that its ambiguities end.

A finished run keeps in its report what a plan needs (`describe_recorded`). Candidates are attitudes
of a two-axis table's grid, or faces, edges and corners where other things are set beside them: each
temperature that can be had, hours of the day, the side from which a dial is set.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import check, read
from imucalib.core.angle_conventions import Conventions
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.references import KnownNorm, KnownVector, Reference, angles_of, unit_vector
from imucalib.core.sphere import KnownDirection
from imucalib.data import fields
from imucalib.effects import named
from imucalib.errors import UnreadableInput, UsageError
from imucalib.posterior.closed_loop.planning import attitudes, products_of, table_positions
from imucalib.posterior.closed_loop.separation import Ambiguity, Separation, separable, separation

#: Key of its block in report.json.
KEY = "record_next"
_KINDS = {KnownVector: "vector", KnownDirection: "direction", KnownNorm: "norm"}
#: Rests after the recording at which drifts are judged.
_LATER = 4.0
#: °C between which a remedy may vary the temperature.
_WARM = (10.0, 40.0)
#: Covariates that follow the temperature late, and what they follow: it changes just before.
_LAGGED, _BEFORE = "temperature_", "temperature_before"
_APPROACHES = ("inclination_approach", "tool_face_approach")
_HEADINGS = {
    "tool_face": "tool-face",
    "temperature": "degC",
    _BEFORE: "degC before",
    "time_of_day": "hour of day",
    "ux": "gravity along x",
    "uy": "y",
    "uz": "z",
    "inclination_approach": "inclination from",
    "tool_face_approach": "tool-face from",
}


@dataclass(frozen=True)
class Recorded:
    """What a run keeps for a later plan.

    reference : "vector", "direction" or "norm"; gravity, reading : m/s², the latter the noise of
    one reading; settings : component -> rad; drift : mg, by which the bias may have moved when the
    next recording begins; rows : of the table; sweeps : as in a context
    covariates : name -> last value, smallest, largest; ambiguities : what the run could not settle
    """

    reference: str
    gravity: float
    reading: float
    settings: Mapping[str, float]
    drift: float
    rows: int
    sweeps: int
    covariates: Mapping[str, tuple[float, float, float]]
    ambiguities: tuple[Ambiguity, ...]

    def follows(self, ambiguity: Ambiguity) -> set[str]:
        """Covariates that one of its effects depends on."""
        effects = (named(name) for name in (*ambiguity.base, *ambiguity.blocks))
        return {name for effect in effects for name in effect.needs}


@dataclass(frozen=True)
class Rests:
    """Candidates. inclination, tool_face : (c,) rad, inside; levels : covariate -> (c,) what else
    is set: temperature in °C, now and before; time of day in rad; an approach as -1 or +1"""

    inclination: Array
    tool_face: Array
    levels: Mapping[str, Array]

    @property
    def n(self) -> int:
        return len(self.inclination)

    @property
    def direction(self) -> Array:
        """(c, 3) unit vectors of the specific force in the tool's frame."""
        return unit_vector(self.inclination, self.tool_face)

    def take(self, rows: Index) -> Rests:
        levels = {name: values[rows] for name, values in self.levels.items()}
        return Rests(self.inclination[rows], self.tool_face[rows], levels)


@dataclass(frozen=True)
class AmbiguityPlan:
    """The plan of one ambiguity. header, rows : each rest, in words; remedies : what would end what
    rests cannot"""

    separation: Separation
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    remedies: tuple[str, ...]


@dataclass(frozen=True)
class NextRecording:
    """what : is recorded, "rests" or "postures"; parts : of every ambiguity, none where a name
    has no rival; table : as CSV, to be filled in, or empty; between : mg, as planned for"""

    calibrator: str
    what: str
    parts: tuple[AmbiguityPlan, ...]
    table: str
    between: float

    @property
    def exit_code(self) -> int:
        """5 where an ambiguity stays."""
        return 0 if all(part.separation.enough for part in self.parts) else 5


def describe_recorded(
    fit: Fit,
    ambiguities: Sequence[Ambiguity],
    *,
    reading: float,
    settings: Mapping[str, float],
    drift: float = 0.0,
) -> dict[str, Any]:
    """The block of a finished run; `read_block` reads it back. See `Recorded`."""
    data, reference = fit.observations, fit.observations.reference
    assert isinstance(reference, KnownVector | KnownDirection | KnownNorm)
    return {
        "reference": _KINDS[type(reference)],
        "gravity_m_per_s2": reference.gravity,
        "reading_m_per_s2": reading,
        "settings_rad": dict(settings),
        "drift_mg": drift,
        "rows": data.n,
        "sweeps": data.context.sweeps,
        "covariates": {
            name: {"last": float(v[-1]), "low": float(np.min(v)), "high": float(np.max(v))}
            for name, v in data.context.covariates.items()
            if np.ndim(v) == 1
        },
        "ambiguities": [ambiguity_block(one) for one in ambiguities],
    }


def read_block(block: Mapping[str, Any], where: str) -> Recorded:
    """Read the block. Raises UnreadableInput where it is damaged."""
    try:
        return Recorded(
            reference=str(block["reference"]),
            gravity=float(block["gravity_m_per_s2"]),
            reading=float(block["reading_m_per_s2"]),
            settings={str(k): float(v) for k, v in block["settings_rad"].items()},
            drift=float(block["drift_mg"]),
            rows=int(block["rows"]),
            sweeps=int(block["sweeps"]),
            covariates={
                str(name): (float(v["last"]), float(v["low"]), float(v["high"]))
                for name, v in block["covariates"].items()
            },
            ambiguities=tuple(ambiguity_of(one) for one in block["ambiguities"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UnreadableInput(f"what a plan needs is damaged: {error!r}", where=where) from None


def next_recording(
    path: Path, temperatures: tuple[float, ...] = (), between: float = 0.0
) -> NextRecording:
    """Plan from a calibration's folder, or from the calibration.yaml in it.

    temperatures : °C that can be held; between : mg, scatter of the bias from power-up to power-up
    where the rests come after another one, 0 where they are of the same
    Raises UnreadableInput where the folder lacks the run's files, and UsageError where a wish does
    not fit the recording.
    """
    folder = path if path.is_dir() else path.parent
    file = folder / "calibration.yaml" if path.is_dir() else path
    calibration = read(file)
    check(calibration, str(file))
    if calibration.calibrator not in ("lab", "actigraph"):
        raise UsageError(
            f"no plan of rests for a calibration of `{calibration.calibrator}`",
            where=str(folder),
            remedy="its report says under What to do which motions would tell its effects apart",
        )
    report = read_report(folder)
    recorded = read_block(report[KEY], str(folder / "report.json"))
    if temperatures and "temperature" not in recorded.covariates:
        raise UsageError(
            "--temperatures: the recording has no temperature",
            where=str(folder),
            remedy="leave it out, or record the temperature and calibrate again",
        )
    parts, every = [], []
    for ambiguity in recorded.ambiguities:
        rests = rests_of(recorded, ambiguity, temperatures)
        pool = pool_of(recorded, calibration, ambiguity, rests)
        if (off := max(between, recorded.drift)) > 0.0:
            bias = {p.name: (p.typical / off) ** 2 for p in named("bias").parameters(Context(1))}
            found = separation(*ambiguity.after_a_power_up(bias, pool))
        else:
            found = separation(ambiguity, pool)
        values = _columns(recorded, calibration, rests.take(np.array(found.plan, np.intp)))
        every.append(values)
        shown = {n: v for n, v in values.items() if n not in ("inclination", "tool_face")}
        if recorded.reference == "vector":
            shown = values
        header = ("", *(_HEADINGS.get(name, name) for name in shown))
        rows = tuple((str(k), *row) for k, row in enumerate(zip(*shown.values(), strict=True), 1))
        remedies = _remedies(recorded, calibration, ambiguity, found.never)
        parts.append(AmbiguityPlan(found, header, rows, remedies))
    headings = (report.get("provenance") or {}).get("mapping") or {}
    return NextRecording(
        calibrator=calibration.calibrator,
        what="postures" if calibration.calibrator == "actigraph" else "rests",
        parts=tuple(parts),
        table=plan_table(every, [str(headings.get(axis, axis)) for axis in "xyz"]),
        between=between,
    )


def _remedies(
    recorded: Recorded,
    calibration: Calibration,
    ambiguity: Ambiguity,
    never: Sequence[tuple[str, str]],
) -> tuple[str, ...]:
    """What would tell apart the pairs that no rest of this kind does: tried, not guessed."""
    inseparable = np.array([pair in never for pair in ambiguity.pairs])
    if not inseparable.any():
        return ()

    def ends(after: Recorded, rests: Rests) -> bool:
        pool = pool_of(after, calibration, ambiguity, rests)
        return bool(separable(ambiguity, pool)[inseparable].all())

    known = replace(recorded, reference="direction")
    if recorded.reference == "norm" and ends(known, rests_of(recorded, ambiguity)):
        return (
            "rests in known directions: faces and edges of a fixture (`lab --reference "
            "direction`) or a two-axis table",
        )
    warm = rests_of(recorded, ambiguity, _WARM)
    if "temperature" in warm.levels and ends(recorded, warm):
        return (f"rests at temperatures as far apart as {_WARM[0]:g} and {_WARM[1]:g} degC",)
    words = dict.fromkeys(named(name).identify for pair in never for name in pair)
    return tuple(text[0].lower() + text[1:].rstrip(".") for text in words)


def rests_of(recorded: Recorded, ambiguity: Ambiguity, temperatures: Sequence[float] = ()) -> Rests:
    """All candidates for an ambiguity. temperatures : °C that can be held, the ends of those of the
    recording by default; only where an effect depends on it."""
    levels = _levels(recorded, recorded.follows(ambiguity), temperatures)
    i, t = angles_of(attitudes()) if levels else table_positions()
    combined = list(product(*levels.values()))
    each = np.repeat(np.array(combined).reshape(len(combined), len(levels)), len(i), axis=0)
    return Rests(
        np.tile(i, len(combined)),
        np.tile(t, len(combined)),
        {name: each[:, k] for k, name in enumerate(levels)},
    )


def _levels(
    recorded: Recorded, needed: set[str], temperatures: Sequence[float]
) -> dict[str, Sequence[float]]:
    """What else can be set and one of the effects depends on."""
    levels: dict[str, Sequence[float]] = {}
    recordable = {name for name in needed if name in recorded.covariates}
    warms = any(name.startswith("temperature") for name in needed)
    if warms and "temperature" in recorded.covariates:
        levels["temperature"] = temperatures or recorded.covariates["temperature"][1:]
        if any(name.startswith(_LAGGED) for name in needed):
            levels[_BEFORE] = levels["temperature"]
    if "time_of_day" in recordable:
        levels["time_of_day"] = tuple(np.arange(0.0, 2.0 * np.pi, np.pi / 2.0))
    return levels | {name: (-1.0, 1.0) for name in _APPROACHES if name in recordable}


def pool_of(
    recorded: Recorded, calibration: Calibration, ambiguity: Ambiguity, rests: Rests
) -> Array:
    """What every rest would tell."""
    model = Model(tuple(named(name) for name in ambiguity.base))
    context = _context(recorded, rests)
    value = {p.name: p.value for p in calibration.parameters}
    theta = np.array([value.get(p.name, p.start) for p in model.parameters(context)])
    ids = np.arange(rests.n)
    reference: Reference = KnownNorm(rests.n, recorded.gravity)
    if recorded.reference == "vector":
        angles = (rests.inclination, rests.tool_face)
        reference = KnownVector(*angles, recorded.gravity, ids, ids)
    elif recorded.reference == "direction":
        reference = KnownDirection(rests.direction, recorded.gravity)
    return products_of(
        model,
        theta,
        recorded.gravity * rests.direction,
        reference,
        context,
        recorded.reading,
        rivals=[named(name) for name in ambiguity.blocks],
        settings=recorded.settings,
    )


def _context(recorded: Recorded, rests: Rests) -> Context:
    """Covariates of rests that follow the recording; what is not set stays as it was at its end."""
    n = rests.n
    later = _LATER / max(recorded.rows - 1, 1)
    found = {name: np.full(n, last) for name, (last, _, _) in recorded.covariates.items()}
    for name in ("order", "time"):
        if name in recorded.covariates:
            last, low, high = recorded.covariates[name]
            found[name] = np.full(n, last + later * (high - low))
    found |= {"inclination": rests.inclination, "tool_face": rests.tool_face}
    held = dict(rests.levels)
    before = held.pop(_BEFORE, held.get("temperature"))
    if before is not None:
        found |= {name: before for name in recorded.covariates if name.startswith(_LAGGED)}
    return Context(n, {**found, **held}, sweeps=recorded.sweeps)


def _columns(recorded: Recorded, calibration: Calibration, rests: Rests) -> dict[str, list[str]]:
    """Rests by role, in the words of the user's conventions."""
    conventions = Conventions(**(calibration.facts.get("conventions") or {}))
    angles = conventions.outside(rests.inclination, rests.tool_face)
    shown = zip(("inclination", "tool_face"), angles, strict=True)
    values = {name: [f"{v:.1f}" for v in angle] for name, angle in shown}
    if recorded.reference != "vector":
        along = np.round(rests.direction, 3) + 0.0
        values |= {f"u{a}": [f"{v:.3f}" for v in along[:, k]] for k, a in enumerate("xyz")}
    for name, level in rests.levels.items():
        hour = 12.0 / np.pi if name == "time_of_day" else 1.0
        values[name] = [f"{v:.4g}" for v in hour * level]
    return values


def plan_table(every: Sequence[Mapping[str, Sequence[str]]], readings: Sequence[str]) -> str:
    """Rests as CSV, with empty cells for the readings under the recording's own headings.

    every : of each ambiguity, its rests' cells by role; what one does not set is empty there
    """
    names = list(dict.fromkeys(name for values in every for name in values))
    lines = [
        ",".join((*(values[name][k] if name in values else "" for name in names), "", "", ""))
        for values in every
        for k in range(len(values["inclination"]))
    ]
    return "\n".join((",".join((*names, *readings)), *lines, "")) if lines else ""


def ambiguity_block(found: Ambiguity) -> dict[str, Any]:
    """One ambiguity as plain types; `ambiguity_of` reads it back."""
    return {
        **fields(found, "effect base columns rivals"),
        "blocks": {name: [int(at[0]), int(at[-1]) + 1] for name, at in found.blocks.items()},
        **fields(found, "gram along power numbers"),
    }


def ambiguity_of(block: Mapping[str, Any]) -> Ambiguity:
    """Read what `ambiguity_block` wrote; KeyError, TypeError or ValueError where it is damaged."""
    columns = tuple(str(name) for name in block["columns"])
    size = len(columns)
    blocks = {str(n): np.arange(int(a), int(b)) for n, (a, b) in block["blocks"].items()}
    rivals = tuple(str(name) for name in block["rivals"])
    inside = all(0 <= int(at[0]) <= int(at[-1]) < size for at in blocks.values())
    if len(rivals) < 2 or not inside or not set(rivals) <= set(blocks):
        raise ValueError("rivals without columns")
    gram = np.array(block["gram"], float).reshape(size, size)
    along = np.array(block["along"], float).reshape(size)
    return Ambiguity(
        effect=str(block["effect"]),
        base=tuple(str(name) for name in block["base"]),
        columns=columns,
        rivals=rivals,
        blocks=blocks,
        gram=gram,
        along=along,
        power=float(block["power"]),
        numbers=float(block["numbers"]),
    )


def read_report(folder: Path) -> dict[str, Any]:
    """report.json of a run's folder. Raises UnreadableInput where there is none that serves."""
    path = folder / "report.json"
    if not path.is_file():
        raise UnreadableInput(
            "no report.json beside the calibration",
            where=str(folder),
            remedy="give the folder that a calibrating command wrote, with all of its files",
        )
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        calibrator = content["calibrator"]
    except (ValueError, KeyError, TypeError):
        raise UnreadableInput("no report of imucal", where=str(path)) from None
    if KEY not in content:
        raise UnreadableInput(
            "the report does not hold what a plan needs",
            where=str(path),
            remedy=f"calibrate again with this version: imucal {calibrator}, with its search",
        )
    return dict(content)
