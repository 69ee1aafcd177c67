"""Bias and scale that follow a covariate: temperature, time, warm-up, and any
column of a table that the user names as a driver."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Basis, Context, Effect, Family, Parameter, Response, Truth
from imucalib.units import MG

Drive = Callable[[Context], Array]


#: mg/°C of a bias, twice the worst of data sheets.
USUAL_PER_DEGC = 2.0
#: Where the covariate's own zero is, a constant, so that a subset keeps the parameters' meaning.
_REFERENCE = {"temperature": 25.0, "order": 0.5}


def _from_reference(name: str) -> Drive:
    return lambda context: context[name] - _REFERENCE[name]


def _warm_up(context: Context) -> Array:
    return np.exp(-4.0 * context["order"])


def _step(context: Context) -> Array:
    return (context["sweep"] > 0.0).astype(float)


def bias_with(drive: Drive) -> Basis:
    """Basis of a bias that follows a drive (n,): mg per unit of it."""

    def basis(truth: Truth, context: Context) -> Array:
        one = np.eye(3) * MG * drive(context)[:, None, None, None]
        return np.broadcast_to(one, (*truth.shape, 3))

    return basis


def scale_with(drive: Drive) -> tuple[Basis, Basis]:
    """Basis of a scale that follows a drive (n,), mg/g per unit of it; its slope by the force."""

    def basis(truth: Truth, context: Context) -> Array:
        one = np.eye(3) * 1e-3 * drive(context)[:, None, None, None]
        return np.asarray(one * truth.force[..., None])

    def basis_dx(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, 3, 3))
        for axis in range(3):
            out[..., axis, axis, axis] = 1e-3 * drive(context)[:, None]
        return out

    return basis, basis_dx


def _effect(
    name: str,
    words: tuple[str, str, str, str],
    needs: tuple[str, ...],
    unit: str,
    typical: float,
    basis: Basis,
    basis_dx: Basis | None = None,
    usual: float = math.inf,
) -> Response:
    largest = 30.0 * typical
    each = tuple(Parameter(f"{name}_{a}", unit, typical, largest, usual=usual) for a in "xyz")
    return Response(name, *words, needs, each=each, basis=basis, basis_dx=basis_dx)


EFFECTS = (
    _effect(
        "temperature_bias",
        (
            "The bias follows the temperature.",
            "y_i = x_i + c_i (T - 25 °C)",
            "0.02-1 mg/°C in MEMS data sheets",
            "Record the temperature; repeat positions at two temperatures, in mixed order.",
        ),
        ("temperature",),
        "mg/degC",
        0.5,
        bias_with(_from_reference("temperature")),
        usual=USUAL_PER_DEGC,
    ),
    _effect(
        "temperature_scale",
        (
            "The scale factor follows the temperature.",
            "y_i = x_i (1 + c_i (T - 25 °C))",
            "0.01-0.04 %/°C in MEMS data sheets",
            "Record the temperature; repeat positions at two temperatures, in mixed order.",
        ),
        ("temperature",),
        "mg/g/degC",
        0.2,
        *scale_with(_from_reference("temperature")),
        usual=0.8,
    ),
    _effect(
        "bias_drift",
        (
            "The bias moves steadily over the recording.",
            "y_i = x_i + d_i (order - 1/2), order from 0 to 1",
            "1 mg over a bench run, practice",
            "Repeat a few positions at the end, and take the positions in random order.",
        ),
        ("order",),
        "mg",
        1.0,
        bias_with(_from_reference("order")),
    ),
    replace(
        _effect(
            "scale_drift",
            (
                "The scale factor moves steadily over the recording.",
                "y_i = x_i (1 + d_i (order - 1/2)), order from 0 to 1",
                "0.1 % over a bench run, practice",
                "Repeat a few positions at the end, and take the positions in random order.",
            ),
            ("order",),
            "mg/g",
            1.0,
            *scale_with(_from_reference("order")),
        ),
        remedy="its scale moves: let it warm up, check its supply, or leave it out",
    ),
    _effect(
        "warm_up",
        (
            "The bias settles exponentially from the start, within a quarter of the recording.",
            "y_i = x_i + w_i exp(-4 order)",
            "about 1 mg, practice",
            "Let the sensor warm up, or record its temperature.",
        ),
        ("order",),
        "mg",
        1.0,
        bias_with(_warm_up),
    ),
    _effect(
        "bias_step",
        (
            "The bias changes where a new sweep begins (a knock, a re-clamped tool).",
            "y_i = x_i + d_i [sweep > first]",
            "1-20 mg after a knock, practice",
            "Repeat a position of the first sweep in the later ones.",
        ),
        ("sweep",),
        "mg",
        2.0,
        bias_with(_step),
    ),
)

#: What a column that the user names as a driver is called among the covariates.
COLUMN = "column "


_FOLLOWS = {
    "bias": ("bias", "y_i = x_i + c_i u", "mg"),
    "scale": ("scale factor", "y_i = x_i (1 + c_i u)", "mg/g"),
}


def _follows(value: str) -> Effect:
    """Of "bias:supply_V:12:0.5" the bias that follows the column supply_V, for 0.5 of it from 12;
    ValueError where the value says nothing of the kind."""
    what, _, rest = value.partition(":")
    name, middle, half = rest.rsplit(":", 2)
    center, unit = float(middle), float(half)
    if what not in _FOLLOWS or not name or not unit > 0.0:
        raise ValueError(f"no driver: {value}")

    def drive(context: Context) -> Array:
        return (context[COLUMN + name] - center) / unit

    sentence, equation, size = _FOLLOWS[what]
    words = (
        f"The {sentence} follows {name}.",
        f"{equation},  u = ({name} - {middle}) / {half}",
        "a column that the user names; its size is taken as a drift's",
        f"Repeat positions at two values of {name}, in mixed order.",
    )
    basis = (bias_with(drive),) if what == "bias" else scale_with(drive)
    return _effect(f"follows@{value}", words, (COLUMN + name,), size, 1.0, *basis)


def _drivers(context: Context) -> tuple[str, ...]:
    """Bias and scale with every named column that moves: middle of its range, half of it."""
    found = []
    for name in filter(lambda name: name.startswith(COLUMN), context.covariates):
        half = 0.5 * float(np.ptp(context[name]))
        if half > 0.0:
            span = f"{float(np.min(context[name])) + half:.6g}:{half:.6g}"
            found += [f"{what}:{name.removeprefix(COLUMN)}:{span}" for what in _FOLLOWS]
    return tuple(found)


FAMILIES = (
    Family(
        "follows",
        "Bias or scale follow a column that the user names (`--columns driver=NAME`).",
        "bias:supply_V:12:0.5",
        _follows,
        _drivers,
    ),
)
