"""A bias that follows how fast the temperature changes: a gradient within the sensor.

While a sensor warms its inside trails its outside, by what it warms in the time that heat takes to
get there: T - T_lag, which for a short lag is the rate of change. A late bias (`thermal_lag`) has
that difference and the temperature itself; this one has the difference alone.
"""

from imucalib.core.effect import Effect, Family, Response, three
from imucalib.effects.covariate import bias_with
from imucalib.effects.thermal import lag, values_of

#: Times that heat may take into a case.
TIMES = ("2min", "5min", "12min", "30min")

#: The same in rows of a table, whose positions take about as long each.
ROWS = (1, 3)

PREFIX = "temperature_rate_"


def covariate(value: str) -> str:
    """Name of the covariate that carries the rate (°C/h) over this time."""
    return f"{PREFIX}{value}"


def time_of(value: str) -> float:
    """The time "12min" in hours, or "3rows" in rows; ValueError otherwise."""
    for unit, size in (("min", 1.0 / 60.0), (lag.IN_ROWS, 1.0)):
        if value.endswith(unit) and float(value.removesuffix(unit)) > 0.0:
            return float(value.removesuffix(unit)) * size
    raise ValueError(f"no time that heat takes: {value}")


def temperature_rate(value: str) -> Effect:
    """Over the time given as "12min" or "3rows"; ValueError otherwise."""
    time, name, rows = time_of(value), covariate(value), lag.counts_rows(value)
    words = f"{time:g} rows" if rows else f"{60.0 * time:g} min"
    unit, typical = ("mg/(degC/row)", 1.0) if rows else ("mg/(degC/h)", 0.3)
    return Response(
        f"temperature_rate@{value}",
        f"The bias follows the rate at which the temperature changes, over {words}.",
        "y_i = x_i + c_i (T - T_lag) / τ,  T_lag' = (T - T_lag) / τ",
        "temperature-ramp sensitivity, IEEE Std 952-1997; parts of a mg as a case is put on or off",
        "Record the temperature through changes as quick as those of putting the sensor on.",
        (name,),
        each=three(f"rate_{value}", unit, typical, 30.0 if rows else 10.0),
        basis=bias_with(lambda context: context[name]),
    )


FAMILIES = (
    Family(
        "temperature_rate",
        "The bias follows how fast the temperature changes.",
        "12min",
        temperature_rate,
        values_of(PREFIX),
    ),
)
