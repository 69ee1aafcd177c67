"""The rotary (tool-face) axis of the bench: zero, eccentricity, backlash, zero per sweep."""

from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Rotation


def tool_face_axis(context: Context) -> Array:
    """(n, 3) unit vector about which a positive turn raises the tool-face that the dial shows: -z,
    where it runs from +y towards +x."""
    return np.asarray(context.sense("tool_face")[:, None] * np.array([0.0, 0.0, -1.0]))


def _about(weights: Callable[[Context], list[Array]]) -> Callable[[Context], tuple[Array, Array]]:
    return lambda context: (tool_face_axis(context), np.stack(weights(context), axis=-1))


def _harmonic(order: int) -> Callable[[Context], list[Array]]:
    return lambda c: [np.sin(order * c.dial("tool_face")), np.cos(order * c.dial("tool_face"))]


def _later_sweeps(context: Context) -> list[Array]:
    return [(context["sweep"] == sweep).astype(float) for sweep in range(1, context.sweeps)]


def _sweep_parameters(context: Context) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"tool_face_zero_sweep_{sweep + 1}", "deg", 0.3, 10.0)
        for sweep in range(1, context.sweeps)
    )


def _eccentricity(order: int, name: str, words: str) -> Rotation:
    return Rotation(
        name,
        words,
        f"t = t_dial + a sin {order}t_dial + b cos {order}t_dial".replace("1t", "t"),
        "0.06-0.11 deg for 25-100 µm on discs of 50-100 mm",
        "Turn the tool-face in equal steps over the full circle, twice.",
        ("tool_face",),
        named=(
            Parameter(f"{name}_sin", "deg", 0.1, 5.0),
            Parameter(f"{name}_cos", "deg", 0.1, 5.0),
        ),
        turns=(_about(_harmonic(order)),),
    )


EFFECTS = (
    Rotation(
        "tool_face_zero",
        "The tool-face dial has its zero in the wrong place.",
        "t = t_dial + d",
        "0.3 deg, practice",
        "Absorbed by the mounting of the sensor; an independent scribe-line measurement shows it.",
        ("tool_face",),
        named=(Parameter("tool_face_zero", "deg", 0.3, 10.0),),
        turns=(_about(lambda context: [np.ones(context.n)]),),
    ),
    Rotation(
        "tool_face_zero_per_sweep",
        "The tool-face zero moved where a new sweep began.",
        "t = t_dial + d_sweep, none in the first",
        "0.3 deg, practice",
        "Repeat a tool-face of the first sweep in the later ones.",
        ("tool_face", "sweep"),
        named=_sweep_parameters,
        turns=(_about(_later_sweeps),),
    ),
    _eccentricity(1, "tool_face_eccentricity", "The tool-face dial is centred beside its axis."),
    _eccentricity(
        2,
        "tool_face_ellipticity",
        "The tool-face error repeats twice a turn (oval disc, coupling).",
    ),
    Rotation(
        "tool_face_backlash",
        "The tool-face lags behind the dial, by the side from which it was approached.",
        "t = t_dial + b sign(approach)",
        "0.1 deg, practice",
        "Approach some settings from both sides.",
        ("tool_face", "tool_face_approach"),
        named=(Parameter("tool_face_backlash", "deg", 0.1, 5.0),),
        turns=(_about(lambda context: [context["tool_face_approach"]]),),
    ),
)
