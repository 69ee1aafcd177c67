"""A bias that follows the temperature with a play: on the way up it differs from on the way down.

A package that sticks to its board, or an adhesive that creeps, gives way only once the strain has
turned by so much. Unlike a lag a play has no time: it waits for the temperature, however long.
"""

from imucalib.core.effect import Effect, Family, Parameter, Response
from imucalib.effects.covariate import USUAL_PER_DEGC, bias_with
from imucalib.effects.thermal import values_of

#: Widths of the play: what a day on the wrist can tell apart.
WIDTHS = ("2C", "3C", "4C", "6C")

PREFIX = "temperature_play_"


def covariate(value: str) -> str:
    """Name of the covariate that carries the temperature behind this play."""
    return f"{PREFIX}{value}"


def width_of(value: str) -> float:
    """°C, the width of the play "2C"; ValueError otherwise."""
    if not value.endswith("C") or not float(value[:-1]) > 0.0:
        raise ValueError(f"no width of a play: {value}")
    return float(value[:-1])


def thermal_hysteresis(value: str) -> Effect:
    """With the play given as "2C"; ValueError otherwise."""
    width, name = width_of(value), covariate(value)
    return Response(
        f"thermal_hysteresis@{value}",
        f"The bias follows the temperature with a play of {width:g} °C.",
        "y_i = x_i + c_i (T_p - 25 °C),  T_p moved by T only at the ends of T_p ± w/2",
        "play operator: Brokate, Sprekels, Hysteresis and Phase Transitions (1996), 2.1; "
        "a few °C wide in glued packages, practice",
        "Record the temperature, and let it turn several times, by more and by less than the play.",
        (name,),
        each=tuple(
            Parameter(f"play_{value}_{a}", "mg/degC", 0.5, 15.0, usual=USUAL_PER_DEGC)
            for a in "xyz"
        ),
        basis=bias_with(lambda context: context[name] - 25.0),
    )


FAMILIES = (
    Family(
        "thermal_hysteresis",
        "The bias follows the temperature with a play.",
        "2C",
        thermal_hysteresis,
        values_of(PREFIX),
    ),
)
