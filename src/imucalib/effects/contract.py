"""Whether what a user's file offers are effects: checked when it is loaded, in words of the file.

The words of every effect are read, and it is run once on a few made-up observations, so that a
slip is named with its effect instead of ending in the middle of a fit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.core.effect import CLOCKS, Action, Context, Effect, Motion, Parameter, Truth
from imucalib.errors import UsageError
from imucalib.units import STANDARD_GRAVITY

_EXAMPLE = "docs/own_effect.md has an example"
_WORDS = ("name", "sentence", "equation", "source", "identify")
_STAGES = ("fixture", "mounting", "sensor")
_CHANNELS = ("acceleration", "angular_rate")
_ROWS = 5


def check_effects(offered: object, where: str) -> tuple[Effect, ...]:
    """The effects of a file's `EFFECTS`. Raises UsageError with the effect and what is wrong."""
    if not isinstance(offered, tuple | list):
        raise UsageError(
            f"EFFECTS is {_kind(offered)}, not a tuple of effects",
            where=where,
            remedy=f"write EFFECTS = (effect,) with the comma; {_EXAMPLE}",
        )
    if not offered:
        raise UsageError("no EFFECTS in it", where=where, remedy=f"define EFFECTS; {_EXAMPLE}")
    seen: set[str] = set()
    for number, effect in enumerate(offered, start=1):
        _check_words(effect, number, where)
        if effect.name in seen:
            raise UsageError(
                f"two effects are called '{effect.name}'", where=where, remedy="rename one"
            )
        seen.add(effect.name)
        _check_action(effect, where)
    return tuple(offered)


def _kind(value: object) -> str:
    name = type(value).__name__
    return f"an {name}" if name[0] in "aeiouAEIOU" else f"a {name}"


def _wrong(name: str, what: str, where: str, remedy: str = _EXAMPLE) -> UsageError:
    return UsageError(f"effect '{name}': {what}", where=where, remedy=remedy)


def _check_words(effect: Any, number: int, where: str) -> None:
    name = getattr(effect, "name", None)
    if isinstance(effect, type) or not isinstance(name, str) or not name:
        shown = f"the class {effect.__name__}" if isinstance(effect, type) else _kind(effect)
        raise UsageError(
            f"item {number} of EFFECTS is {shown}, not an effect with a name",
            where=where,
            remedy=f"make it with Response(...) or Rotation(...); {_EXAMPLE}",
        )
    for word in _WORDS:
        if not isinstance(getattr(effect, word, None), str):
            raise _wrong(name, f"its {word} is missing or no text", where)
    for field, allowed in (("stage", _STAGES), ("channel", _CHANNELS)):
        value = getattr(effect, field, None)
        if value not in allowed:
            remedy = f"use one of: {', '.join(allowed)}"
            raise _wrong(name, f"its {field} is {value!r}", where, remedy)
    needs = getattr(effect, "needs", None)
    if not isinstance(needs, tuple) or not all(isinstance(n, str) for n in needs):
        raise _wrong(name, "its needs are not a tuple of names", where, 'such as ("temperature",)')
    for method in ("parameters", "missing", "act"):
        if not callable(getattr(effect, method, None)):
            raise _wrong(name, f"it has no function {method}", where)


def _check_action(effect: Effect, where: str) -> None:
    """Run the effect at zero and at its typical size, on observations with what it needs."""
    spread = np.linspace(0.0, 1.0, _ROWS)
    known = dict.fromkeys((*CLOCKS, *effect.needs), spread) | {"sample_age": spread[:, None] - 0.5}
    context = Context(_ROWS, known, sweeps=2, moving=True)
    try:
        reason = effect.missing(context)
        parameters = effect.parameters(context)
        wrong = _parameters_wrong(parameters, reason)
        for size in (0.0, 1.0):
            if not wrong:
                theta = size * np.array([p.typical for p in parameters])
                wrong = _action_wrong(_act(effect, theta, context), theta)
    except Exception as error:  # the code is the user's: whatever it raises is theirs to mend
        what = f"it fails with {type(error).__name__}: {error}"
        raise _wrong(effect.name, what, where) from error
    if wrong:
        raise _wrong(effect.name, wrong, where)


def _act(effect: Effect, theta: Any, context: Context) -> object:
    """What the effect does to gravity in `_ROWS` directions."""
    force = np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1], [2, 1, -2], [-1, 2, 2]], dtype=float)
    force *= STANDARD_GRAVITY / np.linalg.norm(force, axis=1, keepdims=True)
    turning = np.roll(force, 1, axis=0)[:, None]
    truth = Truth(force[:, None], Motion(turning, 10.0 * turning, 5.0 * turning))
    return effect.act(theta, truth, context)


def _parameters_wrong(parameters: object, reason: object) -> str:
    if not isinstance(reason, str):
        return f"missing() gives {_kind(reason)}, not text"
    if not isinstance(parameters, tuple) or not all(isinstance(p, Parameter) for p in parameters):
        return "its parameters are not a tuple of Parameter"
    if not parameters:
        return "it has no parameters"
    for p in parameters:
        if not (np.isfinite(p.typical) and 0.0 < p.typical <= p.plausible):
            return f"parameter {p.name}: typical {p.typical} is not between 0 and plausible"
    names = [p.name for p in parameters]
    return "" if len(set(names)) == len(names) else "two parameters have the same name"


def _action_wrong(action: object, theta: Any) -> str:
    if not isinstance(action, Action):
        return f"act() gives {_kind(action)}, not an Action"
    p = theta.size
    shapes = {"delta": (_ROWS, 1, 3), "d_theta": (_ROWS, 1, 3, p), "d_x": (_ROWS, 1, 3, 3)}
    for part, shape in shapes.items():
        value = np.asarray(getattr(action, part))
        if value.shape != shape:
            return (
                f"{part} of its action has the shape {value.shape}, not {shape} "
                f"for {_ROWS} observations of one triad and {p} parameters"
            )
        if not np.isfinite(value).all():
            return f"{part} of its action is not finite"
    if not theta.any() and np.any(action.delta):
        return "it does something at parameters of zero"
    return ""
