"""Accelerometer and gyroscope of one IMU from rests and the turns between them, jointly.

    f = L (a - b_a - Σ_j θ_j c_j),    ω = K (w - b(t) - Σ_j θ_j h_j(t)),    u_{k+1} = R_k' u_k

a : readings in g, L lower triangular: the frame is the accelerometer's, x along its x axis, y in
its x-y plane; w : rates as read; c_j, h_j : what else accelerometer (at rest) and gyroscope do;
b : the latter's bias, a walk linked at the rests, linear between them; u_k : gravity's direction at
rest k, R_k : the rotation of the turn after it (`carried`). Of several logs b_a is the mean over
power-ups and a part of each one's own, whose scatter is estimated; b begins anew.

At a rest f_k = u_k + noise and w_k = b_k + Σ θ_j h_j; a turn is two numbers in the plane across
u_{k+1}. One Gauss-Newton over all, as Skog and Händel (2006) for the norm and Tedaldi, Pretto and
Menegatti (ICRA 2014) for the turns have it apart, with the covariance of integrated noise:

    V = σ² T + q² T³ / 12 + s² + (κ path)²

σ : white noise, q : the walk between two rests that are known, s : a floor, κ : errors that grow
with the angle turned, both estimated. Errors of turns, and of the forces at rests, are Student's
with 4 degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from imucalib.arrays import Array, Flags, Index
from imucalib.core.effect import cross_matrix
from imucalib.estimators.carried import attitudes, between, shares
from imucalib.estimators.chain import chain_of, eliminate, turns_of
from imucalib.estimators.power_ups import Parts
from imucalib.estimators.turn_log import Turn, TurnLog, remove_bias

#: Places of L's free elements, rows first, and their number with the accelerometer's bias.
LOWER = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))
ACCELEROMETER, GAIN = 9, 9
#: Errors of a turn per angle turned, κ, that are weighed, and their half-Cauchy prior (Gelman 2006)
#: of scale 3e-4, what held-out turns of three measured chips refuse to be without.
ANGLES = 1e-4 * np.array([0.0, *0.5 * 3.0 ** np.arange(6)])
_EDGES = np.r_[0.0, 0.5e-4 * 3.0 ** (np.arange(6) - 0.5), np.inf]
ANGLE_PRIOR = np.diff(np.arctan(_EDGES / 3e-4)) * 2.0 / np.pi
_NU = 4.0  # degrees of freedom of the errors of a turn, and of a rest
#: Known before any reading (data sheets): accelerometer's bias (g), scale and cross terms, gains.
_BIAS, _SCALE, _CROSS, _GAIN = 0.3, 0.1, 0.02, 0.1
#: g, of the reading of a rest that takes no part.
_NOTHING = 1.0
#: By how much a bias is another at the next power-up: rad/s (data sheets: 0.05 to 0.3 deg/s) and g;
#: the latter's size is estimated, of those that are weighed, and begins free.
_AWAKE, _FREE, _SCATTERS = np.radians(0.2), 0.02, np.geomspace(1e-5, 0.3, 48)
_MOST, _SETTLED = 30, 1e-2  # steps, and standard deviations that the last one may go
#: Steps in which the noise is that of careful hands, so that one rest that is off does not pass for
#: the noise of all, and those up to which it is estimated anew.
_CAREFUL, _NOISES = 4, 10
_AT_ONCE = 2048  # samples of which all columns are held at once
#: rad, floors of a turn that are weighed.
_FLOORS = np.radians([0.0, *0.005 * 2.0 ** np.arange(11)])
_NORMAL = 0.455  # median of the square of a normal number


@dataclass(frozen=True)
class Laws:
    """What else the sensors do, per unit of each of m parameters.

    rate : (rate (n, 3) rad/s in the gyroscope's axes, force (n, 3) g, time (n,) s) to (n, 3, m)
        rad/s; force : gravity's directions (N, 3) at the rests to (N, 3, m) g, or None of nothing
    """

    rate: Callable[[Array, Array, Array], Array]
    force: Callable[[Array], Array] | None = None


@dataclass(frozen=True)
class State:
    """bias : (3,) g, lower : (3, 3), of the accelerometer; gain : (3, 3) K; theta : (m,)
    offset : (L, 3) g, what each power-up adds to the bias, (0, 3) where there is one alone
    drift : (N, 3) rad/s, the gyroscope's bias at every rest; up : (N, 3) u"""

    bias: Array
    lower: Array
    gain: Array
    theta: Array
    offset: Array
    drift: Array
    up: Array

    def bias_at(self, session: Index | int) -> Array:
        """(..., 3) g, of power-ups."""
        return self.bias + self.offset[session] if self.offset.size else self.bias

    def force(self, reading: Array, session: Index | int) -> Array:
        """(..., 3) g."""
        return np.asarray((reading - self.bias_at(session)) @ self.lower.T)

    @property
    def first_offset(self) -> int:
        """Column at which the parts of power-ups begin; before it are accelerometer, K and θ."""
        return ACCELEROMETER + GAIN + self.theta.size

    @property
    def first_drift(self) -> int:
        return self.first_offset + self.offset.size

    @property
    def first_up(self) -> int:
        return self.first_drift + self.drift.size


@dataclass(frozen=True)
class TurnNoise:
    """floor : rad, s; per_angle : κ; walk : (3,) rad/s/√s, q; force : g, of a rest's mean reading
    beside what its samples say; power_up : g, by which power-ups scatter"""

    floor: float
    per_angle: float
    walk: Array
    force: float
    power_up: float = _FREE


@dataclass(frozen=True)
class LinearisedTurns:
    """The linearised problem: residual (R,) + jacobian (R, P), sparse, times dx, two rows a turn,
    then the rests' forces (3), rates (3), the walk's steps (3), and what is known before."""

    residual: Array
    jacobian: sparse.csr_array
    turns: int


@dataclass(frozen=True)
class TurnFit:
    """A settled fit. covariance : (P, P) in the order accelerometer (bias, `LOWER`), K rows first,
    θ, power-ups, biases, directions; variance : (R,) of every row; used : (T,) turns that took
    part; weight : (T,) Student's, rest_weight : (N,) of what the rests' forces are"""

    log: TurnLog
    state: State
    noise: TurnNoise
    rows: LinearisedTurns
    covariance: Array
    variance: Array
    used: Flags
    weight: Array
    rest_weight: Array
    laws: Laws | None
    converged: bool

    @cached_property
    def gains(self) -> Array:
        """(9 + m, 9 + m) covariance of K and θ."""
        own = np.arange(ACCELEROMETER, ACCELEROMETER + GAIN + self.state.theta.size)
        return np.asarray(self.covariance[np.ix_(own, own)])


def fit_turns(
    log: TurnLog,
    laws: Laws | None = None,
    *,
    sizes: Array | None = None,
    used: Flags | None = None,
    start: State | None = None,
    noise: TurnNoise | None = None,
) -> TurnFit:
    """The joint fit.

    laws : of parameters θ with a normal prior of sd `sizes` (m,); used : (T,) turns that take
    part; start : where to begin; noise : held at these values, or None to estimate it
    """
    chosen = np.ones(len(log.turns), bool) if used is None else used
    prior = np.zeros(0) if sizes is None else sizes
    if start is None:  # plain readings: the norm's own fit is a few Gauss-Newton steps away
        up = log.force / np.linalg.norm(log.force, axis=1)[:, None]
        start = State(
            bias=np.zeros(3),
            lower=np.eye(3),
            gain=np.eye(3),
            theta=np.zeros(prior.size),
            offset=np.zeros((log.sessions, 3)),
            drift=log.rate.copy(),
            up=up,
        )
    elif start.theta.size != prior.size:
        start = replace(start, theta=np.zeros(prior.size))
    fit = TurnFit(
        log=log,
        state=start,
        noise=noise or TurnNoise(_FLOORS[1], 0.0, _walk(log, start, laws), _FLOORS[1]),
        rows=linearise(log, start, laws, prior),
        covariance=np.zeros((0, 0)),
        variance=np.zeros(0),
        used=chosen,
        weight=np.ones(len(log.turns)),
        rest_weight=np.ones(log.rests),
        laws=laws,
        converged=False,
    )
    for k in range(_MOST):
        careful = noise is None and k < _CAREFUL
        fit, step = _round(fit, prior, held=noise is not None or careful or k >= _NOISES)
        state = _move(fit.state, step)
        fit = replace(fit, state=state, rows=linearise(log, state, laws, prior))
        away = np.max(np.abs(step) / np.sqrt(np.diag(fit.covariance)))
        if not careful and away < _SETTLED:
            return replace(fit, converged=True)
    return fit


def leave_out(
    fit: TurnFit, out: Flags, rests: Flags | None = None, sizes: Array | None = None
) -> TurnFit:
    """The fit without some turns, and without what the accelerometer reads at some rests, linear
    about where it stands and at its noise: what a refit there would end at, to the second order in
    what these move.

    out : (T,); rests : (N,), or None of none; sizes : (m,) sd of θ, or as it was
    """
    rows, m = fit.rows, fit.state.theta.size
    if rests is not None:
        fit = replace(fit, log=fit.log.without(rests))
    last = len(fit.variance) - fit.state.offset.size
    prior = np.sqrt(fit.variance[last - m : last]) if sizes is None else sizes
    found, whole = replace(fit, used=fit.used & ~out), np.zeros(rows.jacobian.shape[1])
    for _ in range(_NOISES - _CAREFUL):
        moved = replace(rows, residual=rows.residual + rows.jacobian @ whole)
        found, step = _round(replace(found, rows=moved), prior, held=True)
        whole = whole + step
    return replace(found, rows=rows, state=_move(fit.state, whole))


def _round(fit: TurnFit, prior: Array, *, held: bool) -> tuple[TurnFit, Array]:
    """The fit with its noise, unless that is held, its rows' variances and its turns' weights as
    its rows and the covariance before tell them, and the step from there; prior : (m,) sd of θ"""
    # What a turn is off, squared, over its two numbers, and a rest over its three: that of its
    # residual, and what the unknowns may still move it (the E step of Dempster, Laird and Rubin
    # 1977). Directions of rests follow a turn, so that residuals alone are too small.
    rows, noise, turns = fit.rows, fit.noise, 2 * fit.rows.turns
    own = turns + 3 * fit.log.rests
    square = rows.residual[:own] ** 2
    if fit.covariance.size:
        jacobian = rows.jacobian[:own]
        square = square + jacobian.multiply(jacobian @ fit.covariance).sum(axis=1)
    if not held:
        noise = _estimate_noise(fit, prior)
    variance = variances(fit.log, noise, prior)
    square = square / variance[:own]
    weight = _student(square[:turns].reshape(-1, 2))
    rest_weight = _student(square[turns:].reshape(-1, 3))
    inverse = 1.0 / variance
    inverse[:turns] *= np.repeat(np.where(fit.used, weight, 0.0), 2)
    inverse[turns:own] *= np.repeat(rest_weight, 3)
    weighed = rows.jacobian.multiply(inverse[:, None]).tocsr()
    normal = (rows.jacobian.T @ weighed).toarray()
    scale = 1.0 / np.sqrt(np.diag(normal))
    covariance = np.linalg.inv(normal * scale[:, None] * scale) * scale[:, None] * scale
    found = replace(
        fit,
        noise=noise,
        covariance=covariance,
        variance=variance,
        weight=weight,
        rest_weight=rest_weight,
    )
    return found, -covariance @ (weighed.T @ rows.residual)


def _student(square: Array) -> Array:
    """(n,) weights of what is off by squares (n, k) in units of its variance."""
    return np.asarray((_NU + square.shape[1]) / (_NU + square.sum(axis=1)))


def tangents(up: Array) -> Array:
    """(N, 3, 2) two unit vectors across each of directions (N, 3), by Householder's reflection."""
    sign = np.where(up[:, 2] < 0.0, -1.0, 1.0)
    v = up + sign[:, None] * np.array([0.0, 0.0, 1.0])
    reflected = (
        np.eye(3) - 2.0 * v[:, :, None] * v[:, None, :] / np.sum(v * v, axis=1)[:, None, None]
    )
    return np.asarray(reflected[:, :, :2])


def exposure(
    state: State, rate: Array, force: Array, turn: Turn, laws: Laws | None
) -> tuple[Array, Array]:
    """What the gyroscope's axes are exposed to, (n, 3) rad/s, of rates (n, 3) without their bias,
    and the laws' columns (n, 3, m) there: the reading less what the laws add, settled in three
    rounds since they are small."""
    if laws is None or not state.theta.size:
        return rate, np.zeros((*rate.shape, 0))

    def at(true: Array) -> Array:
        return turn.moving[:, None, None] * laws.rate(true, force, turn.t)

    columns = at(rate)
    for _ in range(3 if state.theta.any() else 0):
        columns = at(rate - columns @ state.theta)
    return rate - columns @ state.theta, columns


def linearise(log: TurnLog, state: State, laws: Laws | None, prior: Array) -> LinearisedTurns:
    """All rows at a state; prior : (m,) sd of θ."""
    n, across = log.rests, tangents(state.up)
    first, apart, ups = ACCELEROMETER + GAIN, state.first_offset, state.first_up
    walk, size = state.first_drift, ups + 2 * n
    turns = np.zeros((len(log.turns), 2, size))
    misfit = np.zeros((len(log.turns), 2))
    for i, turn in enumerate(log.turns):
        k = turn.rest
        seen, share = remove_bias(log, state.drift, turn)
        force = state.force(turn.force, log.session[k])
        rate = exposure(state, seen, force, turn, laws)[0] if state.theta.any() else seen
        whole = attitudes(turn.t, rate @ state.gain.T)
        weighted = whole * shares(turn.t)[:, None, None]
        gained = weighted @ state.gain
        q = np.zeros((3, apart + 6))
        q[:, ACCELEROMETER:first] = np.tensordot(weighted, rate, (0, 0)).reshape(3, 9)
        if laws is not None:
            q[:, first:apart] = -_integrate(gained, laws, rate, force, turn)
        q[:, apart:] = -np.concatenate(
            [
                np.tensordot(v, gained, 1)
                for v in ((1.0 - share) * turn.moving, share * turn.moving)
            ],
            axis=1,
        )
        back = across[k + 1].T @ whole[-1].T
        own = back @ cross_matrix(state.up[k]) @ q
        turns[i, :, :apart] = own[:, :apart]
        turns[i, :, walk + 3 * k : walk + 3 * k + 6] = own[:, apart:]
        turns[i, :, ups + 2 * k : ups + 2 * k + 2] = back @ across[k]
        turns[i, :, ups + 2 * k + 2 : ups + 2 * k + 4] = -np.eye(2)
        misfit[i] = back @ state.up[k]  # u_{k+1} is across the plane
    rests, off = _rest_rows(log, state, laws, across, prior, size)
    return LinearisedTurns(
        np.concatenate([misfit.ravel(), off]),
        sparse.csr_array(np.concatenate([turns.reshape(-1, size), rests])),
        len(log.turns),
    )


def _integrate(gained: Array, laws: Laws, rate: Array, force: Array, turn: Turn) -> Array:
    """(3, m) the integral of weights (n, 3, 3) times the laws' columns along a turn, a part of the
    samples at a time: an hour has a million, and a law dozens of columns."""
    whole: Array | float = 0.0
    for begin in range(0, len(turn.t), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        columns = turn.moving[part, None, None] * laws.rate(rate[part], force[part], turn.t[part])
        whole = whole + np.tensordot(gained[part], columns, ((0, 2), (0, 1)))
    return np.asarray(whole)


def _rest_rows(
    log: TurnLog, state: State, laws: Laws | None, across: Array, prior: Array, size: int
) -> tuple[Array, Array]:
    """Jacobian and residual of the rests' forces and rates, of the walk, and of what is known."""
    n, many = log.rests, state.offset.size
    first, apart, ups = ACCELEROMETER + GAIN, state.first_offset, state.first_up
    walk, each = state.first_drift, np.arange(n)
    force, rate, step = (np.zeros((n, 3, size)) for _ in range(3))
    of_force = force_columns(state, laws)
    reading = log.force - of_force @ state.theta
    away = reading - state.bias_at(log.session)
    force[:, :, :3] = -state.lower
    force[:, :, first:apart] = -state.lower @ of_force
    for axis in range(3 if many else 0):
        force[each, :, apart + 3 * log.session + axis] = -state.lower[:, axis]
    for column, (i, j) in enumerate(LOWER):
        force[:, i, 3 + column] = away[:, j]
    columns = rate_columns(log, state, laws)
    rate[:, :, first:apart] = columns
    for axis in range(3):
        rate[each, axis, walk + 3 * each + axis] = 1.0
        step[each, axis, walk + 3 * each + axis] = 1.0
        step[each[1:], axis, walk + 3 * each[:-1] + axis] = -1.0
        for k in range(2):
            force[each, axis, ups + 2 * each + k] = -across[:, axis, k]
    known = np.eye(walk, size)
    residual = [
        state.force(reading, log.session) - state.up,
        state.drift + columns @ state.theta - log.rate,
        np.diff(state.drift, axis=0),
    ]
    jacobian = [v.reshape(-1, size) for v in (force, rate, step[1:])]
    return (
        np.concatenate([*jacobian, known]),
        np.concatenate([*(v.ravel() for v in residual), away_from_nominal(state)]),
    )


def away_from_nominal(state: State) -> Array:
    """Accelerometer, K - 1, θ and power-ups, in the order of the columns."""
    lower = np.array([state.lower[i, j] - (i == j) for i, j in LOWER])
    gain, offset = (state.gain - np.eye(3)).ravel(), state.offset.ravel()
    return np.concatenate([state.bias, lower, gain, state.theta, offset])


def rate_columns(log: TurnLog, state: State, laws: Laws | None) -> Array:
    """(N, 3, m) the laws' columns at the rests, where nothing turns."""
    if laws is None or not state.theta.size:
        return np.zeros((log.rests, 3, 0))
    return laws.rate(np.zeros((log.rests, 3)), state.up, log.time)


def force_columns(state: State, laws: Laws | None) -> Array:
    """(N, 3, m) g, what laws add to the accelerometer's readings at the rests."""
    if laws is None or laws.force is None:
        return np.zeros((*state.up.shape, state.theta.size))
    return laws.force(state.up)


def rest_forces(fit: TurnFit) -> Array:
    """(N, 3) g, of every rest as it is corrected."""
    read = fit.log.force - force_columns(fit.state, fit.laws) @ fit.state.theta
    return fit.state.force(read, fit.log.session)


def variances(log: TurnLog, noise: TurnNoise, prior: Array) -> Array:
    """(R,) of every row of a linearised problem; prior : (m,) sd of θ."""
    turns = _of_turns(log, noise)
    apart = np.diff(log.time)[:, None] * noise.walk**2
    apart[~log.linked] = _AWAKE**2
    return np.concatenate(
        [
            np.repeat(turns, 2),
            np.repeat(np.minimum(log.force_sd**2 + noise.force**2, _NOTHING**2), 3),
            (log.rate_sd**2).ravel(),
            apart.ravel(),
            np.repeat(
                [_BIAS, _SCALE, _CROSS, _SCALE, _CROSS, _CROSS, _SCALE, _GAIN],
                [3, 1, 1, 1, 1, 1, 1, 9],
            )
            ** 2,
            prior**2,
            np.full(3 * log.sessions, noise.power_up**2),
        ]
    )


def _of_turns(log: TurnLog, noise: TurnNoise) -> Array:
    """(T,) rad²."""
    span, noisy, path = log.spans
    walk = float(np.mean(noise.walk**2)) * span**3 / 12.0
    return np.asarray(log.white**2 * noisy + walk + noise.floor**2 + (noise.per_angle * path) ** 2)


def _move(state: State, step: Array) -> State:
    m, n = state.theta.size, len(state.up)
    lower = state.lower.copy()
    for (i, j), more in zip(LOWER, step[3:9], strict=True):
        lower[i, j] += more
    parts = np.split(step[9:], np.cumsum([9, m, state.offset.size, 3 * n]))
    up = state.up + np.einsum("nij,nj->ni", tangents(state.up), parts[4].reshape(n, 2))
    return State(
        bias=state.bias + step[:3],
        lower=lower,
        gain=state.gain + parts[0].reshape(3, 3),
        theta=state.theta + parts[1],
        offset=state.offset + parts[2].reshape(-1, 3),
        drift=state.drift + parts[3].reshape(n, 3),
        up=up / np.linalg.norm(up, axis=1)[:, None],
    )


def _estimate_noise(fit: TurnFit, prior: Array) -> TurnNoise:
    """Walk, the rests' and power-ups' scatter by their moments; floor and κ as the means of their
    squares under the likelihood of the turns with all unknowns integrated out, at their prior."""
    log, state = fit.log, fit.state
    noise = TurnNoise(
        floor=0.0,
        per_angle=0.0,
        walk=_walk(log, state, fit.laws),
        force=_scatter(fit),
        power_up=_between_power_ups(fit),
    )
    used = fit.used & (fit.weight > 0.0)
    points = noise_points(log, noise)
    own = points[:, used] / fit.weight[used]
    shared = np.append(np.arange(state.first_drift), fit.rows.jacobian.shape[1])
    weight = np.where(used, fit.weight, 0.0) / points
    every = variances(log, noise, prior)
    start = 2 * fit.rows.turns
    every[start : start + 3 * log.rests] /= np.repeat(fit.rest_weight, 3)
    corner, logs = eliminate_rests(fit.rows, log, every, shared, weight)
    root = np.linalg.cholesky(corner[:, :-1, :-1])
    known = np.linalg.solve(root, corner[:, :-1, -1:])[..., 0]
    square = corner[:, -1, -1] - np.sum(known * known, axis=1)
    logs += np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1) + np.log(own).sum(axis=1)
    logs = (-0.5 * square - logs).reshape(len(_FLOORS), len(ANGLES))
    likely = np.exp(logs - logs.max()) * ANGLE_PRIOR if used.any() else np.ones(logs.shape)
    likely /= likely.sum()
    return replace(
        noise,
        floor=float(np.sqrt(likely.sum(axis=1) @ _FLOORS**2)),
        per_angle=float(np.sqrt(likely.sum(axis=0) @ ANGLES**2)),
    )


def noise_points(log: TurnLog, noise: TurnNoise) -> Array:
    """(B, T) rad², variances of the turns at every floor, and for each at every κ of `ANGLES`."""
    each = (
        replace(noise, floor=float(floor), per_angle=float(angle))
        for floor in _FLOORS
        for angle in ANGLES
    )
    return np.array([_of_turns(log, point) for point in each])


def eliminate_rests(
    rows: LinearisedTurns, log: TurnLog, variance: Array, shared: Index, weight: Array
) -> tuple[Array, Array]:
    """What `chain.eliminated` makes of all rows. variance : (R,); shared : (g,) the columns that no
    rest has, the residual's after all others; weight : (B, T) of the turns"""
    whole = sparse.hstack([rows.jacobian, rows.residual[:, None]], format="csr")
    ups = rows.jacobian.shape[1] - 2 * log.rests
    each = np.arange(log.rests)[:, None]
    drift, up = ups - 3 * log.rests + 3 * each + np.arange(3), ups + 2 * each + np.arange(2)
    order, numbers = np.concatenate([drift, up], axis=1), 2 * rows.turns
    rest = whole[numbers:]
    normal = (rest.T @ rest.multiply(1.0 / variance[numbers:, None])).toarray()
    at = np.array([turn.rest for turn in log.turns], dtype=np.intp)
    heavy = np.zeros((len(weight), log.rests - 1))
    heavy[:, at] = weight
    turns = turns_of(whole[:numbers].toarray(), at, order, shared)
    return eliminate(chain_of(normal, order, shared), turns, heavy)


def _walk(log: TurnLog, state: State, laws: Laws | None) -> Array:
    """(3,) of the differences of neighbouring rests' means, their own noise taken off; of it a part
    is always left, for a median of few may be anything."""
    if not log.linked.any():
        return np.full(3, 1e-9)
    own = log.rate - rate_columns(log, state, laws) @ state.theta
    change = np.diff(own, axis=0)[log.linked] ** 2
    noise = (log.rate_sd[1:] ** 2 + log.rate_sd[:-1] ** 2)[log.linked]
    apart = np.diff(log.time)[log.linked][:, None]
    more = np.median(np.maximum(change / _NORMAL - noise, 0.0) / apart, axis=0)
    return np.asarray(np.sqrt(np.maximum(more, 0.09 * np.median(noise / apart, axis=0))))


def _between_power_ups(fit: TurnFit) -> float:
    """g, by which power-ups scatter: of their parts, everything else unknown, as the mean in the
    logarithm over the sizes that they allow. A law that they may follow is no scatter."""
    count, first = len(fit.state.offset), fit.state.first_offset
    if not (count and fit.covariance.size):
        return _FREE
    own = slice(first, first + 3 * count)
    whole = np.linalg.inv(fit.covariance[own, own])
    information = whole - np.eye(3 * count) / fit.variance[-1]
    parts = Parts(information, whole @ fit.state.offset.ravel())
    noise_alone = float(np.mean(np.diag(information)) ** -0.5)
    logs = np.array([parts.log_likelihood(np.full(3, size)) for size in _SCATTERS])
    weight = np.exp(logs - logs.max()) * _SCATTERS / (_SCATTERS + noise_alone)
    return float(np.exp(weight @ np.log(_SCATTERS) / weight.sum()))


def _scatter(fit: TurnFit) -> float:
    """g, of the norms of the rests beside what their samples say: of what accelerometer and laws
    leave of them, for the turns, which hold these too, leave more."""
    log, state = fit.log, fit.state
    force, own = rest_forces(fit), force_columns(state, fit.laws)
    size = np.linalg.norm(force, axis=1)
    up = force / size[:, None]
    away = log.force - own @ state.theta - state.bias_at(log.session)
    each = np.eye(max(log.sessions, 1))[log.session]
    biases = (each[:, :, None] * (up @ state.lower)[:, None, :]).reshape(log.rests, -1)
    laws = np.einsum("ni,nim->nm", up @ state.lower, own)
    slopes = np.column_stack([biases, *(up[:, i] * away[:, j] for i, j in LOWER), laws])
    known = np.isfinite(log.force_sd)
    heavy = np.sqrt(fit.rest_weight[known])
    slopes = heavy[:, None] * slopes[known][:, slopes.any(axis=0)]
    left = heavy * (1.0 - size)[known]
    basis = np.linalg.qr(slopes)[0]
    off = left - basis @ (basis.T @ left)
    whole = float(off @ off) / max(left.size - slopes.shape[1], 1)
    return float(np.sqrt(max(whole - float(np.mean(log.force_sd[known] ** 2)), 1e-14)))


def carry_error(fit: TurnFit, at: Index, force: Array | None = None) -> Array:
    """(k,) rad: gravity of the rest before a turn, carried by the rate, against the rest after.

    at : turns, of which none need have taken part in the fit; force : (N, 3) gravity at the rests,
    or None as the fit's accelerometer reads it
    """
    log, state = fit.log, fit.state
    force = rest_forces(fit) if force is None else force
    found = []
    for i in at:
        turn = log.turns[i]
        seen, _ = remove_bias(log, state.drift, turn)
        of = state.force(turn.force, log.session[turn.rest])
        rate, _ = exposure(state, seen, of, turn, fit.laws)
        whole = attitudes(turn.t, rate @ state.gain.T)[-1]
        found.append(float(between(whole.T @ force[turn.rest], force[turn.rest + 1])))
    return np.array(found)
