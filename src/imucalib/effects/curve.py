"""A smooth curve where structure was found that no effect explains: a correction without a name.

Never searched for and never a name for a cause. It is added on request only, with as many terms as
hold out, over the range that was recorded; beyond that range it keeps its value at the edge.
"""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.core.effect import Effect, Family, Response, Rotation, Turn
from imucalib.core.parameter import Parameter
from imucalib.core.truth import Truth
from imucalib.effects.inclination import inclination_axis
from imucalib.units import MG, STANDARD_GRAVITY

#: What is bent -> words for it.
_KINDS = {"bias": "bias", "response": "response", "inclination": "inclination error",
          "tool_face": "tool-face error"}  # fmt: skip
_REACH = 1.06  # g, of an axis' own input


def _cosines(unit: Array, terms: int) -> Array:
    """(..., terms) smooth curves of a covariate that runs from 0 to 1."""
    return np.asarray(np.cos(np.pi * np.arange(1, terms + 1) * np.clip(unit, 0.0, 1.0)[..., None]))


def _covariate(name: str, low: float, high: float, terms: int, context: Context) -> Array:
    """(n, terms); the tool-face is periodic."""
    if name == "tool_face":
        k = np.arange(1, terms // 2 + 1) * context[name][:, None]
        return np.concatenate([np.sin(k), np.cos(k)], axis=1)
    return _cosines((context[name] - low) / (high - low), terms)


def curve(value: str) -> Effect:
    """The curve "what:against:low:high:terms", for example "bias:order:0:1:6" or
    "response:x:-1:1:8"; ValueError otherwise."""
    what, against, *rest = value.split(":")
    if what not in _KINDS or len(rest) != 3:
        raise ValueError(f"'{value}' is no curve")
    low, high, terms = float(rest[0]), float(rest[1]), int(rest[2])
    terms += terms % 2 if against == "tool_face" else 0
    words = (
        f"curve@{value}",
        f"{_KINDS[what]} against {against.replace('_', ' ')}: a smooth curve without a name.",
        "y_i = x_i + Σ_k c_k cos(k π u),  u from 0 to 1 over the range",
        "what was found in the data themselves",
        f"Record with {against.replace('_', ' ')} varied on its own, and find the cause.",
    )
    if what == "response":
        return _response(words, against, terms)
    if what == "bias":
        return _bias(words, value, against, (low, high, terms))
    return _angle(words, what, against, (low, high, terms))


def _bias(
    words: tuple[str, str, str, str, str], value: str, name: str, span: tuple[float, float, int]
) -> Effect:
    def basis(truth: Truth, context: Context) -> Array:
        shapes = MG * _covariate(name, *span, context)
        block = np.eye(3)[:, :, None] * shapes[:, None, None, None, :]
        every = np.broadcast_to(block, (*truth.shape, 3, span[2]))
        return np.asarray(every.reshape(*truth.shape, -1))

    each = tuple(
        Parameter(f"curve_{name}_{a}{k}", "mg", 1.0, 300.0) for a in "xyz" for k in range(span[2])
    )
    return Response(*words, (name,), each=each, basis=basis)


def _response(words: tuple[str, str, str, str, str], letter: str, terms: int) -> Effect:
    axis = "xyz".index(letter)
    order = np.arange(2, terms + 2)

    def phase(u: Array) -> Array:
        return np.asarray(0.5 * np.pi * order * (u[..., None] / _REACH + 1.0))

    def basis(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, terms))
        out[..., axis, :] = MG * np.cos(phase(truth.force[..., axis] / STANDARD_GRAVITY))
        return out

    def basis_dx(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, terms, 3))
        wave = np.sin(phase(truth.force[..., axis] / STANDARD_GRAVITY))
        steep = -wave * 0.5 * np.pi * order / _REACH
        out[..., axis, :, axis] = MG / STANDARD_GRAVITY * steep
        return out

    each = tuple(Parameter(f"curve_{letter}{k}", "mg", 1.0, 300.0) for k in order)
    return Response(*words, each=each, basis=basis, basis_dx=basis_dx)


def _angle(
    words: tuple[str, str, str, str, str], what: str, name: str, span: tuple[float, float, int]
) -> Effect:
    def turn(context: Context) -> tuple[Array, Array]:
        if what == "inclination":
            axis = inclination_axis(context)
        else:
            axis = np.broadcast_to(np.array([0.0, 0.0, -1.0]), (context.n, 3))
        return axis, _covariate(name, *span, context)

    turns: tuple[Turn, ...] = (turn,)
    each = tuple(Parameter(f"curve_{what}_{name}{k}", "deg", 0.1, 10.0) for k in range(span[2]))
    needs = tuple(dict.fromkeys((name, "tool_face")))
    return Rotation(*words, needs, named=each, turns=turns)


FAMILIES = (
    Family(
        "curve",
        "A smooth correction of structure that no effect explains; on request only.",
        curve,
        lambda context: (),
    ),
)
