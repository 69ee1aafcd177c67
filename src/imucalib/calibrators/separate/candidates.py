"""Every rest that could be recorded next: a grid of attitudes, at each temperature that can be had,
and from each side where a dial's play matters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.next_rests import attitudes
from imucalib.calibrators.separate.recorded import Recorded
from imucalib.core.balance import Noise
from imucalib.core.context import Context
from imucalib.core.effect import Effect
from imucalib.core.known_direction import KnownDirection
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import (
    KnownNorm,
    KnownVector,
    Reference,
    angles_of,
    unit_vector,
)
from imucalib.effects import named
from imucalib.loop.separation.ambiguities import columns_of
from imucalib.loop.separation.choice import Pool
from imucalib.loop.separation.products import Ambiguity
from imucalib.units import DEG

#: deg between attitudes, and rests after the recording at which drifts are judged.
_STEP, _LATER = 15.0, 4.0
#: Covariates that follow the temperature late, and what they follow: it changes just before.
LAGGED, BEFORE = "temperature_", "temperature_before"
#: Sides from which a dial is set: the sense of its play.
_SIDES = (-1.0, 1.0)


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


def rests_of(recorded: Recorded, ambiguity: Ambiguity, temperatures: Sequence[float] = ()) -> Rests:
    """All candidates for an ambiguity. temperatures : °C that can be held, the ends of those of the
    recording by default; only where an effect depends on it."""
    levels = _levels(recorded, ambiguity, tuple(temperatures))
    i, t = _attitudes() if not levels else _by_hand()
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
    """What else can be set and drives one of the effects."""
    effects = [named(name) for name in (*ambiguity.base, *ambiguity.blocks)]
    needed = {name for effect in effects for name in effect.needs}
    levels: dict[str, Sequence[float]] = {}
    if any(name.startswith("temperature") for name in needed):
        span = recorded.covariates.get("temperature")
        if span is not None:
            levels["temperature"] = temperatures or (span.low, span.high)
            if any(name.startswith(LAGGED) for name in needed):
                levels[BEFORE] = levels["temperature"]
    if "time_of_day" in needed and "time_of_day" in recorded.covariates:
        levels["time_of_day"] = tuple(np.arange(0.0, 2.0 * np.pi, np.pi / 2.0))
    for name in ("inclination_approach", "tool_face_approach"):
        if name in needed and name in recorded.covariates:
            levels[name] = _SIDES
    return levels


def _by_hand() -> tuple[Array, Array]:
    """(26,) faces, edges and corners: few attitudes where other things are set beside them."""
    return angles_of(attitudes())


def _attitudes() -> tuple[Array, Array]:
    """(c,) inclination and tool-face, rad, of a two-axis table's grid."""
    pairs = [
        (i, t)
        for i in np.arange(-90.0, 90.0 + 1e-9, _STEP)
        for t in (np.arange(0.0, 360.0, _STEP) if abs(i) < 90.0 - 1e-9 else (0.0,))
    ]
    inclination, tool_face = np.array(pairs).T
    return inclination * DEG, tool_face * DEG


def pool_of(
    recorded: Recorded,
    calibration: Calibration,
    ambiguity: Ambiguity,
    rests: Rests,
    reference: str = "",
) -> Pool:
    """What every rest would tell. reference : in place of the recording's own"""
    model = Model(tuple(named(name) for name in ambiguity.base))
    context = _context(recorded, rests)
    theta = _theta(calibration, model, context)
    n, kind = rests.n, reference or recorded.reference
    reading = model.predict(theta, recorded.gravity * rests.direction[:, None], context).reading
    data = Observations(
        reading,
        np.full((n, 1, 3), recorded.reading),
        _reference(kind, rests, recorded.gravity),
        context,
        np.arange(n),
        ("",) * n,
    )
    rivals: list[Effect] = [named(name) for name in ambiguity.blocks]
    noise = Noise(1.0, tuple(recorded.settings), tuple(recorded.settings.values()))
    rows = columns_of(model, theta, rivals, data, noise)
    return Pool(rows.transpose(0, 2, 1) @ rows, float(rows.shape[1]))


def _theta(calibration: Calibration, model: Model, context: Context) -> Array:
    value = {p.name: p.value for p in calibration.parameters}
    return np.array([value.get(p.name, p.start) for p in model.parameters(context)])


def _reference(kind: str, rests: Rests, gravity: float) -> Reference:
    ids = np.arange(rests.n)
    if kind == "vector":
        return KnownVector(rests.inclination, rests.tool_face, gravity, ids, ids)
    if kind == "direction":
        return KnownDirection(rests.direction, gravity)
    return KnownNorm(rests.n, gravity)


def _context(recorded: Recorded, rests: Rests) -> Context:
    """Covariates of rests that follow the recording; what is not set stays as it was at its end."""
    n = rests.n
    later = _LATER / max(recorded.rows - 1, 1)
    found = {name: np.full(n, span.last) for name, span in recorded.covariates.items()}
    for name in ("order", "time"):
        if name in recorded.covariates:
            span = recorded.covariates[name]
            found[name] = np.full(n, span.last + later * (span.high - span.low))
    found |= {"inclination": rests.inclination, "tool_face": rests.tool_face}
    held = dict(rests.levels)
    before = held.pop(BEFORE, held.get("temperature"))
    if before is not None:
        found |= {name: before for name in recorded.covariates if name.startswith(LAGGED)}
    return Context(n, {**found, **held}, sweeps=recorded.sweeps)
