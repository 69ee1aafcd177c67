"""What effects, forms and curves follow: time, the temperature, where the sensor points."""

from __future__ import annotations

from collections.abc import Iterable

#: What says where the sensor points.
_POSITION = (
    "response", "inclination", "tool_face",
    *(f"{before}_{axis}" for before in ("previous", "approach") for axis in "xyz"),
)  # fmt: skip
#: Covariates by which time drives an effect.
_TIME = ("order", "record", "sweep", "time", "time_of_day")


def driver_of(covariate: str) -> str:
    """What drives: time by whatever name, the temperature be it of now or earlier."""
    if covariate.startswith("temperature"):
        return "temperature"
    return "order" if covariate in _TIME else covariate


def course_of(needs: tuple[str, ...]) -> str:
    """What an effect follows: time first, then the temperature, else where the sensor points."""
    drivers = {driver_of(name) for name in needs}
    timed = "order" in drivers
    other = drivers - set(_POSITION) - {"order"}
    return "order" if timed else min(other) if other else "position"


def courses_without_a_cause(names: Iterable[str]) -> set[str]:
    """What the forms and curves of a model follow, whose cause nobody knows."""
    parts = [n.partition("@")[2].split(":") for n in names if n.startswith(("shape@", "curve@"))]
    return {course_of(() if what == "response" else (against,)) for what, against, *_ in parts}
