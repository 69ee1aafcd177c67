"""Angles between the sensing axes: the lower triangle, so that x keeps its direction."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.core.effect import Response
from imucalib.core.parameter import Parameter
from imucalib.core.truth import Truth

#: (axis that reads, axis that leaks in): y sees x, z sees x, z sees y.
_PAIRS = ((1, 0), (2, 0), (2, 1))


def _basis(truth: Truth, context: Context) -> Array:
    out = np.zeros((*truth.shape, 3))
    for column, (reads, leaks) in enumerate(_PAIRS):
        out[..., reads, column] = truth.force[..., leaks]
    return out


def _basis_dx(truth: Truth, context: Context) -> Array:
    out = np.zeros((*truth.shape, 3, 3))
    for column, (reads, leaks) in enumerate(_PAIRS):
        out[..., reads, column, leaks] = 1.0
    return out


EFFECTS = (
    Response(
        "non_orthogonality",
        "The three sensing axes are not at right angles: y sees some x, z sees some x and y.",
        "y_y = x_y + k_yx x_x;  y_z = x_z + k_zx x_x + k_zy x_y",
        "paper 002 eq. (1), K lower triangular; paper 004 eq. (4) by angles",
        "Hold the sensor in directions between its axes, in all octants.",
        each=tuple(Parameter(f"cross_{'xyz'[r]}{'xyz'[s]}", "1", 0.02, 0.3) for r, s in _PAIRS),
        basis=_basis,
        basis_dx=_basis_dx,
    ),
)
