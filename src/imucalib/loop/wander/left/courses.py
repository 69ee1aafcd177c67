"""Parts of the base model that jump, or follow the temperature or the time, in a way of their own.

A search knows straight lines, and of the bias a step and a curve of the temperature. A square of
the temperature in the scale, a bent drift of it, or a jump of the angles between the axes is none
of its candidates: the walk, which is of the bias and of a common scale, takes some of it over, and
the rest passes for scatter.
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.effects.bent import KINDS
from imucalib.loop.wander.beside.courses import waves
from imucalib.loop.wander.beside.parts import driven
from imucalib.loop.wander.choice import Search
from imucalib.loop.wander.left.strongest import Way
from imucalib.loop.wander.left.swing import even_parts
from imucalib.loop.wander.problem import Problem

#: Parts of the recording between which one may jump; waves of a course, rougher ones smaller, and
#: of one that corrects.
_JUMPS, _TERMS, FINE = 24, 4, 24
#: What each part of the base model is in words. A bias that moves with time is what wanders.
_WORDS = {"bias": "bias", "scale": "scale", "axes": "angle between the axes"}
_IN_TIME = ("scale", "axes")


def courses(problem: Problem, found: Search) -> list[Way]:
    """Of every part beside all that was taken."""
    parts, time = even_parts(problem, found), found.bank.course.time
    ways = _jumps(parts, time)
    for word in _IN_TIME:
        if word in parts:
            drive, words = driven(parts[word], waves(time, _TERMS)), f"the {_WORDS[word]} moves"
            by = curve_of(word, "time", time, FINE)
            ways.append(Way(f"{words} with time", "time", "course", drive, effect=by))
    context = problem.small.observations.context
    if "temperature" in context:
        warm = context["temperature"]
        drives = waves(warm, _TERMS)
        for word, columns in parts.items():
            words = f"the {_WORDS[word]} follows the temperature in a way of its own"
            own, by = driven(columns, drives), curve_of(word, "temperature", warm, _TERMS)
            ways.append(Way(words, "temperature", "course", own, effect=by))
    return ways


def curve_of(word: str, driver: str, values: Array, terms: int) -> str:
    """The name of the curve that corrects it; empty for angles, which none bends."""
    if word not in KINDS:
        return ""
    return f"curve@{word}:{driver}:{values.min():.10g}:{values.max():.10g}:{terms}"


def _jumps(parts: dict[str, Array], time: Array) -> list[Way]:
    ways = list[Way]()
    for at in np.quantile(time, np.arange(1, _JUMPS) / _JUMPS):
        late = np.where(time >= at, 1.0, 0.0)[:, None]
        where = f"jumps {at / 3600.0:.2g} h after the start"
        own = {word: driven(parts[word], late) for word in _IN_TIME if word in parts}
        for word, columns in own.items():
            by = f"shape@{word}:time:step:{at:.10g}" if word in KINDS else ""
            ways.append(Way(f"the {_WORDS[word]} {where}", "time", "jump", columns, effect=by))
        if len(own) == len(_IN_TIME) and "bias" in parts:
            bias = driven(parts["bias"], late)
            every = np.column_stack([bias, *own.values()])
            ways.append(Way(f"more than the bias {where}", "time", "jump", every, bias))
    return ways
