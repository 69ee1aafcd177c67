"""Axes of the bench that are not square: base tilted across, rotary axis not square."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Rotation
from imucalib.core.references import unit_vector


def _across(context: Context) -> tuple[Array, Array]:
    axis = -unit_vector(context["inclination"] + np.pi / 2.0, context["tool_face"])
    return axis, np.ones((context.n, 1))


def _rotary(context: Context) -> tuple[Array, Array]:
    t = context["tool_face"]
    axis = np.stack([np.sin(t), np.cos(t), np.zeros_like(t)], axis=-1)
    return axis, np.ones((context.n, 1))


EFFECTS = (
    Rotation(
        "base_tilt_across",
        "The base is tilted along the inclination axis, so that gravity has a part along it.",
        "x' = x cos e + g e_axis sin e, e_axis along the inclination axis",
        "0.1 deg, practice",
        "Sweep the tool-face at inclinations of both signs.",
        ("inclination", "tool_face"),
        named=(Parameter("base_tilt_across", "deg", 0.1, 5.0),),
        turns=(_across,),
    ),
    Rotation(
        "axis_non_orthogonality",
        "The rotary axis is not square to the inclination axis.",
        "x' = R(h about the direction square to both axes) x",
        "0.1 deg; a good stage 0.005 deg (NIST, Geist and Gaitan 2021)",
        "Sweep the tool-face at inclinations of both signs.",
        ("inclination", "tool_face"),
        named=(Parameter("axis_non_orthogonality", "deg", 0.1, 5.0),),
        turns=(_rotary,),
    ),
)
