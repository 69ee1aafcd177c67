"""What of the temperature's past effects may follow, by the names of their covariates."""

from __future__ import annotations

from imucalib.arrays import Array
from imucalib.effects import thermal_lag as lag
from imucalib.effects.worn import temperature_rate as rate
from imucalib.effects.worn import thermal_hysteresis as play
from imucalib.rests.thermal_history import ThermalHistory

#: Covariates that a recording with a clock and a thermometer has.
REMEMBERED = (
    *map(lag.covariate, lag.LAGS),
    *map(play.covariate, play.WIDTHS),
    *map(rate.covariate, rate.TIMES),
)


def is_remembered(name: str) -> bool:
    """Whether a history of the temperature tells the covariate."""
    value = name.removeprefix(lag.PREFIX)
    return name.startswith((play.PREFIX, rate.PREFIX)) or (
        value != name and not lag.counts_rows(value)
    )


def remembered(history: ThermalHistory, name: str, at: Array) -> Array:
    """The covariate (°C) at times (s)."""
    if name.startswith(rate.PREFIX):
        return history.rate(rate.hours_of(name.removeprefix(rate.PREFIX)), at)
    if name.startswith(play.PREFIX):
        return history.behind_play(play.width_of(name.removeprefix(play.PREFIX)), at)
    return history.lagged(lag.hours_of(name.removeprefix(lag.PREFIX)), at)
