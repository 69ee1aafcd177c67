"""The inclination axis of the bench: zero, gain, sag, eccentricity, wobble, backlash.

All turn the truth about the inclination axis, which lies at (cos t, -sin t, 0) in the tool's frame
at tool-face t, whatever the inclination: turns of one axis commute, so they add. i_dial and t_dial
count as the bench's dials do; a positive error is one towards a larger reading of the dial.
"""

from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Rotation


def inclination_axis(context: Context) -> Array:
    """(n, 3) unit vector about which a positive turn raises the inclination that the dial shows."""
    t = context["tool_face"]
    axis = np.stack([np.cos(t), -np.sin(t), np.zeros_like(t)], axis=-1)
    return np.asarray(context.sense("inclination")[:, None] * axis)


def about(*weights: Callable[[Context], Array]) -> Callable[[Context], tuple[Array, Array]]:
    """A turn about the inclination axis, of each parameter its weight (n,)."""
    return lambda context: (
        inclination_axis(context),
        np.stack([weight(context) for weight in weights], axis=-1),
    )


def _ones(context: Context) -> Array:
    return np.ones(context.n)


EFFECTS = (
    Rotation(
        "inclination_zero",
        "The bench's inclination dial has its zero in the wrong place, or its base is tilted.",
        "i = i_dial + d",
        "0.1 deg, practice; 1.4 deg on the table of paper 004",
        "Set inclinations of both signs; a spirit level on the base tells the two causes apart.",
        ("inclination", "tool_face"),
        named=(Parameter("inclination_zero", "deg", 0.5, 10.0),),
        turns=(about(_ones),),
    ),
    Rotation(
        "inclination_scale",
        "The inclination dial turns too far or not far enough, in proportion to the angle.",
        "i = i_dial + k i_dial / 90 deg",
        "1 deg over a quarter turn, practice",
        "Set inclinations over a half turn, both signs.",
        ("inclination", "tool_face"),
        named=(Parameter("inclination_scale", "deg per 90 deg", 0.5, 10.0),),
        turns=(about(lambda context: context.dial("inclination") / (np.pi / 2.0)),),
    ),
    Rotation(
        "inclination_sag",
        "The tool or its holder bends under its weight, most where it lies level.",
        "i = i_dial + s cos i",
        "sag of assemblies in boreholes, ISCWSA; 0.1 deg on a bench, practice",
        "Support the tool near its sensor, and compare.",
        ("inclination", "tool_face"),
        named=(Parameter("inclination_sag", "deg", 0.1, 5.0),),
        turns=(about(lambda context: np.cos(context["inclination"])),),
    ),
    Rotation(
        "inclination_eccentricity",
        "The inclination dial is centred beside its axis.",
        "i = i_dial + a sin i_dial + b (1 - cos i_dial)",
        "0.06-0.11 deg for 25-100 µm on discs of 50-100 mm",
        "Set inclinations over a full turn.",
        ("inclination", "tool_face"),
        named=(
            Parameter("inclination_eccentricity_sin", "deg", 0.1, 5.0),
            Parameter("inclination_eccentricity_cos", "deg", 0.1, 5.0),
        ),
        turns=(
            about(
                lambda context: np.sin(context.dial("inclination")),
                lambda context: 1.0 - np.cos(context.dial("inclination")),
            ),
        ),
    ),
    Rotation(
        "inclination_wobble",
        "The rotary axis wobbles: the tool tips up and down once a turn.",
        "i = i_dial + a sin t_dial + b cos t_dial",
        "0.06-0.11 deg for 50-100 µm on a seat of 50 mm",
        "Turn the tool-face in equal steps over the full circle at three inclinations.",
        ("inclination", "tool_face"),
        named=(
            Parameter("inclination_wobble_sin", "deg", 0.1, 5.0),
            Parameter("inclination_wobble_cos", "deg", 0.1, 5.0),
        ),
        turns=(
            about(
                lambda context: np.sin(context.dial("tool_face")),
                lambda context: np.cos(context.dial("tool_face")),
            ),
        ),
    ),
    Rotation(
        "inclination_backlash",
        "The inclination lags behind the dial, by the side from which it was approached.",
        "i = i_dial + b sign(approach)",
        "0.1 deg, practice",
        "Approach some settings from above and from below.",
        ("inclination", "tool_face", "inclination_approach"),
        named=(Parameter("inclination_backlash", "deg", 0.1, 5.0),),
        turns=(about(lambda context: context["inclination_approach"]),),
    ),
)
