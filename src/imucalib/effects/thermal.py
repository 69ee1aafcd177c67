"""What of the temperature's past a bias may follow: the covariates that carry it, by name.

A lag: the thermometer and the sensing element differ. A rate: while a sensor warms its inside
trails its outside, by what it warms in the time that heat takes to get there. A play: a package
that sticks to its board gives way only once the strain has turned by so much, however long.
"""

from dataclasses import dataclass

from imucalib.core.effect import Context

#: Unit of a time in rows of a table, whose positions take about as long each.
ROWS = "rows"


@dataclass(frozen=True)
class Past:
    """prefix : of the covariates' names; units : of their values -> size in h, rows or °C
    values : what a day on the wrist can tell apart; rows : the same of a table
    """

    prefix: str
    units: tuple[tuple[str, float], ...]
    values: tuple[str, ...]
    rows: tuple[int, ...] = ()

    def covariate(self, value: str) -> str:
        """Name of the covariate that carries the temperature so: "temperature_lag_2h"."""
        return f"{self.prefix}{value}"

    def size(self, value: str) -> float:
        """Hours, rows or °C of "1.5h", "2rows" or "3C"; ValueError otherwise."""
        for unit, size in self.units:
            number = value.removesuffix(unit)
            if number != value and float(number) > 0.0:
                return float(number) * size
        raise ValueError(f"'{value}' is not a number of {' or '.join(dict(self.units))}")

    def select_recorded(self, context: Context) -> tuple[str, ...]:
        """The values whose covariate the data carry."""
        names = (name for name in context.covariates if name.startswith(self.prefix))
        return tuple(name.removeprefix(self.prefix) for name in names)


LAG = Past(
    "temperature_lag_", (("h", 1.0), (ROWS, 1.0)), ("0.5h", "1h", "1.5h", "2h", "3h"), (2, 4, 8)
)
RATE = Past(
    "temperature_rate_",
    (("min", 1.0 / 60.0), (ROWS, 1.0)),
    ("2min", "5min", "12min", "30min"),
    (1, 3),
)
PLAY = Past("temperature_play_", (("C", 1.0),), ("2C", "3C", "4C", "6C"))
