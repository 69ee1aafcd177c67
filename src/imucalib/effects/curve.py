"""A smooth curve where structure was found that no effect explains: a correction without a name.

Never a name for a cause. It stands over the range that was recorded; beyond that range it keeps its
value at the edge.
"""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Effect, Family
from imucalib.effects.bent import KINDS, Form, Words, bent

_REACH = 1.06  # g, of an axis' own input


def curve(value: str) -> Effect:
    """The curve "what:against:low:high:terms", for example "bias:order:0:1:6" or
    "response:xyz:-1:1:8"; ValueError otherwise."""
    what, against, *rest = value.split(":")
    if what not in KINDS or len(rest) != 3:
        raise ValueError(f"'{value}' is no curve")
    low, high, terms = float(rest[0]), float(rest[1]), int(rest[2])
    around = against == "tool_face"  # a response has axes there
    terms += terms % 2 if around else 0
    words = Words(
        f"curve@{value}",
        f"{KINDS[what]} against {against.replace('_', ' ')}: a smooth curve without a name.",
        "y_i = x_i + Σ_k a_k sin(k t) + b_k cos(k t)"
        if around
        else "y_i = x_i + Σ_k c_k cos(k π u),  u from 0 to 1 over the range",
        "what was found in the data themselves",
        f"Record with {against.replace('_', ' ')} varied on its own, and find the cause.",
        "curve",
    )
    if what == "response":
        return bent(words, what, against, _of_input(terms))
    return bent(words, what, against, _of_covariate(against, low, high, terms))


def _of_input(terms: int) -> Form:
    order = np.arange(2, terms + 2)

    def phase(u: Array) -> Array:
        return np.asarray(0.5 * np.pi * order * (u[..., None] / _REACH + 1.0))

    def slope(u: Array) -> Array:
        return np.asarray(-np.sin(phase(u)) * 0.5 * np.pi * order / _REACH)

    return Form(lambda u: np.asarray(np.cos(phase(u))), slope, tuple(str(k) for k in order))


def _of_covariate(name: str, low: float, high: float, terms: int) -> Form:
    def values(v: Array) -> Array:
        if name == "tool_face":  # periodic
            k = np.arange(1, terms // 2 + 1) * v[:, None]
            return np.concatenate([np.sin(k), np.cos(k)], axis=1)
        unit = np.clip((v - low) / (high - low), 0.0, 1.0)
        return np.asarray(np.cos(np.pi * np.arange(1, terms + 1) * unit[..., None]))

    labels = tuple(str(k) for k in range(terms))
    if name == "time":  # what drifts without end is the smaller the quicker
        return Form(values, values, labels, tuple(1.0 / k for k in range(1, terms + 1)))
    return Form(values, values, labels)


FAMILIES = (
    Family(
        "curve",
        "A smooth correction of structure that no effect explains.",
        "bias:temperature:20:30:4",
        curve,
        lambda context: (),
        free=True,
    ),
)
