"""What of the temperature's past effects may follow, by the names of their covariates."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.effects.thermal import hysteresis as play
from imucalib.effects.thermal import lag, rate
from imucalib.rests.thermal_history import ThermalHistory

#: Covariates that a recording with a clock and a thermometer has.
REMEMBERED = (
    *map(lag.covariate, lag.LAGS),
    *map(play.covariate, play.WIDTHS),
    *map(rate.covariate, rate.TIMES),
)
#: Of a play the power that the temperature itself tells, from which on it is that but for noise.
_PLAIN = 0.97


def is_remembered(name: str) -> bool:
    """Whether a history of the temperature tells the covariate."""
    past = name.startswith((lag.PREFIX, play.PREFIX, rate.PREFIX))
    return past and not lag.counts_rows(name)


def remembered(history: ThermalHistory, name: str, at: Array) -> Array:
    """The covariate (°C) at times (s)."""
    if name.startswith(rate.PREFIX):
        return history.rate(rate.time_of(name.removeprefix(rate.PREFIX)), at)
    if name.startswith(play.PREFIX):
        return history.behind_play(play.width_of(name.removeprefix(play.PREFIX)), at)
    return history.lagged(lag.hours_of(name.removeprefix(lag.PREFIX)), at)


def remembered_in_rows(temperature: Array, time: Array | None, session: Array) -> dict[str, Array]:
    """Covariates (n,) of a table: lags and rates by its clock (s), or in rows, and plays of a width
    that its temperatures show: on one way alone, or between two of them, a play is an offset. Each
    session (n,) begins in equilibrium, amid the play."""
    by_rows = time is None
    at = 3600.0 * np.arange(len(temperature)) if time is None else time
    every = float(np.median(np.abs(np.diff(at)))) / 3600.0
    if every <= 0.0:
        return {}
    rows = [r for r in lag.ROWS if 4 * r <= len(temperature)]
    lags = {lag.covariate(lag.in_rows(r) if by_rows else f"{r * every:.2g}h"): r for r in rows}
    rates = {
        rate.covariate(lag.in_rows(r) if by_rows else f"{60.0 * r * every:.2g}min"): r
        for r in rate.ROWS
    }
    crossed = [w for w in play.WIDTHS if 2.0 * play.width_of(w) <= np.ptp(temperature)]
    plays = {play.covariate(w): play.width_of(w) for w in crossed}
    found = {name: np.empty(len(temperature)) for name in (*lags, *rates, *plays)}
    for one in np.unique(session):
        of = session == one
        history = ThermalHistory(at[of], temperature[of])
        for name, r in lags.items():
            found[name][of] = history.lagged(r * every, at[of])
        for name, r in rates.items():
            found[name][of] = history.rate(r * every, at[of])
        for name, width in plays.items():
            found[name][of] = history.behind_play(width, at[of])
    return {n: v for n, v in found.items() if n not in plays or _is_another(v, temperature)}


def _is_another(values: Array, temperature: Array) -> bool:
    """Whether what follows the temperature is more than it, a scale and an offset."""
    spread = float(np.std(values))
    return spread > 0.0 and float(np.corrcoef(values, temperature)[0, 1] ** 2) < _PLAIN
