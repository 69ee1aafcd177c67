"""Forms that a curve without a name may turn out to have: a formula, though no cause.

Of a driver u: an axis' own input in g, or a covariate (angles in degrees). Each form has up to
three numbers that a search scans or takes from the range; its size is fitted.
"""

import re
from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Effect, Family
from imucalib.effects.bent import KINDS, Form, Words, bent

Pair = tuple[Callable[[Array], Array], Callable[[Array], Array]]


def _sine(period: float) -> Pair:
    k = 2.0 * np.pi / period
    return (
        lambda u: np.stack([np.sin(k * u), np.cos(k * u)], axis=-1),
        lambda u: k * np.stack([np.cos(k * u), -np.sin(k * u)], axis=-1),
    )


def _power(order: float, middle: float, reach: float) -> Pair:
    n = int(order)
    return (
        lambda u: (((u - middle) / reach) ** n)[..., None],
        lambda u: (n / reach * ((u - middle) / reach) ** (n - 1))[..., None],
    )


def _odd_power(order: float) -> Pair:
    return (
        lambda u: (np.sign(u) * np.abs(u) ** order)[..., None],
        lambda u: (order * np.abs(u) ** (order - 1.0))[..., None],
    )


def _even_power(order: float) -> Pair:
    return (
        lambda u: (np.abs(u) ** order)[..., None],
        lambda u: (order * np.sign(u) * np.abs(u) ** (order - 1.0))[..., None],
    )


def _kink(at: float) -> Pair:
    return lambda u: np.abs(u - at)[..., None], lambda u: np.sign(u - at)[..., None]


def _step(at: float) -> Pair:
    return lambda u: (u >= at).astype(float)[..., None], lambda u: np.zeros((*u.shape, 1))


def _beyond(u: Array, at: float) -> Array:
    """0 up to a limit and 1 at 1 g."""
    return np.maximum(np.abs(u) - at, 0.0) / (1.0 - at)


def _saturation(at: float) -> Pair:
    return (
        lambda u: (np.sign(u) * _beyond(u, at))[..., None],
        lambda u: ((np.abs(u) > at) / (1.0 - at))[..., None],
    )


def _soft_saturation(at: float) -> Pair:
    return (
        lambda u: (np.sign(u) * _beyond(u, at) ** 2)[..., None],
        lambda u: (2.0 / (1.0 - at) * _beyond(u, at))[..., None],
    )


def _saw_tooth(period: float, phase: float) -> Pair:
    return (
        lambda u: (np.mod(u / period + phase, 1.0) - 0.5)[..., None],
        lambda u: np.full((*u.shape, 1), 1.0 / period),
    )


def _exponential(scale: float, start: float) -> Pair:
    return (
        lambda u: np.exp(-(u - start) / scale)[..., None],
        lambda u: (-np.exp(-(u - start) / scale) / scale)[..., None],
    )


#: kind -> the form of its scanned numbers, the equation, and how many terms it has.
FORMS: dict[str, tuple[Callable[..., Pair], str, int]] = {
    "sine": (_sine, "a sin(2π u / P) + b cos(2π u / P), P = {0}", 2),
    "power": (_power, "a ((u - {1}) / {2})^{0}", 1),
    "odd_power": (_odd_power, "a sign(u) |u|^{0}", 1),
    "even_power": (_even_power, "a |u|^{0}", 1),
    "kink": (_kink, "a |u - {0}|", 1),
    "step": (_step, "a [u >= {0}]", 1),
    "saturation": (_saturation, "a sign(u) max(|u| - {0}, 0) / (1 - {0})", 1),
    "soft_saturation": (_soft_saturation, "a sign(u) max(|u| - {0}, 0)² / (1 - {0})²", 1),
    "saw_tooth": (_saw_tooth, "a ((u / {0} + {1}) mod 1 - 1/2)", 1),
    "exponential": (_exponential, "a exp(-(u - {1}) / {0})", 1),
}
_ANGLES = ("tool_face", "inclination")


def shape(value: str) -> Effect:
    """The form "what:against:kind:number[:number ...]", for example "response:xyz:sine:0.4" or
    "tool_face:tool_face:sine:120"; ValueError otherwise."""
    what, against, kind, *rest = value.split(":")
    if what not in KINDS or kind not in FORMS:
        raise ValueError(f"'{value}' is no form")
    make, equation, terms = FORMS[kind]
    numbers = [float(r) for r in rest]
    try:
        values, slope = make(*numbers)
    except TypeError:
        raise ValueError(f"{kind} does not take {len(rest)} numbers") from None
    unit = 180.0 / np.pi if what != "response" and against in _ANGLES else 1.0
    driver = against.replace("_", " ")
    words = Words(
        f"shape@{value}",
        f"{KINDS[what]} against {driver}: {kind.replace('_', ' ')}.",
        f"y = x + f(u), u = {driver}: f = " + equation.format(*rest),
        "the form that the data themselves have, without a cause",
        f"Record with {driver} varied finely, and find what repeats so.",
        f"{kind}_{'_'.join(rest)}".replace("-", "m").replace(".", "p"),
    )
    form = Form(
        lambda u: values(u * unit),
        lambda u: unit * slope(u * unit),
        tuple("ab"[:terms]) if terms > 1 else ("",),
    )
    return bent(words, what, against, form)


def is_form(name: str) -> bool:
    """Whether an effect's name is that of a form."""
    return name.startswith("shape@")


#: Between a word and its number, a number and its unit: record17, 12min, 2C.
_UNIT = re.compile(r"(?<=^record)(?=\d)|(?<=\d)(?=[A-Za-z]+$)")


def in_words(name: str) -> str:
    """An effect's name for a reader: of a form or a curve its kind and what it bends, and of what
    follows a column both, without their numbers; of another scan its value in words."""
    family, _, value = name.partition("@")
    what, against, kind, *_ = (*value.split(":"), "", "")
    if family == "follows":
        return f"{what} follows {against}"
    kind = "curve" if family == "curve" else kind.replace("_", " ")
    if what not in KINDS or not kind:
        parts = (_UNIT.sub(" ", part).replace(" C", " °C") for part in value.split(":"))
        return ", ".join([family.replace("_", " "), *(part for part in parts if part)])
    article = "an" if kind[0] in "aeiou" else "a"
    driver = f" against {against.replace('_', ' ')}"
    if what == "response":
        driver = f" of {against}" if len(against) == 1 else ""
    return f"{article} {kind} of the {KINDS[what]}{driver}"


FAMILIES = (
    Family(
        "shape",
        "A form with a formula, without a cause.",
        "response:xyz:sine:0.5",
        shape,
        lambda context: (),
        unfounded=True,
        free=True,
    ),
)
