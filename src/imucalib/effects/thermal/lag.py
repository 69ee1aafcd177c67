"""A bias that follows the temperature late: the thermometer and the sensing element differ."""

from imucalib.core.effect import Effect, Family, Parameter, Response
from imucalib.effects.covariate import USUAL_PER_DEGC, bias_with
from imucalib.effects.thermal import values_of

#: Hours by which a worn sensor may trail its thermometer.
LAGS = ("0.5h", "1h", "1.5h", "2h", "3h")

#: The same in rows of a table, whose positions take about as long each.
ROWS = (2, 4, 8)

PREFIX = "temperature_lag_"
IN_ROWS = "rows"


def covariate(value: str) -> str:
    """Name of the covariate that carries the temperature with this lag."""
    return f"{PREFIX}{value}"


def in_rows(rows: int) -> str:
    """How a lag of so many rows is written."""
    return f"{rows}{IN_ROWS}"


def counts_rows(value: str) -> bool:
    """Whether a lag is of rows of a table, so that no recording tells the covariate."""
    return value.endswith(IN_ROWS)


def hours_of(value: str) -> float:
    """The lag "1.5h" as a number; ValueError otherwise."""
    return float(value.removesuffix("h"))


def thermal_lag(value: str) -> Effect:
    """The lag given as "1.5h" or "2rows"; ValueError otherwise."""
    rows = counts_rows(value)
    size = float(value.removesuffix(IN_ROWS)) if rows else hours_of(value)
    name = covariate(value)

    basis = bias_with(lambda context: context[name] - 25.0)

    return Response(
        f"thermal_lag@{value}",
        f"The bias follows the temperature of the last {size:g} {IN_ROWS if rows else 'hours'}.",
        "y_i = x_i + c_i (T_lag - 25 °C),  T_lag' = (T - T_lag) / τ",
        "0.5-3 h in a case on the wrist, minutes in a chamber, practice",
        "Record the temperature through several changes that last longer than the lag.",
        (name,),
        each=tuple(
            Parameter(f"lag_{value}_{a}", "mg/degC", 0.5, 15.0, usual=USUAL_PER_DEGC) for a in "xyz"
        ),
        basis=basis,
    )


FAMILIES = (
    Family(
        "thermal_lag",
        "The bias follows the temperature late.",
        "2h",
        thermal_lag,
        values_of(PREFIX),
    ),
)
