"""Polynomials of the forces on several axes: what the forces across an axis add to its reading, to
second degree by name, and to third as whatever all three forces make of it."""

from collections.abc import Iterable
from math import sqrt

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Effect, Response, Truth
from imucalib.effects.parts import entries, scan, sizes, words
from imucalib.units import MG, STANDARD_GRAVITY

#: Of each axis those across it, in cyclic order.
_CYCLIC = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
#: Sum of monomials: (coefficient, exponents of the forces on x, y and z in g).
Polynomial = tuple[tuple[float, tuple[int, int, int]], ...]
#: Positions from which on seven numbers of one axis are sought.
_FEWEST = 24
_ROOT = sqrt(15.0)


def monomial(*axes: int) -> tuple[int, int, int]:
    """Exponents of the product of the forces on some axes, which may come several times."""
    return axes.count(0), axes.count(1), axes.count(2)


def polynomial(
    key: str,
    columns: tuple[tuple[int, Polynomial], ...],
    labels: Iterable[str],
    value: str = "",
    **given: object,
) -> Response:
    """The response that adds polynomials to readings, mg of each.

    columns : (axis that reads, what it reads), one a parameter; labels : of these; key, value,
        given : as `words` takes them
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

    return Response(
        *words(key, value, **given),
        each=sizes(key, labels, value),
        basis=basis,
        basis_dx=basis_dx,
        part_of=entries()[key].get("part_of", ""),
    )


EFFECTS = (
    polynomial(
        "product_across", tuple((i, ((1.0, monomial(j, k)),)) for i, j, k in _CYCLIC), "xyz"
    ),
    # Their sum is the square of the axis itself and a bias, wherever |x| is gravity's.
    polynomial(
        "squares_across",
        tuple((i, ((1.0, monomial(j, j)), (-1.0, monomial(k, k)))) for i, j, k in _CYCLIC),
        "xyz",
    ),
)

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
    columns = tuple(("xyz".index(letter), one) for one in _THIRD)
    return polynomial("third_degree@", columns, "1234567", letter, letter=letter)


def _axes(context: Context) -> tuple[str, ...]:
    """Where directions are known: of the size of gravity a form tells as much."""
    return tuple("xyz") if "inclination" in context and context.n >= _FEWEST else ()


FAMILIES = (scan("third_degree", third_degree, _axes, unfounded=True),)
