"""How good is a set of positions, which added ones help most, and which set to take instead.

Information per position is that of the calibration model itself, so the answer holds for the
reference in use: known vectors, or the norm alone. D-efficiency is det(information per reading) to
the power 1/p, relative to a uniform sphere, which is the best that any design can do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.lab.bench import number_settings
from imucalib.calibrators.lab.calibrate import MODELS
from imucalib.core.angle_conventions import Conventions
from imucalib.core.effect import Context
from imucalib.core.eigen import eigen
from imucalib.core.fit import null_directions
from imucalib.core.model import Model
from imucalib.core.references import KnownNorm, KnownVector, Reference, angles_of, unit_vector
from imucalib.core.sphere import even_directions
from imucalib.effects import named
from imucalib.posterior.closed_loop.planning import Plan, gain, products_of, table_positions
from imucalib.units import DEG, MG, STANDARD_GRAVITY


@dataclass(frozen=True)
class Addition:
    """One added position (deg) and what it does: efficiency after, and the largest gain of one
    parameter's standard deviation (factor, name)."""

    inclination: float
    tool_face: float
    efficiency: float
    gain: float
    parameter: str


@dataclass(frozen=True)
class Design:
    """Quality of a set of positions for a model.

    efficiency : 1 is a uniform sphere, 0 singular; condition : of the scaled Jacobian
    sd : (p,) standard deviation of each parameter for 1 mg of noise, in the parameter's unit
    additions : the best single position, then the best pair, each in order of adding
    """

    positions: int
    efficiency: float
    condition: float
    names: tuple[str, ...]
    units: tuple[str, ...]
    sd: Array
    open_directions: tuple[str, ...]
    additions: tuple[Addition, ...]


def _information(model: Model, inclination: Array, tool_face: Array, *, norm: bool) -> Array:
    """(n, p, p) information of each position, for 1 mg of noise and typical-size parameters."""
    n, gravity = len(inclination), STANDARD_GRAVITY
    context, ids = Context(n), np.arange(n)
    reference: Reference = KnownNorm(n, gravity)
    if not norm:
        reference = KnownVector(inclination, tool_face, gravity, ids, ids, setting_errors=False)
    force = gravity * unit_vector(inclination, tool_face)
    return products_of(model, model.start(context), force, reference, context, MG)


def judge(model: Model, inclination: Array, tool_face: Array, *, norm: bool = False) -> Design:
    """Judge positions (rad). `model` must not need known angles when `norm` is set."""
    parameters = model.parameters(Context(1))
    sphere = _information(model, *angles_of(even_directions(4000)), norm=norm).mean(axis=0)
    best = float(np.linalg.slogdet(sphere)[1])
    total = _information(model, inclination, tool_face, norm=norm).sum(axis=0)
    candidates = np.array(table_positions()) / DEG
    offered = _information(model, *table_positions(), norm=norm)
    worth = gain(total, offered)
    plan: Plan = ()
    additions, current, count = [], total, len(inclination)
    for _ in range(2):
        pick = int(np.argmax(worth(plan)))
        before, after = _sd(current), _sd(current + offered[pick])
        plan, current, count = (*plan, pick), current + offered[pick], count + 1
        with np.errstate(invalid="ignore"):
            ratio = np.nan_to_num(before / after, nan=1.0, posinf=np.inf)
        best_known = int(np.argmax(ratio))
        additions.append(
            Addition(
                inclination=float(candidates[0, pick]),
                tool_face=float(candidates[1, pick]),
                efficiency=_efficiency(current, count, best),
                gain=float(ratio[best_known]),
                parameter=parameters[best_known].name,
            )
        )
    values, vectors = eigen(total)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    typical = np.array([q.typical for q in parameters])
    return Design(
        positions=len(inclination),
        efficiency=_efficiency(total, len(inclination), best),
        condition=float(np.sqrt(values[-1] / max(values[0], 1e-300))),
        names=tuple(q.name for q in parameters),
        units=tuple(q.unit for q in parameters),
        sd=_sd(total) * typical,
        open_directions=null_directions(root / typical, parameters, 1.0),
        additions=tuple(additions),
    )


def _efficiency(information: Array, count: int, best: float) -> float:
    values = np.linalg.eigvalsh(information / count)
    if values[0] <= 1e-12 * values[-1]:
        return 0.0
    return float(np.exp((np.log(values).sum() - best) / values.size))


def _sd(information: Array) -> Array:
    """Standard deviations in typical sizes; infinite where nothing is known."""
    values, vectors = eigen(information)
    open_ = values <= 1e-12 * values[-1]
    if open_.any():
        weight = (vectors[:, open_] ** 2).sum(axis=1)
        known = (vectors[:, ~open_] ** 2 / values[~open_]).sum(axis=1)
        return np.where(weight > 1e-6, np.inf, np.sqrt(known))
    return np.sqrt(np.diag(np.linalg.pinv(information, rcond=1e-15, hermitian=True)))


def recommend(count: int) -> tuple[Array, Array]:
    """A set of `count` positions (rad) for a table with two axes: rings of equal inclination at 0,
    +45 and -45 degrees, which also expose the fixture's inclination error, plus z up and z down
    from 14 on."""
    poles = 2 if count >= 14 else 0
    ring = [len(part) for part in np.array_split(np.arange(count - poles), 3)]
    inclination = np.repeat([0.0, 45.0, -45.0], ring)
    # Each ring is turned against the last, so that few positions do not share meridians.
    tool_face = np.concatenate(
        [360.0 * (np.arange(n) + k / 3.0) / max(n, 1) for k, n in enumerate(ring)]
    )
    inclination = np.concatenate([inclination, [90.0, -90.0][:poles]])
    return inclination * DEG, np.concatenate([tool_face, np.zeros(poles)]) * DEG


@dataclass(frozen=True)
class PositionPlan:
    """A set of positions in the user's convention (deg) with its quality under both references.

    settings : how often inclination and tool-face are set anew in this order: setting errors
    average over these
    """

    inclination: Array
    tool_face: Array
    vector: Design
    norm: Design
    conventions: Conventions
    settings: tuple[int, int]


def design_of(inclination: Array, tool_face: Array, conventions: Conventions) -> PositionPlan:
    """Judge positions given in degrees in the user's convention."""
    inside = conventions.inside(inclination, tool_face)
    nine = tuple(map(named, MODELS["geometric9"]))
    return PositionPlan(
        inclination,
        tool_face,
        vector=judge(Model((named("mounting"), *nine)), *inside),
        norm=judge(Model(nine), *inside, norm=True),
        conventions=conventions,
        settings=(
            int(number_settings(inclination)[-1]) + 1,
            int(number_settings(tool_face)[-1]) + 1,
        ),
    )
