"""What the forces across an axis add to its reading, beside their products with its own: to second
degree by name, and to third as whatever all three forces make of it."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Effect, Family, Parameter, Response, Truth
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

PREFIX = "third_degree@"
#: Positions from which on seven numbers of one axis are sought.
_FEWEST = 24


def _thirds(x: Array) -> Array:
    """(..., 7) harmonic products of third degree of forces (..., 3) in g, all of one size."""
    square = x**2
    own = 0.5 * x * (2.0 * square - 3.0 * (square[..., _FIRST] + square[..., _SECOND]))
    between = 0.5 * np.sqrt(15.0) * x * (square[..., _FIRST] - square[..., _SECOND])
    product = np.sqrt(15.0) * np.prod(x, axis=-1, keepdims=True)
    return np.concatenate([own, between, product], axis=-1)


def _third_slopes(x: Array) -> Array:
    """(..., 7, 3) of the same."""
    out = np.zeros((*x.shape[:-1], 7, 3))
    root, square = 0.5 * np.sqrt(15.0), x**2
    for axis, one, two in zip(range(3), _FIRST, _SECOND, strict=True):
        out[..., axis, axis] = 3.0 * square[..., axis] - 1.5 * (square[..., one] + square[..., two])
        out[..., axis, one] = -3.0 * x[..., axis] * x[..., one]
        out[..., axis, two] = -3.0 * x[..., axis] * x[..., two]
        out[..., 3 + axis, axis] = root * (square[..., one] - square[..., two])
        out[..., 3 + axis, one] = 2.0 * root * x[..., axis] * x[..., one]
        out[..., 3 + axis, two] = -2.0 * root * x[..., axis] * x[..., two]
        out[..., 6, axis] = 2.0 * root * x[..., one] * x[..., two]
    return out


def third_degree(letter: str) -> Effect:
    """Of the axis "x", "y" or "z"; ValueError otherwise."""
    if letter not in tuple("xyz"):
        raise ValueError(f"'{letter}' is no axis")
    axis = "xyz".index(letter)

    def basis(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, 7))
        out[..., axis, :] = MG * _thirds(truth.force / STANDARD_GRAVITY)
        return out

    def basis_dx(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, 7, 3))
        out[..., axis, :, :] = _third_slopes(truth.force / STANDARD_GRAVITY)
        return out * MG / STANDARD_GRAVITY

    return Response(
        f"{PREFIX}{letter}",
        f"The reading of {letter} depends on all three forces to third degree.",
        "y_i = x_i + Σ_k c_k P_k(x),  P_k = x(2x² - 3y² - 3z²)/2 and √15 x(y² - z²)/2, each in "
        "cyclic order, and √15 xyz",
        "no size in data sheets, taken as the second degree's",
        _IDENTIFY,
        each=tuple(Parameter(f"third_{letter}_{k + 1}", "mg/g3", 3.0, 60.0) for k in range(7)),
        basis=basis,
        basis_dx=basis_dx,
    )


def _axes(context: Context) -> tuple[str, ...]:
    """Where directions are known: of the size of gravity a form tells as much."""
    return tuple("xyz") if "inclination" in context and context.n >= _FEWEST else ()


FAMILIES = (
    Family(
        "third_degree",
        "The reading of an axis depends on all three forces to third degree.",
        "z",
        third_degree,
        _axes,
        unfounded=True,
    ),
)
