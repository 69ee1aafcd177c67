"""A bias that follows the temperature late: the thermometer and the sensing element differ."""

from imucalib.core.context import Context
from imucalib.core.effect import Effect, Family, Response
from imucalib.core.parameter import Parameter
from imucalib.effects.covariate import bias_with

#: Hours by which the sensor may trail the thermometer.
LAGS = ("0.5h", "1h", "1.5h", "2h", "3h")

PREFIX = "temperature_lag_"


def covariate(value: str) -> str:
    """Name of the covariate that carries the temperature with this lag."""
    return f"{PREFIX}{value}"


def hours_of(value: str) -> float:
    """The lag "1.5h" as a number; ValueError otherwise."""
    return float(value.removesuffix("h"))


def thermal_lag(value: str) -> Effect:
    """The lag given as "1.5h"; ValueError otherwise."""
    hours = hours_of(value)
    name = covariate(value)

    basis = bias_with(lambda context: context[name] - 25.0)

    return Response(
        f"thermal_lag@{value}",
        f"The bias follows the temperature of the last {hours:g} hours.",
        "y_i = x_i + c_i (T_lag - 25 °C),  T_lag' = (T - T_lag) / τ",
        "0.5-3 h in a case on the wrist, practice",
        "Record the temperature through several changes that last longer than the lag.",
        (name,),
        each=tuple(Parameter(f"lag_{value}_{a}", "mg/degC", 0.5, 15.0) for a in "xyz"),
        basis=basis,
    )


def _values(context: Context) -> tuple[str, ...]:
    return tuple(v for v in LAGS if covariate(v) in context)


FAMILIES = (Family("thermal_lag", "The bias follows the temperature late.", thermal_lag, _values),)
