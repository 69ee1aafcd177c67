"""Forms of one number that bend a bias, a scale, the response of an axis or an angle of the bench:
a formula, or a smooth curve, without a cause.

The number is an axis' own input in g, or a covariate (of forms, angles in degrees). A form has up
to three numbers that a search scans or takes from the range; its sizes are fitted. A curve stands
over the range that was recorded. Beyond it that of a covariate goes on with slopes that no reading
knows: their sizes are zero, and their standard deviations what the curve's own size makes likely.
"""

import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import Action, Context, Effect, Parameter, Response, Rotation, Truth
from imucalib.effects.parts import (
    BIAS,
    INCLINATION,
    SCALE,
    TOOL_FACE,
    EffectPart,
    linear,
    turn_axes,
    words,
)
from imucalib.units import MG, STANDARD_GRAVITY

#: What is bent -> words for it.
KINDS = {
    "bias": "bias",
    "scale": "scale",
    "response": "response",
    "inclination": "inclination error",
    "tool_face": "tool-face error",
}
_REACH = 1.06  # g, of an axis' own input
#: What a covariate bends -> the part, what its parameters' names have before the covariate's, their
#: unit, and how much of one is still believed.
_BENT: dict[str, tuple[EffectPart, str, str, float]] = {
    "bias": (BIAS, "", "mg", 300.0),
    "scale": (SCALE, "scale_", "mg/g", 50.0),
    "inclination": (INCLINATION, "inclination_", "deg", 10.0),
    "tool_face": (TOOL_FACE, "tool_face_", "deg", 10.0),
}
#: Between a word and its number, a number and its unit: record17, 12min, 2C.
_UNIT = re.compile(r"(?<=^record)(?=\d)|(?<=\d)(?=[A-Za-z]+$)")


@dataclass(frozen=True)
class Bend:
    """values : (...) -> (..., m) of the number; slope : the same of its derivative, needed for a
    response; labels : (m,) of the parameters, typical : their sizes over that of the largest"""

    values: Callable[[Array], Array]
    slope: Callable[[Array], Array]
    labels: tuple[str, ...] = ("",)
    typical: tuple[float, ...] = (1.0,)

    def sizes(self, prefix: str, axes: str, unit: str, plausible: float) -> tuple[Parameter, ...]:
        """Parameters of some axes, each with all of its own in a row."""
        return tuple(
            Parameter(f"{prefix}_{axis}{label}", unit, typical, plausible * typical)
            for axis in axes
            for label, typical in zip(self.labels, self.typical, strict=True)
        )


@dataclass(frozen=True)
class OwnInput(Response):
    """What some axes, by their letters, make of their own input in g, as a bend has it."""

    axes: str = field(kw_only=True)
    bend: Bend = field(kw_only=True)

    def act(self, theta: Array, truth: Truth, context: Context) -> Action:
        """Each axis depends on one input alone: its slope needs no (n, 3, m, 3)."""
        if truth.shape[1] != 1 or not theta.any():
            return super().act(theta, truth, context)
        basis, d_x = self.basis(truth, context), np.zeros((*truth.shape, 3))
        for letter, own in zip(self.axes, theta.reshape(len(self.axes), -1), strict=True):
            axis = "xyz".index(letter)
            steep = self.bend.slope(truth.force[..., axis] / STANDARD_GRAVITY) @ own
            d_x[..., axis, axis] = MG / STANDARD_GRAVITY * steep
        return Action(np.asarray(basis @ theta), basis, d_x)


def own_input(
    texts: tuple[str, str, str, str, str], axes: str, bend: Bend, each: tuple[Parameter, ...]
) -> OwnInput:
    """The response of axes "x" or "xyz" to their own input; texts : as `Described` has them.
    ValueError where a letter is no axis."""
    columns = ["xyz".index(letter) for letter in axes]

    def basis(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, len(columns), len(bend.labels)))
        for k, axis in enumerate(columns):
            out[..., axis, k, :] = MG * bend.values(truth.force[..., axis] / STANDARD_GRAVITY)
        return out.reshape(*truth.shape, -1)

    def basis_dx(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, len(columns), len(bend.labels), 3))
        for k, axis in enumerate(columns):
            steep = bend.slope(truth.force[..., axis] / STANDARD_GRAVITY)
            out[..., axis, k, :, axis] = MG / STANDARD_GRAVITY * steep
        return out.reshape(*truth.shape, -1, 3)

    return OwnInput(*texts, each=each, basis=basis, basis_dx=basis_dx, axes=axes, bend=bend)


def _bend(
    texts: tuple[str, str, str, str, str], prefix: str, what: str, against: str, bend: Bend
) -> Effect:
    """`against` names a covariate, or axes ("x", "xyz") whose input bends their response; prefix :
    of the parameters' names."""
    if what == "response":
        return own_input(texts, against, bend, bend.sizes(prefix, against, "mg", 300.0))
    part, before, unit, plausible = _BENT[what]

    def values(context: Context) -> Array:
        return bend.values(context[against])

    name = f"{prefix}_{before}{against}"
    if part.axes:
        own = zip(bend.labels, bend.typical, strict=True)
        each = tuple(Parameter(name + k, unit, 0.1 * t, plausible * t) for k, t in own)
        needs = tuple(dict.fromkeys((against, "tool_face")))
        return Rotation(*texts, needs, named=each, turns=turn_axes(part.axes, values))
    basis, basis_dx = linear(part.columns, values, unit, inside=True)
    sizes = bend.sizes(name, "xyz", unit, plausible)
    return Response(*texts, (against,), each=sizes, basis=basis, basis_dx=basis_dx)


@dataclass(frozen=True)
class Form:
    """equation : with places for the numbers; values, slope : of the number and those"""

    equation: str
    values: Callable[..., Array]
    slope: Callable[..., Array]
    labels: tuple[str, ...] = ("",)


def _waves(u: Array, period: float) -> Array:
    k = 2.0 * np.pi / period
    return np.stack([np.sin(k * u), np.cos(k * u)], axis=-1)


def _exceed(u: Array, at: float) -> Array:
    """0 up to a limit and 1 at 1 g."""
    return np.maximum(np.abs(u) - at, 0.0) / (1.0 - at)


FORMS = {
    "sine": Form(
        "a sin(2π u / P) + b cos(2π u / P), P = {0}",
        _waves,
        lambda u, p: 2.0 * np.pi / p * _waves(u, p)[..., ::-1] * [1.0, -1.0],
        ("a", "b"),
    ),
    "power": Form(
        "a ((u - {1}) / {2})^{0}",
        lambda u, n, middle, reach: ((u - middle) / reach) ** int(n),
        lambda u, n, middle, reach: int(n) / reach * ((u - middle) / reach) ** (int(n) - 1),
    ),
    "odd_power": Form(
        "a sign(u) |u|^{0}",
        lambda u, n: np.sign(u) * np.abs(u) ** n,
        lambda u, n: n * np.abs(u) ** (n - 1.0),
    ),
    "even_power": Form(
        "a |u|^{0}",
        lambda u, n: np.abs(u) ** n,
        lambda u, n: n * np.sign(u) * np.abs(u) ** (n - 1.0),
    ),
    "kink": Form("a |u - {0}|", lambda u, at: np.abs(u - at), lambda u, at: np.sign(u - at)),
    "step": Form("a [u >= {0}]", lambda u, at: 1.0 * (u >= at), lambda u, at: np.zeros(u.shape)),
    "saturation": Form(
        "a sign(u) max(|u| - {0}, 0) / (1 - {0})",
        lambda u, at: np.sign(u) * _exceed(u, at),
        lambda u, at: (np.abs(u) > at) / (1.0 - at),
    ),
    "soft_saturation": Form(
        "a sign(u) max(|u| - {0}, 0)² / (1 - {0})²",
        lambda u, at: np.sign(u) * _exceed(u, at) ** 2,
        lambda u, at: 2.0 / (1.0 - at) * _exceed(u, at),
    ),
    "saw_tooth": Form(
        "a ((u / {0} + {1}) mod 1 - 1/2)",
        lambda u, period, phase: np.mod(u / period + phase, 1.0) - 0.5,
        lambda u, period, phase: np.full(u.shape, 1.0 / period),
    ),
    "exponential": Form(
        "a exp(-max((u - {1}) / {0}, 0))",
        lambda u, scale, start: np.exp(-np.maximum((u - start) / scale, 0.0)),
        lambda u, scale, start: (
            -np.exp(-np.maximum((u - start) / scale, 0.0)) / scale * ((u - start) / scale > 0.0)
        ),
    ),
}


def shape(value: str) -> Effect:
    """The form "what:against:kind:number[:number ...]", for example "response:xyz:sine:0.4" or
    "tool_face:tool_face:sine:120"; ValueError otherwise."""
    what, against, kind, *rest = value.split(":")
    if what not in KINDS or kind not in FORMS:
        raise ValueError(f"'{value}' is no form")
    form, numbers = FORMS[kind], [float(r) for r in rest]
    if len(numbers) != len(inspect.signature(form.values).parameters) - 1:
        raise ValueError(f"{kind} does not take {len(rest)} numbers")
    unit = 180.0 / np.pi if what != "response" and against in ("tool_face", "inclination") else 1.0

    def columns(of: Callable[..., Array], u: Array) -> Array:
        found = of(u * unit, *numbers)
        return found if len(form.labels) > 1 else found[..., None]

    texts = words(
        "shape@",
        value,
        kind=KINDS[what],
        covariate=against.replace("_", " "),
        form=kind.replace("_", " "),
        formula=form.equation.format(*rest),
    )
    bend = Bend(
        lambda u: columns(form.values, u),
        lambda u: unit * columns(form.slope, u),
        form.labels,
        (1.0,) * len(form.labels),
    )
    prefix = f"{kind}_{'_'.join(rest)}".replace("-", "m").replace(".", "p")
    return _bend(texts, prefix, what, against, bend)


def curve(value: str) -> Effect:
    """The curve "what:against:low:high:terms", for example "bias:order:0:1:6" or
    "response:xyz:-1:1:8"; ValueError otherwise."""
    what, against, *rest = value.split(":")
    if what not in KINDS or len(rest) != 3:
        raise ValueError(f"'{value}' is no curve")
    low, high, terms = float(rest[0]), float(rest[1]), int(rest[2])
    around = against == "tool_face"  # a response has axes there
    terms += terms % 2 if around else 0
    key, covariate = "curve@tool_face" if around else "curve@", against.replace("_", " ")
    texts = words(key, value, kind=KINDS[what], covariate=covariate)
    if what == "response":
        bend = _of_input(np.arange(2, terms + 2))
    elif around:
        bend = _around(np.arange(1, terms // 2 + 1))
    else:
        bend = _of_covariate(low, high, np.arange(1, terms + 1), ends=against != "time")
    return _bend(texts, "curve", what, against, bend)


def _of_input(order: Index) -> Bend:
    """Cosines over the range less their constant and line over all inputs that a sphere of
    attitudes gives, an even measure from -1 g to 1 g: those are bias and scale. Beyond the range
    the curve keeps its value at the edge."""
    pace = 0.5 * np.pi * order
    turn = pace / _REACH
    even, odd = np.sin(turn) / turn, (np.sin(turn) - turn * np.cos(turn)) / turn**2
    constant, line = np.cos(pace) * even, -3.0 * np.sin(pace) * odd

    def values(u: Array) -> Array:
        inside = np.clip(u, -_REACH, _REACH)[..., None]
        return np.asarray(np.cos(turn * inside + pace) - constant - line * inside)

    def slope(u: Array) -> Array:
        steep = -turn * np.sin(turn * u[..., None] + pace) - line
        return np.where((np.abs(u) <= _REACH)[..., None], steep, 0.0)

    return Bend(values, slope, tuple(str(k) for k in order), tuple(2.0 / order))


def _around(order: Index) -> Bend:
    """Sines and cosines of whole turns."""

    def values(v: Array) -> Array:
        k = order * v[:, None]
        return np.concatenate([np.sin(k), np.cos(k)], axis=1)

    labels = tuple(str(k) for k in range(2 * order.size))
    return Bend(values, values, labels, tuple(np.tile(1.0 / order, 2)))


def _of_covariate(low: float, high: float, order: Index, *, ends: bool) -> Bend:
    """Cosines from one end to the other. ends : with a slope beyond each, as steep as the first
    cosine at its steepest"""

    def values(v: Array) -> Array:
        unit = (v[..., None] - low) / (high - low)
        waves = np.cos(np.pi * order * np.clip(unit, 0.0, 1.0))
        beyond = [np.maximum(-unit, 0.0), np.maximum(unit - 1.0, 0.0)]
        return np.concatenate([waves, *(np.pi * b for b in beyond if ends)], axis=-1)

    labels = (*(str(k) for k in range(order.size)), *(("below", "above") if ends else ()))
    return Bend(values, values, labels, (*(1.0 / order), *((1.0, 1.0) if ends else ())))


def in_words(name: str) -> str:
    """An effect's name for a reader: of a form or a curve its kind and what it bends, and of what
    follows a column both, without their numbers; of another scan its value in words."""
    family, _, value = name.partition("@")
    what, against, kind, *_ = (*value.split(":"), "", "")
    if family == "follows":
        return f"{what} follows {against}"
    kind = "curve" if family == "curve" else kind.replace("_", " ")
    if what not in KINDS or not kind:
        parts = (_UNIT.sub(" ", part).replace(" C", " °C") for part in value.split(":"))
        return ", ".join([family.replace("_", " "), *(part for part in parts if part)])
    article = "an" if kind[0] in "aeiou" else "a"
    covariate = f" against {against.replace('_', ' ')}"
    if what == "response":
        covariate = f" of {against}" if len(against) == 1 else ""
    return f"{article} {kind} of the {KINDS[what]}{covariate}"
