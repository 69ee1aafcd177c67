"""Attitude of the sensor triad in the tool: a rotation, invisible to the norm of a reading."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.core.effect import Rotation, Turn
from imucalib.core.parameter import Parameter


def _turn(axis: int) -> Turn:
    def turn(context: Context) -> tuple[Array, Array]:
        weight = np.zeros((context.n, 3))
        weight[:, axis] = 1.0
        return np.broadcast_to(np.eye(3)[axis], (context.n, 3)), weight

    return turn


EFFECTS = (
    Rotation(
        "mounting",
        "The sensor triad is turned in the tool; turns about x, then y, then z.",
        "x' = Rz(m_z) Ry(m_y) Rx(m_x) x",
        "paper 004 eq. (3): the three parameters that the full M has beyond eq. (4)",
        "Needs directions that are known in the tool's frame; gravity alone cannot show it.",
        named=tuple(Parameter(f"mounting_{a}", "deg", 2.0, 200.0) for a in "xyz"),
        turns=(_turn(0), _turn(1), _turn(2)),
        stage="mounting",
    ),
)
