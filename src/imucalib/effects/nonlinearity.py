"""Non-linear response: squares, cubes, asymmetry and products of two axes."""

from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Basis, Context, Parameter, Response, Truth
from imucalib.units import MG, STANDARD_GRAVITY

_SOURCE = "IEEE Std 1293 model equation; 0.1-0.5 % of full scale in MEMS data sheets"
_G = STANDARD_GRAVITY


def _own_axis(
    curve: Callable[[Array], Array], slope: Callable[[Array], Array]
) -> tuple[Basis, Basis]:
    """Basis and derivative of a curve of each axis' own input in g, in mg."""

    def basis(truth: Truth, context: Context) -> Array:
        return np.asarray(np.eye(3) * curve(truth.force / _G)[..., None] * MG)

    def basis_dx(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, 3, 3))
        for axis in range(3):
            out[..., axis, axis, axis] = slope(truth.force[..., axis] / _G) * MG / _G
        return out

    return basis, basis_dx


#: (axis that reads, axis that multiplies it): K_ip and K_io of IEEE Std 1293.
_PRODUCTS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))


def _products(truth: Truth, context: Context) -> Array:
    out = np.zeros((*truth.shape, 6))
    for column, (reads, other) in enumerate(_PRODUCTS):
        out[..., reads, column] = truth.force[..., reads] * truth.force[..., other] * MG / _G**2
    return out


def _products_dx(truth: Truth, context: Context) -> Array:
    out = np.zeros((*truth.shape, 6, 3))
    for column, (reads, other) in enumerate(_PRODUCTS):
        out[..., reads, column, reads] = truth.force[..., other] * MG / _G**2
        out[..., reads, column, other] = truth.force[..., reads] * MG / _G**2
    return out


def _three(name: str, unit: str, typical: float) -> tuple[Parameter, ...]:
    return tuple(Parameter(f"{name}_{a}", unit, typical, 20.0 * typical) for a in "xyz")


def _effect(
    name: str, sentence: str, equation: str, unit: str, typical: float, pair: tuple[Basis, Basis]
) -> Response:
    identify = "Tilt finely between the axes, both signs of gravity on each axis."
    each = _three(name, unit, typical)
    return Response(
        name, sentence, equation, _SOURCE, identify, each=each, basis=pair[0], basis_dx=pair[1]
    )


EFFECTS = (
    _effect(
        "quadratic",
        "The response has a square term.",
        "y_i = x_i + K2_i x_i²",
        "mg/g2",
        3.0,
        _own_axis(np.square, lambda x: 2.0 * x),
    ),
    _effect(
        "cubic",
        "The response has a cubic term.",
        "y_i = x_i + K3_i x_i³",
        "mg/g3",
        3.0,
        _own_axis(lambda x: x**3, lambda x: 3.0 * x**2),
    ),
    _effect(
        "asymmetry",
        "The scale differs between the positive and the negative half of an axis.",
        "y_i = x_i + k_i |x_i|",
        "mg/g",
        2.0,
        _own_axis(np.abs, np.sign),
    ),
    Response(
        "cross_axis",
        "The scale of an axis depends on the force across it.",
        "y_i = x_i + Σ_j K_ij x_i x_j,  j ≠ i",
        _SOURCE + " (K_ip, K_io)",
        "Hold directions between the axes in all octants.",
        each=tuple(
            Parameter(f"cross_axis_{'xyz'[i]}{'xyz'[j]}", "mg/g2", 3.0, 60.0) for i, j in _PRODUCTS
        ),
        basis=_products,
        basis_dx=_products_dx,
    ),
)
