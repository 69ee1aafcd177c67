"""A bias that jumps at an unknown time: a knock, a changed battery, a restart."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.core.effect import Effect, Family, Response
from imucalib.core.parameter import Parameter
from imucalib.effects.covariate import bias_with

_SCANNED = 48  # times tried at first; the neighbours of the best one are tried after
_FEWEST = 12  # observations on each side of a step
_FEWEST_RECORDS = 6  # of a table, whose rows know their direction


def bias_step(value: str) -> Effect:
    """The step at a time such as "86400s" after the recording's start, or from a record of a table
    on, "record17" (counted from 1); ValueError otherwise."""
    if value.startswith("record"):
        first = int(value.removeprefix("record"))
        return _step(value, f"The bias jumps before record {first}.", "record", first - 1)
    at = float(value.removesuffix("s"))
    return _step(value, f"The bias jumps {at / 3600.0:.2f} h after the start.", "time", at)


def _step(value: str, sentence: str, clock: str, at: float) -> Effect:
    return Response(
        f"bias_step@{value}",
        sentence,
        f"y_i = x_i + d_i [{clock} >= t0]",
        "1-20 mg after a knock or a restart, practice",
        "Record varied attitudes on both sides of the jump.",
        (clock,),
        each=tuple(Parameter(f"step_{value}_{a}", "mg", 2.0, 300.0) for a in "xyz"),
        basis=bias_with(lambda context: (context[clock] >= at).astype(float)),
    )


def _text(time: float) -> str:
    return f"{time:.10g}s"


def _between(context: Context) -> Array:
    """Times between neighbouring observations, far enough from both ends."""
    time = np.unique(context["time"]) if "time" in context else np.zeros(0)
    if time.size <= 2 * _FEWEST:
        return np.zeros(0)
    return np.asarray(np.round(0.5 * (time[1:] + time[:-1]), 3)[_FEWEST - 1 : -_FEWEST + 1])


def _values(context: Context) -> tuple[str, ...]:
    every = _between(context)
    if not every.size:
        return _of_records(context)
    picked = np.unique(np.linspace(0, every.size - 1, min(_SCANNED, every.size)).astype(int))
    return tuple(_text(t) for t in every[picked])


def _of_records(context: Context) -> tuple[str, ...]:
    """Records of a table that follow each other but have no clock."""
    if "time" in context or "record" not in context:
        return ()
    first = context["record"][_FEWEST_RECORDS : 1 - _FEWEST_RECORDS]
    picked = np.unique(np.linspace(0, first.size - 1, min(2 * _SCANNED, first.size)).astype(int))
    return tuple(f"record{int(r) + 1}" for r in first[picked])


def _nearby(context: Context, value: str) -> tuple[str, ...]:
    if value.startswith("record"):
        return ()
    every = _between(context)
    reach = max(1, every.size // _SCANNED) + 1
    at = int(np.searchsorted(every, float(value.removesuffix("s"))))
    return tuple(_text(t) for t in every[max(0, at - reach) : at + reach + 1])


FAMILIES = (Family("bias_step", "The bias jumps at one time.", bias_step, _values, _nearby),)
