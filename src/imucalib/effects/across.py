"""What the forces across an axis add to its reading, beside their products with its own."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.core.effect import Response
from imucalib.core.parameter import Parameter
from imucalib.core.truth import Truth
from imucalib.units import MG, STANDARD_GRAVITY

_SOURCE = "IEEE Std 1293 model equation; 0.1-0.5 % of full scale in MEMS data sheets"
_IDENTIFY = "Hold directions between the axes in all octants."
#: Of each axis those across it, in cyclic order.
_FIRST, _SECOND = (1, 2, 0), (2, 0, 1)
_UNIT = MG / STANDARD_GRAVITY**2


def _both(truth: Truth) -> tuple[Array, Array]:
    return truth.force[..., _FIRST], truth.force[..., _SECOND]


def _slopes(first: Array, second: Array) -> Array:
    """(n, K, 3, 3, 3) of each axis' own column by the forces across it."""
    out = np.zeros((*first.shape, 3, 3))
    for axis in range(3):
        out[..., axis, axis, _FIRST[axis]] = first[..., axis] * _UNIT
        out[..., axis, axis, _SECOND[axis]] = second[..., axis] * _UNIT
    return out


def _product(truth: Truth, context: Context) -> Array:
    a, b = _both(truth)
    return np.asarray(np.eye(3) * (a * b * _UNIT)[..., None])


def _product_dx(truth: Truth, context: Context) -> Array:
    a, b = _both(truth)
    return _slopes(b, a)


def _squares(truth: Truth, context: Context) -> Array:
    a, b = _both(truth)
    return np.asarray(np.eye(3) * ((a**2 - b**2) * _UNIT)[..., None])


def _squares_dx(truth: Truth, context: Context) -> Array:
    a, b = _both(truth)
    return _slopes(2.0 * a, -2.0 * b)


def _three(name: str) -> tuple[Parameter, ...]:
    return tuple(Parameter(f"{name}_{axis}", "mg/g2", 3.0, 60.0) for axis in "xyz")


EFFECTS = (
    Response(
        "product_across",
        "The product of the two forces across an axis shows in its reading.",
        "y_i = x_i + C_i x_j x_k,  i, j, k in cyclic order",
        _SOURCE + " (K_po)",
        _IDENTIFY,
        each=_three("product_across"),
        basis=_product,
        basis_dx=_product_dx,
    ),
    Response(
        # Their sum is the square of the axis itself and a bias, wherever |x| is gravity's.
        "squares_across",
        "The squares of the two forces across an axis differ in what they add to its reading.",
        "y_i = x_i + D_i (x_j² - x_k²),  i, j, k in cyclic order",
        "second order as IEEE Std 1293's terms; no size in data sheets, taken as theirs",
        _IDENTIFY,
        part_of="cross_axis",
        each=_three("squares_across"),
        basis=_squares,
        basis_dx=_squares_dx,
    ),
)
