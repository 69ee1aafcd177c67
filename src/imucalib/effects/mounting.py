"""Attitude of the sensor triad in the tool: a rotation, invisible to the norm of a reading."""

from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Rotation, Turn


def _still(context: Context) -> Array:
    return np.ones(context.n)


def _steadily(context: Context) -> Array:
    return context["order"] - 0.5


def turns_about(axes: str, share: Callable[[Context], Array]) -> tuple[Turn, ...]:
    """Turns about axes of the tool in their order, of each its own angle times a share (n,)."""

    def turn(axis: str, own: Array) -> Turn:
        along = np.eye(3)["xyz".index(axis)]
        return lambda context: (
            np.broadcast_to(along, (context.n, 3)),
            share(context)[:, None] * own,
        )

    return tuple(turn(axis, own) for axis, own in zip(axes, np.eye(len(axes)), strict=True))


EFFECTS = (
    Rotation(
        "mounting",
        "The sensor triad is turned in the tool; turns about x, then y, then z.",
        "x' = Rz(m_z) Ry(m_y) Rx(m_x) x",
        "paper 004 eq. (3): the three parameters that the full M has beyond eq. (4)",
        "Needs directions that are known in the tool's frame; gravity alone cannot show it.",
        named=tuple(Parameter(f"mounting_{a}", "deg", 2.0, 200.0) for a in "xyz"),
        turns=turns_about("xyz", _still),
        stage="mounting",
    ),
    Rotation(
        "clamp_creep",
        "The tool turns steadily in its clamp; turns about x, then y, then z.",
        "x' = Rz(c_z s) Ry(c_y s) Rx(c_x s) x,  s = order - 1/2, order from 0 to 1",
        "0.1-1 deg where a clamp is soft or a bench settles, practice",
        "Return to the first positions at the end.",
        ("order", "tool_face"),
        named=tuple(Parameter(f"clamp_creep_{a}", "deg", 0.3, 20.0) for a in "xyz"),
        turns=turns_about("xyz", _steadily),
    ),
)
