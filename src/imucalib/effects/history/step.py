"""What changes at an unknown moment: a bias that jumps (a knock, a new battery, a restart), a scale
(an amplifier, a supply, another range), a tool that slips in its clamp, a dial whose zero moves.
"""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Effect, Family, Parameter, Response, Rotation
from imucalib.effects.covariate import Drive, bias_with, scale_with
from imucalib.effects.inclination import about
from imucalib.effects.mounting import turns_about

_SCANNED = 48  # times tried at first; the neighbours of the best one are tried after
_FEWEST = 12  # observations on each side of a step
_FEWEST_RECORDS = 6  # of a table, whose rows know their direction


def bias_step(value: str) -> Effect:
    """The step at a time such as "86400s" after the recording's start, or from a record of a table
    on, "record17" (counted from 1); ValueError otherwise."""
    if value.startswith("record"):
        first = _first(value)
        return _step(value, f"The bias jumps before record {first}.", "record", first - 1)
    at = float(value.removesuffix("s"))
    return _step(value, f"The bias jumps {at / 3600.0:.2f} h after the start.", "time", at)


def moment_of(name: str) -> float:
    """s after the start at which an effect of this name jumps; NaN where it does not."""
    family, _, value = name.partition("@")
    if ":time:step:" in value:
        return float(value.rpartition(":")[2])
    return float(value[:-1]) if family == "bias_step" and value.endswith("s") else float("nan")


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


def scale_step(value: str) -> Effect:
    """The step of the scale from a record of a table on, "record17" (counted from 1); ValueError
    otherwise."""
    first = _first(value)
    basis, slope = scale_with(_since(first))
    return Response(
        f"scale_step@{value}",
        f"The scale jumps before record {first}.",
        "y_i = x_i (1 + d_i [record >= first])",
        "an amplifier, a supply or a range that changes within a run, practice",
        "Repeat positions with each axis up and down on both sides of the jump.",
        ("record",),
        each=tuple(Parameter(f"scale_step_{value}_{a}", "mg/g", 1.0, 300.0) for a in "xyz"),
        basis=basis,
        basis_dx=slope,
    )


def _first(value: str) -> int:
    """17 of "record17", counted from 1; ValueError otherwise."""
    if not value.startswith("record"):
        raise ValueError(f"no record: {value}")
    return int(value.removeprefix("record"))


def _since(first: int) -> Drive:
    """1 from a record on, counted from 1, and 0 before."""
    return lambda context: (context["record"] >= first - 1).astype(float)


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


def slip(value: str) -> Effect:
    """The slip from a record of a table on, "record17" (counted from 1), in any way, or about the
    tool's own axis, "record17:z"; ValueError otherwise."""
    record, _, axes = value.partition(":")
    first = _first(record)
    if axes not in ("", "z"):
        raise ValueError(f"no way to slip: {value}")
    own = " about its own axis" if axes else ""
    name = f"slip_{value}".replace(":", "_")
    return Rotation(
        f"slip@{value}",
        f"From record {first} on the tool stands turned{own} in its clamp.",
        "x' = Rz(s_z) Ry(s_y) Rx(s_x) x from that record on"
        if not axes
        else "x' = Rz(s_z) x from that record on",
        "0.1-1 deg where a clamp is touched or a bench is knocked, practice",
        "Return to the first position at the end.",
        ("record", "tool_face"),
        named=tuple(
            Parameter(name if axes else f"{name}_{a}", "deg", 0.3, 20.0) for a in axes or "xyz"
        ),
        turns=turns_about(axes or "xyz", _since(first)),
    )


def inclination_step(value: str) -> Effect:
    """The inclination dial whose zero moves before a record of a table, "record17" (counted from
    1); ValueError otherwise."""
    first = _first(value)
    return Rotation(
        f"inclination_step@{value}",
        f"The zero of the inclination dial moves before record {first}.",
        "i = i_dial + d [record >= first]",
        "0.1-1 deg where a dial is loose or a base is knocked, practice",
        "Return to the first inclinations at the end.",
        ("record", "inclination", "tool_face"),
        named=(Parameter(f"inclination_step_{value}", "deg", 0.3, 20.0),),
        turns=(about(_since(first)),),
    )


def _on_dials(context: Context) -> tuple[str, ...]:
    """Gravity alone does not see how a tool stands."""
    return _records(context) if "tool_face" in context and "record" in context else ()


def _ways(context: Context) -> tuple[str, ...]:
    return tuple(record + way for record in _on_dials(context) for way in ("", ":z"))


def _of_records(context: Context) -> tuple[str, ...]:
    """Records of a table that follow each other but have no clock."""
    return () if "time" in context or "record" not in context else _records(context)


def _of_tables(context: Context) -> tuple[str, ...]:
    return _on_dials(context) or _of_records(context)


def _records(context: Context) -> tuple[str, ...]:
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


FAMILIES = (
    Family("bias_step", "The bias jumps at one time.", "86400s", bias_step, _values, _nearby),
    Family(
        "scale_step",
        "The scale jumps at one record.",
        "record17",
        scale_step,
        _of_tables,
        unfounded=True,
    ),
    Family(
        "slip",
        "The tool stands turned from one record on.",
        "record17",
        slip,
        _ways,
        unfounded=True,
    ),
    Family(
        "inclination_step",
        "The zero of the inclination dial moves.",
        "record17",
        inclination_step,
        _on_dials,
        unfounded=True,
    ),
)
