"""Non-linearity of the converter as a free curve of each axis, fine enough to see code steps.

A sum of cosines over the input from -1.06 to 1.06 g, without their constant and straight parts,
which are bias and scale. Beyond that range the curve keeps its value at the edge.
"""

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Action, Context, Effect, Family, Parameter, Response, Truth
from imucalib.units import MG, STANDARD_GRAVITY

TERMS = 32
_REACH = 1.06  # g
_FEWEST = 100  # observations: fewer cannot carry the curve of one axis
_ORDER = np.arange(2, TERMS + 2)


def _straight() -> Array:
    """(2, TERMS) constant and slope of each cosine over the range, which are taken out."""
    grid = np.linspace(-_REACH, _REACH, 2001)
    design = np.column_stack([np.ones_like(grid), grid])
    return np.asarray(np.linalg.lstsq(design, _cosine(grid), rcond=None)[0])


def _phase(u: Array) -> Array:
    return np.asarray(np.pi * (u[..., None] + _REACH) / (2.0 * _REACH) * _ORDER)


def _cosine(u: Array) -> Array:
    return np.asarray(np.cos(_phase(u)))


_STRAIGHT = _straight()


def curve(u: Array) -> Array:
    """(..., TERMS) shapes at inputs u in g."""
    inside = np.clip(u, -_REACH, _REACH)
    return np.asarray(_cosine(inside) - _STRAIGHT[0] - _STRAIGHT[1] * inside[..., None])


def curve_slope(u: Array) -> Array:
    """Their derivative by u, per g; zero outside the range."""
    slope = -np.sin(_phase(u)) * np.pi * _ORDER / (2.0 * _REACH) - _STRAIGHT[1]
    return np.asarray(np.where((np.abs(u) <= _REACH)[..., None], slope, 0.0))


@dataclass(frozen=True)
class _Converter(Response):
    """axes : whose input each curve takes, in the parameters' order"""

    axes: tuple[int, ...] = ()

    def act(self, theta: Array, truth: Truth, context: Context) -> Action:
        """Each curve depends on one input alone: its slope needs no (n, 3, m, 3)."""
        if truth.shape[1] != 1 or not theta.any():
            return super().act(theta, truth, context)
        basis = self.basis(truth, context)
        d_x = np.zeros((*truth.shape, 3))
        for axis, own in zip(self.axes, theta.reshape(-1, TERMS), strict=True):
            slope = curve_slope(truth.force[..., axis] / STANDARD_GRAVITY) @ own
            d_x[..., axis, axis] += MG / STANDARD_GRAVITY * slope
        return Action(np.asarray(basis @ theta), basis, d_x)

    def missing(self, context: Context) -> str:
        if context.n < _FEWEST:
            return f"fewer than {_FEWEST} observations"
        return super().missing(context)


def converter(axes: str) -> Effect:
    """The curves of some axes, "x" or "xyz"; ValueError otherwise."""
    if not axes or set(axes) - set("xyz"):
        raise ValueError(f"'{axes}' names no axes")
    columns = ["xyz".index(a) for a in axes]

    def basis(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, len(columns), TERMS))
        for k, axis in enumerate(columns):
            out[..., axis, k, :] = MG * curve(truth.force[..., axis] / STANDARD_GRAVITY)
        return out.reshape(*truth.shape, -1)

    def basis_dx(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, len(columns), TERMS, 3))
        for k, axis in enumerate(columns):
            slope = curve_slope(truth.force[..., axis] / STANDARD_GRAVITY)
            out[..., axis, k, :, axis] = MG / STANDARD_GRAVITY * slope
        return out.reshape(*truth.shape, -1, 3)

    each = tuple(
        Parameter(f"converter_{axes}_{a}{k}", "mg", 1.0 / float(np.sqrt(k)), 50.0)
        for a in axes
        for k in _ORDER
    )
    return _Converter(
        f"converter@{axes}",
        f"The converter's response of {', '.join(axes)} is a free curve of its own input.",
        "y_i = x_i + Σ_k c_ik (cos(k π (x_i + r) / 2r) - straight part),  r = 1.06 g",
        "integral non-linearity of converters, 0.5 % of full scale in MEMS data sheets",
        "Record many postures, so that every value of each axis is seen.",
        each=each,
        basis=basis,
        basis_dx=basis_dx,
        axes=tuple(columns),
    )


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
