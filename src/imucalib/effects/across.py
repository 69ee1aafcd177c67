"""Polynomials of the forces on several axes: what the forces across an axis add to its reading, to
second degree by name, and to third as whatever all three forces make of it."""

from math import sqrt

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Effect, Family, Parameter, Response, Truth, three
from imucalib.units import MG, STANDARD_GRAVITY

IEEE_1293 = "IEEE Std 1293 model equation; 0.1-0.5 % of full scale in MEMS data sheets"
OCTANTS = "Hold directions between the axes in all octants."
#: Of each axis those across it, in cyclic order.
_CYCLIC = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
#: Sum of monomials: (coefficient, exponents of the forces on x, y and z in g).
Polynomial = tuple[tuple[float, tuple[int, int, int]], ...]


def monomial(*axes: int) -> tuple[int, int, int]:
    """Exponents of the product of the forces on some axes, which may come several times."""
    return axes.count(0), axes.count(1), axes.count(2)


def polynomial(
    words: tuple[str, str, str, str, str],
    columns: tuple[tuple[int, Polynomial], ...],
    each: tuple[Parameter, ...],
    part_of: str = "",
) -> Response:
    """The response that adds polynomials to readings, mg of each.

    words : as `Described` has them; columns : (axis that reads, what it reads), one a parameter
    """

    def basis(truth: Truth, context: Context) -> Array:
        x, out = truth.force / STANDARD_GRAVITY, np.zeros((*truth.shape, len(columns)))
        for k, (reads, terms) in enumerate(columns):
            out[..., reads, k] = sum(MG * c * np.prod(x**powers, axis=-1) for c, powers in terms)
        return out

    def basis_dx(truth: Truth, context: Context) -> Array:
        x, out = truth.force / STANDARD_GRAVITY, np.zeros((*truth.shape, len(columns), 3))
        for k, (reads, terms) in enumerate(columns):
            for c, powers in terms:
                for axis in np.flatnonzero(powers):
                    lower = np.subtract(powers, np.eye(3, dtype=int)[axis])
                    size = MG / STANDARD_GRAVITY * c * powers[axis]
                    out[..., reads, k, axis] += size * np.prod(x**lower, axis=-1)
        return out

    return Response(*words, each=each, basis=basis, basis_dx=basis_dx, part_of=part_of)


EFFECTS = (
    polynomial(
        (
            "product_across",
            "The product of the two forces across an axis shows in its reading.",
            "y_i = x_i + C_i x_j x_k,  i, j, k in cyclic order",
            f"{IEEE_1293} (K_po)",
            OCTANTS,
        ),
        tuple((i, ((1.0, monomial(j, k)),)) for i, j, k in _CYCLIC),
        three("product_across", "mg/g2", 3.0, 60.0),
    ),
    polynomial(
        (
            # Their sum is the square of the axis itself and a bias, wherever |x| is gravity's.
            "squares_across",
            "The squares of the two forces across an axis differ in what they add to its reading.",
            "y_i = x_i + D_i (x_j² - x_k²),  i, j, k in cyclic order",
            "second order as IEEE Std 1293's terms; no size in data sheets, taken as theirs",
            OCTANTS,
        ),
        tuple((i, ((1.0, monomial(j, j)), (-1.0, monomial(k, k)))) for i, j, k in _CYCLIC),
        three("squares_across", "mg/g2", 3.0, 60.0),
        part_of="cross_axis",
    ),
)

#: Positions from which on seven numbers of one axis are sought.
_FEWEST = 24
_ROOT = sqrt(15.0)
#: Harmonic products of third degree, all of one size.
_THIRD: tuple[Polynomial, ...] = (
    *(
        ((1.0, monomial(i, i, i)), (-1.5, monomial(i, j, j)), (-1.5, monomial(i, k, k)))
        for i, j, k in _CYCLIC
    ),
    *(((0.5 * _ROOT, monomial(i, j, j)), (-0.5 * _ROOT, monomial(i, k, k))) for i, j, k in _CYCLIC),
    ((_ROOT, (1, 1, 1)),),
)


def third_degree(letter: str) -> Effect:
    """Of the axis "x", "y" or "z"; ValueError otherwise."""
    if letter not in tuple("xyz"):
        raise ValueError(f"'{letter}' is no axis")
    words = (
        f"third_degree@{letter}",
        f"The reading of {letter} depends on all three forces to third degree.",
        "y_i = x_i + Σ_k c_k P_k(x),  P_k = x(2x² - 3y² - 3z²)/2 and √15 x(y² - z²)/2, each in "
        "cyclic order, and √15 xyz",
        "no size in data sheets, taken as the second degree's",
        OCTANTS,
    )
    each = tuple(Parameter(f"third_{letter}_{k + 1}", "mg/g3", 3.0, 60.0) for k in range(7))
    return polynomial(words, tuple(("xyz".index(letter), one) for one in _THIRD), each)


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
