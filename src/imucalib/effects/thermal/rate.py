"""A bias that follows how fast the temperature changes: a gradient within the sensor.

While a sensor warms its inside trails its outside, by what it warms in the time that heat takes to
get there: T - T_lag, which for a short lag is the rate of change. A late bias (`thermal_lag`) has
that difference and the temperature itself; this one has the difference alone.
"""

from imucalib.core.context import Context
from imucalib.core.effect import Effect, Family, Response
from imucalib.core.parameter import Parameter
from imucalib.effects.covariate import bias_with

#: Times that heat may take into a case.
TIMES = ("2min", "5min", "12min", "30min")

PREFIX = "temperature_rate_"


def covariate(value: str) -> str:
    """Name of the covariate that carries the rate (°C/h) over this time."""
    return f"{PREFIX}{value}"


def hours_of(value: str) -> float:
    """The time "12min" in hours; ValueError otherwise."""
    if not value.endswith("min") or not float(value[:-3]) > 0.0:
        raise ValueError(f"no time that heat takes: {value}")
    return float(value[:-3]) / 60.0


def temperature_rate(value: str) -> Effect:
    """Over the time given as "12min"; ValueError otherwise."""
    minutes, name = 60.0 * hours_of(value), covariate(value)
    return Response(
        f"temperature_rate@{value}",
        f"The bias follows the rate at which the temperature changes, over {minutes:g} min.",
        "y_i = x_i + c_i (T - T_lag) / τ,  T_lag' = (T - T_lag) / τ",
        "temperature-ramp sensitivity, IEEE Std 952-1997; parts of a mg as a case is put on or off",
        "Record the temperature through changes as quick as those of putting the sensor on.",
        (name,),
        each=tuple(Parameter(f"rate_{value}_{a}", "mg/(degC/h)", 0.3, 10.0) for a in "xyz"),
        basis=bias_with(lambda context: context[name]),
    )


def _values(context: Context) -> tuple[str, ...]:
    names = (name for name in context.covariates if name.startswith(PREFIX))
    return tuple(name.removeprefix(PREFIX) for name in names)


FAMILIES = (
    Family(
        "temperature_rate",
        "The bias follows how fast the temperature changes.",
        "12min",
        temperature_rate,
        _values,
    ),
)
