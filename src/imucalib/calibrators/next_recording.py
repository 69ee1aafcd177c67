"""The rests to record next of a sensor at rest, so that its ambiguities end.

A finished run keeps in its report what a plan needs (`recorded_block`). Candidates are attitudes of
a two-axis table's grid, or faces, edges and corners where other things are set beside them: each
temperature that can be had, hours of the day, the side from which a dial is set.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.ambiguity import KEY, ambiguity_block, ambiguity_of, read_report
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.next_rests import attitudes
from imucalib.calibration.file import check, read
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.core.effect import Context, Effect
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm, KnownVector, Reference, angles_of, unit_vector
from imucalib.core.sphere import KnownDirection
from imucalib.effects import named
from imucalib.errors import UnreadableInput, UsageError
from imucalib.loop.separation import (
    Ambiguity,
    Separation,
    columns_of,
    separable,
    separation,
)
from imucalib.units import DEG

_KINDS = {KnownVector: "vector", KnownDirection: "direction", KnownNorm: "norm"}
#: deg between attitudes, and rests after the recording at which drifts are judged.
_STEP, _LATER = 15.0, 4.0
#: °C between which a remedy may vary the temperature.
_WARM = (10.0, 40.0)
#: Covariates that follow the temperature late, and what they follow: it changes just before.
_LAGGED, _BEFORE = "temperature_", "temperature_before"
#: Columns of the table that a reader of the plan does not need: how else a direction is said.
_HIDDEN = {
    "vector": (),
    "direction": ("inclination", "tool_face"),
    "norm": ("inclination", "tool_face"),
}
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
class Wish:
    """What the user can do. temperatures : °C; between : mg, scatter of the bias from power-up to
    power-up where the rests come after another one, 0 where they are of the same"""

    temperatures: tuple[float, ...] = ()
    between: float = 0.0


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
class Part:
    """The plan of one ambiguity. header, rows : each rest, in words; remedies : what would end what
    rests cannot"""

    separation: Separation
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    remedies: tuple[str, ...]


@dataclass(frozen=True)
class NextRecording:
    """what : is recorded, "rests" or "postures"; parts : of every ambiguity, none where a name
    stands alone; table : as CSV, to be filled in, or empty; wish : what the user can do"""

    calibrator: str
    what: str
    parts: tuple[Part, ...]
    table: str
    wish: Wish

    @property
    def exit_code(self) -> int:
        """5 where an ambiguity stays."""
        return 0 if all(part.separation.enough for part in self.parts) else 5


def recorded_block(
    fit: Fit,
    ambiguities: Sequence[Ambiguity],
    *,
    reading: float,
    settings: Mapping[str, float],
    drift: float = 0.0,
) -> dict[str, Any]:
    """The block of a finished run; `recorded_of` reads it back. See `Recorded`."""
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


def recorded_of(block: Mapping[str, Any], where: str) -> Recorded:
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


def next_recording(path: Path, wish: Wish) -> NextRecording:
    """Plan from a calibration's folder, or from the calibration.yaml in it.

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
    recorded = recorded_of(report[KEY], str(folder / "report.json"))
    if wish.temperatures and "temperature" not in recorded.covariates:
        raise UsageError(
            "--temperatures: the recording has no temperature",
            where=str(folder),
            remedy="leave it out, or record the temperature and calibrate again",
        )
    plans = [_planned(recorded, calibration, one, wish) for one in recorded.ambiguities]
    shown = _Shown(calibration, recorded, report)
    return NextRecording(
        calibrator=calibration.calibrator,
        what="postures" if calibration.calibrator == "actigraph" else "rests",
        parts=tuple(shown.part(*plan) for plan in plans),
        table=shown.table([rests for _, rests, _ in plans]),
        wish=wish,
    )


def _planned(
    recorded: Recorded, calibration: Calibration, ambiguity: Ambiguity, wish: Wish
) -> tuple[Separation, Rests, tuple[str, ...]]:
    """The plan of one ambiguity, its rests, and remedies for what it cannot end."""
    rests = rests_of(recorded, ambiguity, wish.temperatures)
    pool = pool_of(recorded, calibration, ambiguity, rests)
    found = separation(*_later(ambiguity, pool, max(wish.between, recorded.drift)))
    remedies = _remedies(recorded, calibration, ambiguity, found.never)
    return found, rests.take(np.array(found.plan, np.intp)), remedies


def _later(ambiguity: Ambiguity, pool: Array, drift: float) -> tuple[Ambiguity, Array]:
    """The same for rests whose bias is off by `drift` (mg, sd) beside the recording's."""
    if drift <= 0.0:
        return ambiguity, pool
    bias = named("bias").parameters(Context(1))
    turn = np.zeros((3, len(ambiguity.columns)))
    for k, parameter in enumerate(bias):
        turn[k, ambiguity.columns.index(parameter.name)] = 1.0
    whole = np.concatenate([turn, np.eye(len(ambiguity.columns))])
    later = ambiguity.after_a_power_up(drift, [p.typical for p in bias])
    return later, np.asarray(whole @ pool @ whole.T)


def _remedies(
    recorded: Recorded,
    calibration: Calibration,
    ambiguity: Ambiguity,
    never: Sequence[tuple[str, str]],
) -> tuple[str, ...]:
    """What would tell apart the pairs that no rest of this kind does: tried, not guessed."""
    asked = np.array([pair in never for pair in ambiguity.pairs])
    if not asked.any():
        return ()
    if recorded.reference == "norm":
        known = replace(recorded, reference="direction")
        pool = pool_of(known, calibration, ambiguity, rests_of(recorded, ambiguity))
        if separable(ambiguity, pool)[asked].all():
            return (
                "rests in known directions: faces and edges of a fixture (`lab --reference "
                "direction`) or a two-axis table",
            )
    warm = rests_of(recorded, ambiguity, _WARM)
    if "temperature" in warm.levels:
        pool = pool_of(recorded, calibration, ambiguity, warm)
        if separable(ambiguity, pool)[asked].all():
            return (f"rests at temperatures as far apart as {_WARM[0]:g} and {_WARM[1]:g} degC",)
    words = dict.fromkeys(named(name).identify for pair in never for name in pair)
    return tuple(text[0].lower() + text[1:].rstrip(".") for text in words)


def rests_of(recorded: Recorded, ambiguity: Ambiguity, temperatures: Sequence[float] = ()) -> Rests:
    """All candidates for an ambiguity. temperatures : °C that can be held, the ends of those of the
    recording by default; only where an effect depends on it."""
    levels = _levels(recorded, ambiguity, tuple(temperatures))
    i, t = angles_of(attitudes()) if levels else _grid()
    combined = list(product(*levels.values()))
    each = np.repeat(np.array(combined).reshape(len(combined), len(levels)), len(i), axis=0)
    return Rests(
        np.tile(i, len(combined)),
        np.tile(t, len(combined)),
        {name: each[:, k] for k, name in enumerate(levels)},
    )


def _levels(
    recorded: Recorded, ambiguity: Ambiguity, temperatures: tuple[float, ...]
) -> dict[str, Sequence[float]]:
    """What else can be set and one of the effects depends on."""
    effects = [named(name) for name in (*ambiguity.base, *ambiguity.blocks)]
    needed = {name for effect in effects for name in effect.needs}
    levels: dict[str, Sequence[float]] = {}
    warms = any(name.startswith("temperature") for name in needed)
    if warms and "temperature" in recorded.covariates:
        levels["temperature"] = temperatures or recorded.covariates["temperature"][1:]
        if any(name.startswith(_LAGGED) for name in needed):
            levels[_BEFORE] = levels["temperature"]
    if "time_of_day" in needed and "time_of_day" in recorded.covariates:
        levels["time_of_day"] = tuple(np.arange(0.0, 2.0 * np.pi, np.pi / 2.0))
    for name in ("inclination_approach", "tool_face_approach"):
        if name in needed and name in recorded.covariates:
            levels[name] = (-1.0, 1.0)
    return levels


def _grid() -> tuple[Array, Array]:
    """(c,) inclination and tool-face, rad, of a two-axis table's grid."""
    pairs = [
        (i, t)
        for i in np.arange(-90.0, 90.0 + 1e-9, _STEP)
        for t in (np.arange(0.0, 360.0, _STEP) if abs(i) < 90.0 - 1e-9 else (0.0,))
    ]
    inclination, tool_face = np.array(pairs).T
    return inclination * DEG, tool_face * DEG


def pool_of(
    recorded: Recorded, calibration: Calibration, ambiguity: Ambiguity, rests: Rests
) -> Array:
    """What every rest would tell."""
    model = Model(tuple(named(name) for name in ambiguity.base))
    context = _context(recorded, rests)
    value = {p.name: p.value for p in calibration.parameters}
    theta = np.array([value.get(p.name, p.start) for p in model.parameters(context)])
    force = recorded.gravity * rests.direction[:, None]
    data = Observations(
        model.predict(theta, force, context).reading,
        np.full((rests.n, 1, 3), recorded.reading),
        _reference(recorded, rests),
        context,
        np.arange(rests.n),
        ("",) * rests.n,
    )
    rivals: list[Effect] = [named(name) for name in ambiguity.blocks]
    rows = columns_of(model, theta, rivals, data, recorded.settings)
    return np.asarray(rows.transpose(0, 2, 1) @ rows)


def _reference(recorded: Recorded, rests: Rests) -> Reference:
    ids, gravity = np.arange(rests.n), recorded.gravity
    if recorded.reference == "vector":
        return KnownVector(rests.inclination, rests.tool_face, gravity, ids, ids)
    if recorded.reference == "direction":
        return KnownDirection(rests.direction, gravity)
    return KnownNorm(rests.n, gravity)


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


@dataclass(frozen=True)
class _Shown:
    """Rests in words and as a table."""

    calibration: Calibration
    recorded: Recorded
    report: Mapping[str, Any]

    def part(self, found: Separation, rests: Rests, remedies: tuple[str, ...]) -> Part:
        values = self._values(rests)
        names = [name for name in values if name not in _HIDDEN[self.recorded.reference]]
        rows = ((str(k + 1), *(values[name][k] for name in names)) for k in range(rests.n))
        header = ("", *(_HEADINGS.get(name, name) for name in names))
        return Part(found, header, tuple(rows), remedies)

    def table(self, every: Sequence[Rests]) -> str:
        """All rests, with empty cells for the readings under the recording's own headings."""
        names = (self.report.get("provenance") or {}).get("mapping") or {}
        readings = [str(names.get(axis, axis)) for axis in "xyz"]
        lines = []
        for rests in every:
            values = self._values(rests)
            lines += [",".join(v[k] for v in values.values()) + ",,," for k in range(rests.n)]
            header = ",".join((*values, *readings))
        return "\n".join((header, *lines, "")) if lines else ""

    def _values(self, rests: Rests) -> dict[str, list[str]]:
        """Columns by role, in the words of the user's conventions."""
        conventions = Conventions(**(self.calibration.facts.get("conventions") or {}))
        i, t = conventions.outside(rests.inclination, rests.tool_face)
        values = {"inclination": [f"{v:.1f}" for v in i], "tool_face": [f"{v:.1f}" for v in t]}
        if self.recorded.reference != "vector":
            for k, axis in enumerate("xyz"):
                along = np.round(rests.direction[:, k], 3) + 0.0
                values[f"u{axis}"] = [f"{v:.3f}" for v in along]
        for name, level in rests.levels.items():
            hour = 12.0 / np.pi if name == "time_of_day" else 1.0
            values[name] = [f"{v:.4g}" for v in hour * level]
        return values
