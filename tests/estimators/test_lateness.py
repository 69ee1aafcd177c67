"""The delay of a gyroscope, its equations written a second time: columns are differences."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.estimators.carried import attitudes
from imucalib.estimators.lateness import lateness
from imucalib.estimators.turn_log import Turn, TurnLog
from imucalib.estimators.turns import LOWER, State, TurnFit, fit_turns, tangents
from worlds.turned_imu import chip, turned


def logged(late: float) -> TurnLog:
    """Eight rests, and turns that begin and end 0.3 s inside them, where a rate counts half."""
    rng = np.random.default_rng(3)
    log = turned(chip(rng, late=late), rng, rests=8)
    spans = np.searchsorted(log.t, log.still + np.array([0.1, -0.1]))
    rest = [slice(a, b) for a, b in spans]
    turns = []
    for k, ((_, a), (b, _)) in enumerate(pairwise(spans)):
        s = slice(a - 20, b + 20)
        moving = np.where((log.t[s] > log.still[k, 1]) & (log.t[s] < log.still[k + 1, 0]), 1.0, 0.5)
        turns.append(Turn(k, log.t[s], log.rate[s], log.force[s], moving))
    sd = 1.0 / np.sqrt(np.diff(spans).ravel())
    return TurnLog(
        time=log.t[spans.mean(axis=1).astype(int)],
        force=np.array([log.force[s].mean(axis=0) for s in rest]),
        rate=np.array([log.rate[s].mean(axis=0) for s in rest]),
        force_sd=3e-3 * sd, rate_sd=np.outer(1e-3 * sd, np.ones(3)),
        session=np.zeros(8, np.intp), turns=tuple(turns), white=1e-4,
    )  # fmt: skip


def weights(turn: Turn) -> Array:
    h = np.diff(turn.t)
    return np.asarray(0.5 * (np.r_[h, 0.0] + np.r_[0.0, h]))


def seen(fit: TurnFit, s: State, turn: Turn, late: float = 0.0) -> tuple[Array, Array]:
    """(n, 3, 3) attitudes and (n, 3) g, what the accelerometer reads in the axes of the start."""
    k, time = turn.rest, fit.log.time
    share = ((turn.t - time[k]) / (time[k + 1] - time[k]))[:, None]
    bias = (1.0 - share) * s.drift[k] + share * s.drift[k + 1]
    true = (turn.moving[:, None] * (turn.rate - bias)) @ s.gain.T
    true = true + late * np.gradient(true, turn.t, axis=0)
    whole = attitudes(turn.t, true)
    return whole, np.einsum("nij,nj->ni", whole, (turn.force - s.bias) @ s.lower.T)


def velocity(fit: TurnFit, s: State, late: float = 0.0) -> Array:
    """(3 T,) r of every turn: over the motion alone, that is where its share is one."""
    found = []
    for turn in fit.log.turns:
        h = np.where(turn.moving == 1.0, weights(turn), 0.0)
        found.append(h @ seen(fit, s, turn, late)[1] - h.sum() * s.up[turn.rest])
    return np.concatenate(found)


def moves(s: State) -> Iterator[Callable[[float], State]]:
    """What each parameter of the fit does to the state, in the order of its covariance."""

    def of(name: str, place: tuple[int, ...] | int) -> Callable[[float], State]:
        def moved(by: float) -> State:
            value = getattr(s, name).copy()
            value[place] += by
            return replace(s, **{name: value})

        return moved

    yield from (of("bias", i) for i in range(3))
    yield from (of("lower", place) for place in LOWER)
    yield from (of("gain", place) for place in np.ndindex(3, 3))
    yield from (of("drift", place) for place in np.ndindex(*s.drift.shape))
    for k, across in enumerate(tangents(s.up)):
        for axis in across.T:
            yield lambda by, k=k, axis=axis: replace(  # type: ignore[misc]
                s, up=s.up + by * axis * (np.arange(len(s.up)) == k)[:, None]
            )


def by_white_noise(fit: TurnFit, turn: Turn) -> Array:
    """(3, 3): dr = -[S]x R K dω of every sample's rate, whose sd is white / √h."""
    h, (whole, force) = weights(turn), seen(fit, fit.state, turn)
    out = np.zeros((3, 3))
    each = np.where(turn.moving == 1.0, h, 0.0)[:, None] * force
    for n, part in enumerate(h):
        ahead = each[n + 1 :].sum(axis=0) + 0.5 * each[n]
        gain = -turn.moving[n] * np.cross(ahead, (whole[n] @ fit.state.gain).T).T
        out += fit.log.white**2 * part * gain @ gain.T
    return out


def again(fit: TurnFit) -> tuple[float, float]:
    """The mean and sd of the delay over all densities of what the accelerometer reads beside."""
    s, e = fit.state, 1e-5
    r = velocity(fit, s)
    along = (velocity(fit, s, e) - velocity(fit, s, -e)) / (2.0 * e)
    columns = [(velocity(fit, m(e)) - velocity(fit, m(-e))) / (2.0 * e) for m in moves(s)]
    shared = np.transpose(columns) @ fit.covariance @ columns
    lasting = []
    for k, turn in enumerate(fit.log.turns):
        shared[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += by_white_noise(fit, turn)
        h = weights(turn)
        lasting += 3 * [h[turn.moving == 1.0].sum() + h.mean()]
    rows = []
    for density in 1e-5 * 2.0 ** np.arange(14):
        inverse = np.linalg.inv(shared + np.diag(density**2 * np.array(lasting)))
        known = along @ inverse @ along + 0.05**-2
        mean = -(along @ inverse @ r) / known
        odds = np.linalg.slogdet(inverse)[1] - np.log(known) - r @ inverse @ r + known * mean**2
        rows.append((0.5 * odds, mean, 1.0 / known))
    odds, mean, variance = np.transpose(rows)
    share = np.exp(odds - odds.max())
    share /= share.sum()
    middle = share @ mean
    return middle, np.sqrt(share @ (variance + (mean - middle) ** 2) + 2e-4**2)


@pytest.mark.parametrize("white", [1e-4, 0.3])  # the second leaves it to what is usual
def test_a_delay_is_what_its_equations_say(white: float) -> None:
    fit = fit_turns(logged(0.004))
    fit = replace(fit, log=replace(fit.log, white=white))
    got, own = lateness(fit), again(fit)
    assert got == pytest.approx(own, rel=1e-4)
