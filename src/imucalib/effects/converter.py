"""Non-linearity of the converter as a free curve of each axis, fine enough to see code steps.

A sum of cosines over the input from -1.06 to 1.06 g, without their constant and straight parts,
which are bias and scale. Beyond that range the curve keeps its value at the edge.
"""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Effect, Family
from imucalib.effects.forms import Bend, own_input

_TERMS = 32
_REACH = 1.06  # g
_FEWEST = 100  # observations: fewer cannot carry the curve of one axis
_ORDER = np.arange(2, _TERMS + 2)


def _phase(u: Array) -> Array:
    return np.asarray(np.pi * (u[..., None] + _REACH) / (2.0 * _REACH) * _ORDER)


def _straight() -> Array:
    """(2, _TERMS) constant and slope of each cosine over the range, which are taken out."""
    grid = np.linspace(-_REACH, _REACH, 2001)
    design = np.column_stack([np.ones_like(grid), grid])
    return np.asarray(np.linalg.lstsq(design, np.cos(_phase(grid)), rcond=None)[0])


_STRAIGHT = _straight()


def _values(u: Array) -> Array:
    inside = np.clip(u, -_REACH, _REACH)
    bent = np.cos(_phase(inside)) - _STRAIGHT[0] - _STRAIGHT[1] * inside[..., None]
    return np.asarray(bent)


def _slope(u: Array) -> Array:
    """Per g; zero outside the range."""
    slope = -np.sin(_phase(u)) * np.pi * _ORDER / (2.0 * _REACH) - _STRAIGHT[1]
    return np.where((np.abs(u) <= _REACH)[..., None], slope, 0.0)


_CURVE = Bend(_values, _slope, tuple(map(str, _ORDER)), tuple((1.0 / np.sqrt(_ORDER)).tolist()))


def converter(axes: str) -> Effect:
    """The curves of some axes, "x" or "xyz"; ValueError otherwise."""
    if not axes or set(axes) - set("xyz"):
        raise ValueError(f"'{axes}' names no axes")
    words = (
        f"converter@{axes}",
        f"The converter's response of {', '.join(axes)} is a free curve of its own input.",
        "y_i = x_i + Σ_k c_ik (cos(k π (x_i + r) / 2r) - straight part),  r = 1.06 g",
        "integral non-linearity of converters, 0.5 % of full scale in MEMS data sheets",
        "Record many postures, so that every value of each axis is seen.",
    )
    return own_input(words, axes, _CURVE, _CURVE.sizes(f"converter_{axes}", axes, "mg", 50.0))


FAMILIES = (
    Family(
        "converter",
        "The converter's response is a free curve of its input.",
        "y",
        converter,
        lambda context: ("x", "y", "z", "xyz") if context.n >= _FEWEST else (),
        free=True,
    ),
)
