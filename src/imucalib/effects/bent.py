"""What a form of one number bends: bias, scale, the response of axes, or an angle of the bench."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Effect, Parameter, Response, Rotation, Truth, Turn
from imucalib.effects.inclination import inclination_axis
from imucalib.effects.tool_face import tool_face_axis
from imucalib.units import MG, STANDARD_GRAVITY

#: What is bent -> words for it.
KINDS = {
    "bias": "bias",
    "scale": "scale",
    "response": "response",
    "inclination": "inclination error",
    "tool_face": "tool-face error",
}
_PER_MILLE = 1e-3  # mg/g


@dataclass(frozen=True)
class Form:
    """values : (...) -> (..., m) of the driver, for axes of their input in g; slope : its
    derivative there, needed for a response; labels : (m,) of the parameters"""

    values: Callable[[Array], Array]
    slope: Callable[[Array], Array]
    labels: tuple[str, ...]
    typical: tuple[float, ...] = ()


@dataclass(frozen=True)
class Words:
    """name, sentence, equation, source and how to identify it, as `Effect` has them; prefix : of
    the parameters' names."""

    name: str
    sentence: str
    equation: str
    source: str
    identify: str
    prefix: str

    @property
    def described(self) -> tuple[str, str, str, str, str]:
        return (self.name, self.sentence, self.equation, self.source, self.identify)


def bent(words: Words, what: str, against: str, form: Form) -> Effect:
    """The effect; `against` names a covariate, or axes ("x", "xyz") whose input drives them.
    ValueError for a `what` that is none."""
    if what == "response":
        return _response(words, against, form)
    if what == "bias":
        return _bias(words, against, form)
    if what == "scale":
        return _scale(words, against, form)
    if what in KINDS:
        return _angle(words, what, against, form)
    raise ValueError(f"'{what}' cannot be bent")


def _bias(words: Words, name: str, form: Form) -> Effect:
    def basis(truth: Truth, context: Context) -> Array:
        shapes = MG * form.values(context[name])
        block = np.eye(3)[:, :, None] * shapes[:, None, None, None, :]
        every = np.broadcast_to(block, (*truth.shape, 3, shapes.shape[1]))
        return np.asarray(every.reshape(*truth.shape, -1))

    each = _sizes(f"{words.prefix}_{name}", "mg", 300.0, form)
    return Response(*words.described, (name,), each=each, basis=basis)


def _scale(words: Words, name: str, form: Form) -> Effect:
    def shapes(context: Context) -> Array:
        """(n, 3, 3 m) of the gain of each axis."""
        own = _PER_MILLE * form.values(context[name])
        block = np.eye(3)[:, :, None] * own[:, None, None, :]
        return np.asarray(block.reshape(*block.shape[:2], -1))

    def basis(truth: Truth, context: Context) -> Array:
        return np.asarray(truth.force[..., None] * shapes(context)[:, None])

    def basis_dx(truth: Truth, context: Context) -> Array:
        each = shapes(context)[:, None, ..., None] * np.eye(3)[:, None]
        return np.broadcast_to(each, (*truth.shape, *each.shape[-2:]))

    each = _sizes(f"{words.prefix}_scale_{name}", "mg/g", 50.0, form)
    return Response(*words.described, (name,), each=each, basis=basis, basis_dx=basis_dx)


def _sizes(prefix: str, unit: str, plausible: float, form: Form) -> tuple[Parameter, ...]:
    typical = form.typical or (1.0,) * len(form.labels)
    return tuple(
        Parameter(f"{prefix}_{a}{k}", unit, size, plausible)
        for a in "xyz"
        for k, size in zip(form.labels, typical, strict=True)
    )


def _response(words: Words, letters: str, form: Form) -> Effect:
    axes = ["xyz".index(a) for a in letters]

    def basis(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, len(axes), len(form.labels)))
        for k, axis in enumerate(axes):
            out[..., axis, k, :] = MG * form.values(truth.force[..., axis] / STANDARD_GRAVITY)
        return out.reshape(*truth.shape, -1)

    def basis_dx(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, len(axes), len(form.labels), 3))
        for k, axis in enumerate(axes):
            steep = form.slope(truth.force[..., axis] / STANDARD_GRAVITY)
            out[..., axis, k, :, axis] = MG / STANDARD_GRAVITY * steep
        return out.reshape(*truth.shape, -1, 3)

    each = tuple(
        Parameter(f"{words.prefix}_{a}{k}", "mg", 1.0, 300.0) for a in letters for k in form.labels
    )
    return Response(*words.described, each=each, basis=basis, basis_dx=basis_dx)


def _angle(words: Words, what: str, name: str, form: Form) -> Effect:
    def turn(context: Context) -> tuple[Array, Array]:
        axis = inclination_axis if what == "inclination" else tool_face_axis
        return axis(context), form.values(context[name])

    turns: tuple[Turn, ...] = (turn,)
    each = tuple(
        Parameter(f"{words.prefix}_{what}_{name}{k}", "deg", 0.1, 10.0) for k in form.labels
    )
    needs = tuple(dict.fromkeys((name, "tool_face")))
    return Rotation(*words.described, needs, named=each, turns=turns)
