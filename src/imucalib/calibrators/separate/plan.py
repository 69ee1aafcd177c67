"""From a finished run of a sensor at rest to the rests that would end its ambiguities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.calibrators.separate.candidates import Rests, pool_of, rests_of
from imucalib.calibrators.separate.recorded import Recorded
from imucalib.core.context import Context
from imucalib.effects import named
from imucalib.loop.separation.angle import pairs_of
from imucalib.loop.separation.choice import Pool
from imucalib.loop.separation.plan import Separation, can_be_told, separation
from imucalib.loop.separation.products import Ambiguity

#: °C between which a remedy may vary the temperature.
_WARM = (10.0, 40.0)


@dataclass(frozen=True)
class Planned:
    """One ambiguity. rests : to record, in the order of choosing; remedies : what would end what
    they cannot, in words"""

    separation: Separation
    rests: Rests
    remedies: tuple[str, ...] = ()


@dataclass(frozen=True)
class Wish:
    """What the user can do. temperatures : °C; between : mg, scatter of the bias from power-up to
    power-up where the rests come after another one, 0 where they are of the same"""

    temperatures: tuple[float, ...] = ()
    between: float = 0.0
    seed: int = 0


def planned(recorded: Recorded, calibration: Calibration, wish: Wish) -> tuple[Planned, ...]:
    """The plan of every ambiguity of a run; empty where nothing is ambiguous."""
    rng = np.random.default_rng(wish.seed)
    return tuple(_planned(recorded, calibration, one, wish, rng) for one in recorded.ambiguities)


def _planned(
    recorded: Recorded,
    calibration: Calibration,
    ambiguity: Ambiguity,
    wish: Wish,
    rng: np.random.Generator,
) -> Planned:
    rests = rests_of(recorded, ambiguity, wish.temperatures)
    pool = pool_of(recorded, calibration, ambiguity, rests)
    grown, seen = ambiguity, pool
    if (between := max(wish.between, recorded.wander)) > 0.0:
        grown, seen = after_a_power_up(ambiguity, pool, between)
    found = separation(grown, seen, rng)
    remedies = _remedies(recorded, calibration, ambiguity, found.never)
    return Planned(found, rests.take(np.array(found.plan, np.intp)), remedies)


def after_a_power_up(ambiguity: Ambiguity, pool: Pool, between: float) -> tuple[Ambiguity, Pool]:
    """The same for rests whose bias is off by `between` (mg, sd) beside the recording's."""
    size = {p.name: p.typical for p in named("bias").parameters(Context(1))}
    turn = np.zeros((3, len(ambiguity.columns)))
    for k, (name, typical) in enumerate(size.items()):
        turn[k, ambiguity.columns.index(name)] = 1.0 / typical
    whole = np.concatenate([turn, np.eye(len(ambiguity.columns))])
    gram = whole @ pool.gram @ whole.T
    return ambiguity.after_a_power_up(between**-2.0), replace(pool, gram=gram)


def _remedies(
    recorded: Recorded,
    calibration: Calibration,
    ambiguity: Ambiguity,
    never: Sequence[tuple[str, str]],
) -> tuple[str, ...]:
    """What would tell apart the pairs that no rest of this kind does: tried, not guessed."""
    if not never:
        return ()
    rests = rests_of(recorded, ambiguity)
    pairs = [p for p in pairs_of(ambiguity) if (p.truth, p.other) in never]
    if recorded.reference == "norm":
        pool = pool_of(recorded, calibration, ambiguity, rests, reference="direction")
        if all(can_be_told(ambiguity, pool, pair) for pair in pairs):
            return (
                "rests in known directions: faces and edges of a fixture (`lab --reference "
                "direction`) or a two-axis table",
            )
    if "temperature" in recorded.covariates:
        warm = rests_of(recorded, ambiguity, _WARM)
        pool = pool_of(recorded, calibration, ambiguity, warm)
        if warm.levels and all(can_be_told(ambiguity, pool, pair) for pair in pairs):
            return (f"rests at temperatures as far apart as {_WARM[0]:g} and {_WARM[1]:g} degC",)
    words = dict.fromkeys(named(name).identify for pair in never for name in pair)
    return tuple(text[0].lower() + text[1:].rstrip(".") for text in words)
