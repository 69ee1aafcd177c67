"""Effects that differ in one value that a search has to find: a moment, a period, a lag, a session,
a column of the user's, a form."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Effect, Family
from imucalib.effects.forms import curve, shape
from imucalib.effects.parts import (
    BIAS,
    CLAMP,
    CLAMP_Z,
    GAIN,
    INCLINATION,
    MATRIX,
    ROOM_BIAS,
    SCALE,
    Covariate,
    made,
    waves,
)
from imucalib.effects.table import USUAL_BIAS
from imucalib.effects.thermal import LAG, PLAY, RATE, ROWS

# A column of the user's.

#: What a column that the user names is called among the covariates.
COLUMN = "column "
_PARTS_THAT_FOLLOW = {"bias": BIAS, "scale": SCALE}


def follows(value: str) -> Effect:
    """Of "bias:supply_V:12:0.5" the bias that follows the column supply_V, for 0.5 of it from 12;
    ValueError where the value says nothing of the kind."""
    what, _, rest = value.partition(":")
    name, middle, half = rest.rsplit(":", 2)
    center, unit = float(middle), float(half)
    if what not in _PARTS_THAT_FOLLOW or not name or not unit > 0.0:
        raise ValueError(f"no column: {value}")
    column = Covariate(
        (COLUMN + name,),
        f"follows {name}",
        "c_i u",
        lambda context: (context[COLUMN + name] - center) / unit,
        f"Repeat positions at two values of {name}, in mixed order.",
        tail=f",  u = ({name} - {middle}) / {half}",
    )
    source = "a column that the user names; its size is taken as a drift's"
    effect = f"follows@{value}"
    return made(effect, _PARTS_THAT_FOLLOW[what], column, source, 1.0, prefix=effect)


def _columns(context: Context) -> tuple[str, ...]:
    """Bias and scale with every named column that moves: middle of its range, half of it."""
    found = []
    for name in filter(lambda name: name.startswith(COLUMN), context.covariates):
        half = 0.5 * float(np.ptp(context[name]))
        if half > 0.0:
            span = f"{float(np.min(context[name])) + half:.6g}:{half:.6g}"
            found += [f"{what}:{name.removeprefix(COLUMN)}:{span}" for what in _PARTS_THAT_FOLLOW]
    return tuple(found)


# Cycles: of what goes on and off in a room.

#: What a period is counted in -> the covariate, and how its angle counts.
_CLOCKS = {"rows": ("record", "(row - 1)"), "s": ("time", "time")}
#: Rows of a table from which on more than one swing can be told from all else.
_FEWEST_SWINGING = 20
#: Swings of a table: at least one and a half, else it is a drift, and at most this many a row;
#: steps of half a swing a table, between which a wave keeps nine tenths of its amplitude.
_SLOWEST, _QUICKEST, _STEP = 1.5, 0.4, 0.5
_FINER = 5
#: Spread of the steps of time, relative, from which a pace is uneven; and how many swings a row can
#: be told then, where an even pace takes a quick one for a slow one.
_PACE, _UNEVEN = 0.2, 0.8


def _period(value: str) -> tuple[float, str]:
    """Period and unit of "7.3rows" or "220s"; ValueError otherwise."""
    for unit in _CLOCKS:
        number = value.removesuffix(unit)
        if number != value and number[-1:].isdigit() and float(number) > 0.0:
            return float(number), unit
    raise ValueError(f"no period in rows or seconds: {value}")


def _swing(value: str, term: str, identify: str) -> Covariate:
    period, unit = _period(value)
    clock, counted = _CLOCKS[unit]
    return Covariate(
        (clock, "tool_face"),
        f"swings with a period of {period:g} {unit}",
        term,
        lambda context: waves(2.0 * np.pi * context[clock] / period),
        identify,
        tail=f",  φ = 2π {counted} / period",
        labels=("cos", "sin"),
    )


def cycle(value: str) -> Effect:
    """The bias that swings with a period of so many rows of a table, "7.3rows", or of so many
    seconds by its clock, "220s"; ValueError otherwise."""
    identify = "Repeat one position at an uneven pace, and note the time and the temperature."
    swing = _swing(value, "c_i cos(φ) + s_i sin(φ)", identify)
    source = "heating or a pump that goes on and off beside a bench, practice"
    return made(f"cycle@{value}", ROOM_BIAS, swing, source, 1.0, 50.0)


def scale_cycle(value: str) -> Effect:
    """The same of the scale of all axes together; ValueError where `value` is no period."""
    identify = "Note the supply's voltage beside each position."
    swing = _swing(value, "c cos(φ) + s sin(φ)", identify)
    source = "an output that follows its supply, practice"
    return made(f"scale_cycle@{value}", GAIN, swing, source, 1.0, 50.0)


def _rows(context: Context) -> int:
    return int(context["record"].max()) + 1


def _periods(swings: Array, span: float, unit: str) -> tuple[str, ...]:
    return tuple(f"{span / s:.4g}{unit}" for s in swings)


def _all_periods(context: Context) -> tuple[str, ...]:
    """By the clock where rows come at an uneven pace, else in rows."""
    if context.n < _FEWEST_SWINGING or "record" not in context or "tool_face" not in context:
        return ()
    rows = _rows(context)
    steps = np.diff(np.sort(context["time"])) if "time" in context else np.zeros(0)
    if steps.size and np.std(steps) > _PACE * np.mean(steps) > 0.0:
        swings = np.arange(_SLOWEST, _UNEVEN * rows, _STEP)
        return _periods(swings, float(np.ptp(context["time"])), "s")
    return _periods(np.arange(_SLOWEST, _QUICKEST * rows, _STEP), float(rows), "rows")


def _near_period(context: Context, value: str) -> tuple[str, ...]:
    period, unit = _period(value)
    span = float(_rows(context)) if unit == "rows" else float(np.ptp(context["time"]))
    finer = _STEP * np.linspace(-1.0, 1.0, 2 * _FINER + 1)
    return _periods(span / period + finer, span, unit)


# Sessions: what differs in one power-up of several beyond the bias and the seat, which every one
# changes: the dial was set anew, the sensor was damaged, or another one was taken.


def session(value: str) -> Effect:
    """Of "3:scale" the third session's scale factors, of "3:sensor" the angles between its axes
    too, of "3:inclination" the zero of its inclination dial; ValueError otherwise."""
    number, _, what = value.partition(":")
    which, name = int(number) - 1, f"session@{value}"
    if which < 0:
        raise ValueError(f"sessions count from 1, not {number}")
    kinds = {
        "scale": (SCALE, "c_i", "the scale factors differ"),
        "sensor": (MATRIX, "Σ_j c_ij x_j", "scale factors and the angles between the axes differ"),
        "inclination": (INCLINATION, "d", "the inclination dial has its zero elsewhere"),
    }
    if what not in kinds:
        raise ValueError(f"'{value}' is no session and what differs in it")
    part, term, differs = kinds[what]
    one = Covariate(
        ("session",),
        "",
        term,
        lambda context: (context["session"] == which).astype(float),
        "Repeat that session, and read the number on the sensor.",
        tail=" in that session",
    )
    sentence = f"In session {number} {differs}."
    if part is INCLINATION:
        identify = "Set inclinations of both signs in every session."
        source = "0.1 deg, practice"
        return made(name, part, one, source, 0.2, 10.0, sentence=sentence, identify=identify)
    remedy = "compare the numbers on the sensors, and leave that session out if they differ"
    source = "2 mg/g between two sensors, or after a knock, practice"
    return made(name, part, one, source, 2.0, sentence=sentence, remedy=remedy)


def _sessions(context: Context) -> tuple[str, ...]:
    """Every session, of two the second."""
    if "session" not in context:
        return ()
    numbers = 1 + np.unique(context["session"]).astype(int)
    kinds = ("scale", "sensor", *(("inclination",) if "inclination" in context else ()))
    return tuple(f"{n}:{kind}" for n in numbers[len(numbers) < 3 :] for kind in kinds)


# Moments: a bias that jumps (a knock, a new battery, a restart), a scale (an amplifier, a supply,
# another range), a tool that slips in its clamp, a dial whose zero moves.

_SCANNED = 48  # times tried at first; the neighbours of the best one are tried after
_FEWEST = 12  # observations on each side of a step
_FEWEST_RECORDS = 6  # of a table, whose rows know their direction


def _from_record(value: str, verb: str, term: str, identify: str) -> Covariate:
    """1 from a record such as "record17" on, counted from 1, and 0 before; ValueError otherwise.
    verb, term : with {} for its number or moment"""
    if not value.startswith("record"):
        raise ValueError(f"no record: {value}")
    first = int(value.removeprefix("record"))
    return Covariate(
        ("record",),
        verb.format(first),
        term,
        lambda context: (context["record"] >= first - 1).astype(float),
        identify,
    )


def bias_step(value: str) -> Effect:
    """The step at a time such as "86400s" after the recording's start, or from a record of a table
    on, "record17" (counted from 1); ValueError otherwise."""
    identify = "Record varied attitudes on both sides of the jump."
    if value.startswith("record"):
        step = _from_record(value, "jumps before record {}", "d_i [record >= t0]", identify)
    else:
        at = float(value.removesuffix("s"))
        step = Covariate(
            ("time",),
            f"jumps {at / 3600.0:.2f} h after the start",
            "d_i [time >= t0]",
            lambda context: (context["time"] >= at).astype(float),
            identify,
        )
    source = "1-20 mg after a knock or a restart, practice"
    return made(f"bias_step@{value}", BIAS, step, source, 2.0, 300.0, prefix=f"step_{value}")


def moment_of(name: str) -> float:
    """s after the start at which an effect of this name jumps; NaN where it does not."""
    family, _, value = name.partition("@")
    if ":time:step:" in value:
        return float(value.rpartition(":")[2])
    return float(value[:-1]) if family == "bias_step" and value.endswith("s") else float("nan")


def scale_step(value: str) -> Effect:
    """The step of the scale from a record of a table on, "record17" (counted from 1); ValueError
    otherwise."""
    identify = "Repeat positions with each axis up and down on both sides of the jump."
    sentence = "The scale jumps before record {}."
    step = _from_record(value, sentence, "d_i [record >= first]", identify)
    source = "an amplifier, a supply or a range that changes within a run, practice"
    return made(f"scale_step@{value}", SCALE, step, source, 1.0, 300.0, sentence=step.verb)


def slip(value: str) -> Effect:
    """The slip from a record of a table on, "record17" (counted from 1), in any way, or about the
    tool's own axis, "record17:z"; ValueError otherwise."""
    record, _, axes = value.partition(":")
    if axes not in ("", "z"):
        raise ValueError(f"no way to slip: {value}")
    own = " about its own axis" if axes else ""
    sentence = f"From record {{}} on the tool stands turned{own} in its clamp."
    step = _from_record(record, sentence, "", "Return to the first position at the end.")
    part, turns = (CLAMP_Z, "Rz(s_z)") if axes else (CLAMP, "Rz(s_z) Ry(s_y) Rx(s_x)")
    equation = f"x' = {turns} x from that record on"
    source = "0.1-1 deg where a clamp is touched or a bench is knocked, practice"
    return made(
        f"slip@{value}", part, step, source, 0.3, 20.0, sentence=step.verb, equation=equation
    )


def inclination_step(value: str) -> Effect:
    """The inclination dial whose zero moves before a record of a table, "record17" (counted from
    1); ValueError otherwise."""
    sentence = "The zero of the inclination dial moves before record {}."
    identify = "Return to the first inclinations at the end."
    step = _from_record(value, sentence, "d [record >= first]", identify)
    source = "0.1-1 deg where a dial is loose or a base is knocked, practice"
    name = f"inclination_step@{value}"
    return made(name, INCLINATION, step, source, 0.3, 20.0, sentence=step.verb)


def _between(context: Context) -> Array:
    """Times between neighbouring observations, far enough from both ends."""
    time = np.unique(context["time"]) if "time" in context else np.zeros(0)
    if time.size <= 2 * _FEWEST:
        return np.zeros(0)
    return np.asarray(np.round(0.5 * (time[1:] + time[:-1]), 3)[_FEWEST - 1 : -_FEWEST + 1])


def _records(context: Context) -> tuple[str, ...]:
    first = context["record"][_FEWEST_RECORDS : 1 - _FEWEST_RECORDS]
    picked = np.unique(np.linspace(0, first.size - 1, min(2 * _SCANNED, first.size)).astype(int))
    return tuple(f"record{int(r) + 1}" for r in first[picked])


def _on_dials(context: Context) -> tuple[str, ...]:
    """Gravity alone does not see how a tool stands."""
    return _records(context) if "tool_face" in context and "record" in context else ()


def _of_records(context: Context) -> tuple[str, ...]:
    """Records of a table that follow each other but have no clock."""
    return () if "time" in context or "record" not in context else _records(context)


def _times(context: Context) -> tuple[str, ...]:
    every = _between(context)
    if not every.size:
        return _of_records(context)
    picked = np.unique(np.linspace(0, every.size - 1, min(_SCANNED, every.size)).astype(int))
    return tuple(f"{t:.10g}s" for t in every[picked])


def _near_time(context: Context, value: str) -> tuple[str, ...]:
    if value.startswith("record"):
        return ()
    every = _between(context)
    reach = max(1, every.size // _SCANNED) + 1
    at = int(np.searchsorted(every, float(value.removesuffix("s"))))
    return tuple(f"{t:.10g}s" for t in every[max(0, at - reach) : at + reach + 1])


# The temperature's past, and its square.


def thermal_hysteresis(value: str) -> Effect:
    """With the play given as "2C"; ValueError otherwise."""
    width, name = PLAY.size(value), PLAY.covariate(value)
    covariate = Covariate(
        (name,),
        f"follows the temperature with a play of {width:g} °C",
        "c_i (T_p - 25 °C)",
        lambda context: context[name] - 25.0,
        "Record the temperature, and let it turn several times, by more and by less than the play.",
        tail=",  T_p moved by T only at the ends of T_p ± w/2",
        per="/degC",
    )
    source = (
        "play operator: Brokate, Sprekels, Hysteresis and Phase Transitions (1996), 2.1; "
        "a few °C wide in glued packages, practice"
    )
    effect, prefix = f"thermal_hysteresis@{value}", f"play_{value}"
    return made(effect, BIAS, covariate, source, 0.5, usual=USUAL_BIAS, prefix=prefix)


def thermal_lag(value: str) -> Effect:
    """The lag given as "1.5h" or "2rows"; ValueError otherwise."""
    size, name = LAG.size(value), LAG.covariate(value)
    covariate = Covariate(
        (name,),
        f"follows the temperature of the last {size:g} {ROWS if value.endswith(ROWS) else 'hours'}",
        "c_i (T_lag - 25 °C)",
        lambda context: context[name] - 25.0,
        "Record the temperature through several changes that last longer than the lag.",
        tail=",  T_lag' = (T - T_lag) / τ",
        per="/degC",
    )
    source = "0.5-3 h in a case on the wrist, minutes in a chamber, practice"
    effect, prefix = f"thermal_lag@{value}", f"lag_{value}"
    return made(effect, BIAS, covariate, source, 0.5, usual=USUAL_BIAS, prefix=prefix)


def temperature_rate(value: str) -> Effect:
    """Over the time given as "12min" or "3rows"; ValueError otherwise.

    A late bias has the temperature itself beside its rate; this one has the rate alone.
    """
    time, name, rows = RATE.size(value), RATE.covariate(value), value.endswith(ROWS)
    over = f"{time:g} rows" if rows else f"{60.0 * time:g} min"
    covariate = Covariate(
        (name,),
        f"follows the rate at which the temperature changes, over {over}",
        "c_i (T - T_lag) / τ",
        lambda context: context[name],
        "Record the temperature through changes as quick as those of putting the sensor on.",
        tail=",  T_lag' = (T - T_lag) / τ",
        per="/(degC/row)" if rows else "/(degC/h)",
    )
    source = (
        "temperature-ramp sensitivity, IEEE Std 952-1997; parts of a mg as a case is put on or off"
    )
    size = (1.0, 30.0) if rows else (0.3, 10.0)
    return made(f"temperature_rate@{value}", BIAS, covariate, source, *size, prefix=f"rate_{value}")


#: Where a turning point is tried, in parts of the range: at an end it is nearly a linear bias.
_PARTS = (0.25, 0.5, 0.75)
#: °C between two turning points that are tried, at first and near the best one.
_COARSE, _FINE = 1.0, 0.2
#: What a line leaves of the square, in ranges squared, from which on the two can be told apart:
#: 0.075 of temperatures spread evenly, 0.04 of two that are each held within a twentieth.
_BENT = 0.05


def _turning_point(value: str) -> float:
    """°C of "22C"; ValueError otherwise."""
    if not value.endswith("C"):
        raise ValueError(f"no temperature in °C: {value}")
    return float(value.removesuffix("C"))


def temperature_square(value: str) -> Effect:
    """About the turning point given as "22C"; ValueError otherwise.

    About any other temperature the square has a linear part as well, which `temperature_bias`
    holds: where both are taken, the turning point of each axis follows from the two.
    """
    at = _turning_point(value)
    covariate = Covariate(
        ("temperature",),
        f"follows the square of the temperature, about {at:g} °C",
        "c_i (T - T_0)²",
        lambda context: (context["temperature"] - at) ** 2,
        "Record the temperature, over a wide range and in varied attitudes.",
        per="/degC2",
    )
    source = "second-order temperature coefficient of bias, IEEE Std 1293"
    name, prefix = f"temperature_square@{value}", f"square_{value}"
    return made(name, BIAS, covariate, source, 0.02, 2.0, prefix=prefix)


def _turning_points(context: Context) -> tuple[str, ...]:
    if "temperature" not in context:
        return ()
    low, high = np.min(context["temperature"]), np.max(context["temperature"])
    if not high > low or _bend((context["temperature"] - low) / (high - low)) < _BENT:
        return ()
    points = np.round((low + np.array(_PARTS) * (high - low)) / _COARSE) * _COARSE
    inside = np.unique(points[(points > low) & (points < high)])
    return tuple(f"{point:g}C" for point in inside)


def _bend(share: Array) -> float:
    """What a line leaves of the square of the temperature, (n,) in parts of its range."""
    line = np.stack([np.ones_like(share), share], axis=1)
    left = share**2 - line @ np.linalg.lstsq(line, share**2, rcond=None)[0]
    return float(np.std(left))


def _near_turning_point(context: Context, value: str) -> tuple[str, ...]:
    at, reach = _turning_point(value), _PARTS[0] * float(np.ptp(context["temperature"]))
    steps = np.arange(1, int(reach / _FINE) + 1) * _FINE
    return tuple(f"{at + step:.4g}C" for step in np.concatenate([-steps[::-1], [0.0], steps]))


FAMILIES = (
    Family(
        "follows",
        "Bias or scale follow a column that the user names (`--columns driver=NAME`).",
        "bias:supply_V:12:0.5",
        follows,
        _columns,
    ),
    Family(
        "curve",
        "A smooth correction of structure that no effect explains.",
        "bias:temperature:20:30:4",
        curve,
        lambda context: (),
        free=True,
    ),
    Family(
        "cycle",
        "The bias swings with a period.",
        "7.3rows",
        cycle,
        _all_periods,
        _near_period,
        unfounded=True,
    ),
    Family(
        "scale_cycle",
        "The scale of all axes swings with a period.",
        "7.3rows",
        scale_cycle,
        _all_periods,
        _near_period,
        unfounded=True,
    ),
    Family(
        "session",
        "One session differs from the others in its scale factors, its sensor or its dial.",
        "2:scale",
        session,
        _sessions,
    ),
    Family("bias_step", "The bias jumps at one time.", "86400s", bias_step, _times, _near_time),
    Family(
        "scale_step",
        "The scale jumps at one record.",
        "record17",
        scale_step,
        lambda context: _on_dials(context) or _of_records(context),
        unfounded=True,
    ),
    Family(
        "slip",
        "The tool stands turned from one record on.",
        "record17",
        slip,
        lambda context: tuple(r + way for r in _on_dials(context) for way in ("", ":z")),
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
    Family(
        "shape",
        "A form with a formula, without a cause.",
        "response:xyz:sine:0.5",
        shape,
        lambda context: (),
        unfounded=True,
        free=True,
    ),
    Family(
        "thermal_hysteresis",
        "The bias follows the temperature with a play.",
        "2C",
        thermal_hysteresis,
        PLAY.recorded,
    ),
    Family(
        "thermal_lag", "The bias follows the temperature late.", "2h", thermal_lag, LAG.recorded
    ),
    Family(
        "temperature_rate",
        "The bias follows how fast the temperature changes.",
        "12min",
        temperature_rate,
        RATE.recorded,
    ),
    Family(
        "temperature_square",
        "The bias turns at a temperature.",
        "22C",
        temperature_square,
        _turning_points,
        _near_turning_point,
    ),
)
