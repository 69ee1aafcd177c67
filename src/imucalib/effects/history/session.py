"""What differs in one power-up of several beyond the bias and the seat, which every one changes:
the dial was set anew, the sensor was damaged, or another one was taken."""

from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Effect, Family, Parameter, Response, Rotation
from imucalib.effects.inclination import inclination_axis
from imucalib.effects.non_orthogonality import driven

COVARIATE = "session"
_SCALE = ((0, 0), (1, 1), (2, 2))
_SENSOR = (*_SCALE, (1, 0), (2, 0), (2, 1))
_IDENTIFY = "Repeat that session, and read the number on the sensor."

Drive = Callable[[Context], Array]
Pairs = tuple[tuple[int, int], ...]


def _of_sensor(
    name: str, sentence: str, drive: Drive, pairs: tuple[tuple[int, int], ...]
) -> Effect:
    basis, basis_dx = driven(pairs, drive)
    letters = ["xyz"[r] if r == s else f"{'xyz'[r]}{'xyz'[s]}" for r, s in pairs]
    prefix = name.replace("@", "_").replace(":", "_")
    return Response(
        name,
        sentence,
        "y_i = x_i + Σ_j c_ij x_j in that session"
        if len(pairs) > len(_SCALE)
        else "y_i = x_i (1 + c_i) in that session",
        "2 mg/g between two sensors, or after a knock, practice",
        _IDENTIFY,
        (COVARIATE,),
        each=tuple(Parameter(f"{prefix}_{a}", "mg/g", 2.0, 60.0) for a in letters),
        basis=basis,
        basis_dx=basis_dx,
        remedy="compare the numbers on the sensors, and leave that session out if they differ",
    )


def session(value: str) -> Effect:
    """Of "3:scale" the third session's scale factors, of "3:sensor" the angles between its axes
    too, of "3:inclination" the zero of its inclination dial; ValueError otherwise."""
    number, _, what = value.partition(":")
    which, name = int(number) - 1, f"session@{value}"
    if which < 0:
        raise ValueError(f"sessions count from 1, not {number}")

    def drive(context: Context) -> Array:
        return np.asarray(context[COVARIATE] == which, np.float64)

    if what == "scale":
        return _of_sensor(name, f"In session {number} the scale factors differ.", drive, _SCALE)
    if what == "sensor":
        sentence = f"In session {number} scale factors and the angles between the axes differ."
        return _of_sensor(name, sentence, drive, _SENSOR)
    if what != "inclination":
        raise ValueError(f"'{value}' is no session and what differs in it")
    return Rotation(
        name,
        f"In session {number} the inclination dial has its zero elsewhere.",
        "i = i_dial + d in that session",
        "0.1 deg, practice",
        "Set inclinations of both signs in every session.",
        (COVARIATE, "inclination", "tool_face"),
        named=(Parameter(f"session_{number}_inclination", "deg", 0.2, 10.0),),
        turns=(lambda context: (inclination_axis(context), drive(context)[:, None]),),
    )


def _values(context: Context) -> tuple[str, ...]:
    """Every session, of two the second."""
    if COVARIATE not in context:
        return ()
    numbers = 1 + np.unique(context[COVARIATE]).astype(int)
    kinds = ("scale", "sensor", *(("inclination",) if "inclination" in context else ()))
    return tuple(f"{n}:{kind}" for n in numbers[len(numbers) < 3 :] for kind in kinds)


FAMILIES = (
    Family(
        "session",
        "One session differs from the others in its scale factors, its sensor or its dial.",
        "2:scale",
        session,
        _values,
    ),
)
