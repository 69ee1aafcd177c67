"""What to record next: the candidates that are worth most to a question, whatever it asks.

A candidate is a set-up that could be recorded (a bench's position, a rest, a turn, each at a
temperature); what it tells are products of its rows in the linear model, in units of the noise and
at typical sizes. A question says what each is worth beside a plan: nats that its answer is expected
to gain (Lindley 1956), or how far it tells one explanation from another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import balance
from imucalib.core.effect import Context, Effect
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import Reference
from imucalib.posterior.candidates import slopes_within
from imucalib.posterior.odds import ROUNDS
from imucalib.units import DEG

#: Numbers of candidates that a plan has, and the worth (c,) of one more of each.
Plan = tuple[int, ...]
Worth = Callable[[Plan], Array]
#: Gains below these are rounding: of one exchange, and of a round of them.
_GAIN, _ROUND = 1e-6, 1e-3
_STEP = 15.0  # deg


def attitudes() -> Array:
    """(26, 3) faces, edges and corners: attitudes that a hand can hold."""
    grid = np.array([(x, y, z) for x in (0, 1, -1) for y in (0, 1, -1) for z in (0, 1, -1)])
    grid = grid[np.any(grid != 0, axis=1)]
    size = np.linalg.norm(grid, axis=1)
    order = np.argsort(size, kind="stable")
    return np.asarray(grid[order] / size[order, None], np.float64)


def table_positions() -> tuple[Array, Array]:
    """(c,) inclination and tool-face, rad, of a two-axis table's positions every 15 deg."""
    pairs = [
        (i, t)
        for i in np.arange(-90.0, 90.0 + 1e-9, _STEP)
        for t in (np.arange(0.0, 360.0, _STEP) if abs(i) < 89.9 else (0.0,))
    ]
    inclination, tool_face = np.array(pairs).T
    return inclination * DEG, tool_face * DEG


def products_of(
    model: Model,
    theta: Array,
    force: Array,
    reference: Reference,
    context: Context,
    sigma: float,
    rivals: Sequence[Effect] = (),
    settings: Mapping[str, float] | None = None,
) -> Array:
    """(n, P, P) products of the model's parameters and of the rivals' at rests.

    force : (n, 3) m/s²; sigma : of a reading, m/s²; settings : component -> standard deviation,
    where no two rests share one
    """
    n = len(force)
    whole = model.predict(theta, force[:, None], context).reading
    data = Observations(
        whole, np.full((n, 1, 3), sigma), reference, context, np.arange(n), ("",) * n
    )
    eta = reference.start(model.correct(theta, whole, context))
    at, truth = balance(model, theta, eta, data), reference.truth(eta)
    blocks = [at.jacobian * [p.typical for p in model.parameters(context)]]
    for effect in rivals:
        slope = slopes_within(model, theta, effect, truth, context)
        blocks.append(at.columns(slope * [p.typical for p in effect.parameters(context)]))
    every = np.column_stack(blocks)
    rows = every.reshape(n, -1, every.shape[1])
    covariance = np.broadcast_to(np.eye(rows.shape[1]), (n, *(rows.shape[1],) * 2)).copy()
    for name, matrix in zip(at.component, at.settings, strict=True):
        own = matrix.reshape(n, rows.shape[1], -1)
        covariance += (settings or {}).get(name, 0.0) ** 2 * own @ own.transpose(0, 2, 1)
    return np.asarray(rows.transpose(0, 2, 1) @ np.linalg.solve(covariance, rows))


def grow_until(worth: Worth, most: int, enough: Callable[[Plan], bool]) -> Plan:
    """The shortest plan that is enough, of so many candidates at most."""
    plan: Plan = ()
    while len(plan) < most and not enough(plan):
        plan = grow(plan, worth)
    return plan


def grow(plan: Plan, worth: Worth) -> Plan:
    """A plan with one candidate more, then each exchanged while that helps."""
    each = worth(plan)
    chosen, now = [*plan, int(np.argmax(each))], float(each.max())
    for _ in range(ROUNDS):
        before = now
        for place in range(len(chosen)):
            each = worth(tuple(chosen[:place] + chosen[place + 1 :]))
            if float(each.max()) > now + _GAIN * abs(now) + 1e-12:
                chosen[place], now = int(np.argmax(each)), float(each.max())
        if now <= before + _ROUND * abs(before):
            break
    return tuple(chosen)


def gain(known: Array, each: Array) -> Worth:
    """Nats that a plan leaves of what is known, information (p, p), by candidates (c, p, p)."""
    return lambda plan: nats(known + each[list(plan)].sum(axis=0) + each)


def nats(information: Array) -> Array:
    """(...) ½ log det of information matrices (..., p, p); -inf where one is singular."""
    sign, value = np.linalg.slogdet(information)
    return np.asarray(np.where(sign > 0, 0.5 * value, -np.inf))
