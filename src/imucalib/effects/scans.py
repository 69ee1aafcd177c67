"""Effects that differ in one value that a search has to find: a moment, a period, a lag, a session,
a column of the user's, a form."""

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Effect, Response
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
    EffectPart,
    make_effect,
    scan,
    waves,
)
from imucalib.effects.thermal import LAG, PLAY, RATE, ROWS

# A column of the user's.

#: What a column that the user names is called among the covariates.
COLUMN = "column "
_FOLLOWING = {"bias": BIAS, "scale": SCALE}
#: What a period is counted in -> the covariate, and how its angle counts.
_CLOCKS = {"rows": ("record", "(row - 1)"), "s": ("time", "time")}
#: Rows of a table from which on more than one swing can be separated from all else.
_FEWEST_SWINGING = 20
#: Swings of a table: at least one and a half, else it is a drift, and at most this many a row;
#: steps of half a swing a table, between which a wave keeps nine tenths of its amplitude.
_SLOWEST, _QUICKEST, _STEP = 1.5, 0.4, 0.5
_FINER = 5
#: Spread of the steps of time, relative, from which a pace is uneven; and how many swings a row can
#: be counted then, where an even pace takes a quick one for a slow one.
_PACE, _UNEVEN = 0.2, 0.8
_DIFFERING = {"scale": SCALE, "sensor": MATRIX, "inclination": INCLINATION}
_SCANNED = 48  # times, or half as many records, tried at first; around the best all are after
_FEWEST = 12  # observations on each side of a step
_FEWEST_RECORDS = 6  # of a table, whose rows know their direction
#: Covariates: first and last record, from 0, of the part of a sheet that stands as it was set.
TRUSTED = ("trusted_from", "trusted_to")
#: Where a turning point is tried, in parts of the range: at an end it is nearly a linear bias.
_PARTS = (0.25, 0.5, 0.75)
#: °C between two turning points that are tried, at first and near the best one.
_COARSE, _FINE = 1.0, 0.2
#: What a line leaves of the square, in ranges squared, from which on the two can be separated:
#: 0.075 of temperatures spread evenly, 0.04 of two that are each held within a twentieth.
_BENT = 0.05


def follows(value: str) -> Effect:
    """Of "bias:supply_V:12:0.5" the bias that follows the column supply_V, for 0.5 of it from 12;
    ValueError where the value says nothing of the kind."""
    what, _, rest = value.partition(":")
    name, middle, half = rest.rsplit(":", 2)
    center, unit = float(middle), float(half)
    if what not in _FOLLOWING or not name or not unit > 0.0:
        raise ValueError(f"no column: {value}")
    column = Covariate((COLUMN + name,), lambda context: (context[COLUMN + name] - center) / unit)
    given = {"name": name, "middle": middle, "half": half}
    effect = make_effect(f"follows@{what}", _FOLLOWING[what], column, value, **given)
    assert isinstance(effect, Response)
    each = (replace(p, name=f"{effect.name}_{p.name[-1]}") for p in effect.each)
    return replace(effect, each=tuple(each))


def _columns(context: Context) -> tuple[str, ...]:
    """Bias and scale with every named column that moves: middle of its range, half of it."""
    found = []
    for name in filter(lambda name: name.startswith(COLUMN), context.covariates):
        half = 0.5 * float(np.ptp(context[name]))
        if half > 0.0:
            span = f"{float(np.min(context[name])) + half:.6g}:{half:.6g}"
            found += [f"{what}:{name.removeprefix(COLUMN)}:{span}" for what in _FOLLOWING]
    return tuple(found)


# Cycles: of what goes on and off in a room.


def _period(value: str) -> tuple[float, str]:
    """Period and unit of "7.3rows" or "220s"; ValueError otherwise."""
    for unit in _CLOCKS:
        number = value.removesuffix(unit)
        if number != value and number[-1:].isdigit() and float(number) > 0.0:
            return float(number), unit
    raise ValueError(f"no period in rows or seconds: {value}")


def _swing(key: str, part: EffectPart, value: str) -> Effect:
    period, unit = _period(value)
    clock, counted = _CLOCKS[unit]
    swing = Covariate(
        (clock, "tool_face"),
        lambda context: waves(2.0 * np.pi * context[clock] / period),
        labels=("cos", "sin"),
    )
    return make_effect(key, part, swing, value, period=period, unit=unit, counted=counted)


def cycle(value: str) -> Effect:
    """The bias that swings with a period of so many rows of a table, "7.3rows", or of so many
    seconds by its clock, "220s"; ValueError otherwise."""
    return _swing("cycle@", ROOM_BIAS, value)


def scale_cycle(value: str) -> Effect:
    """The same of the scale of all axes together; ValueError where `value` is no period."""
    return _swing("scale_cycle@", GAIN, value)


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


def _finer_periods(context: Context, value: str) -> tuple[str, ...]:
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
    which = int(number) - 1
    if which < 0:
        raise ValueError(f"sessions count from 1, not {number}")
    if what not in _DIFFERING:
        raise ValueError(f"'{value}' is no session and what differs in it")
    one = Covariate(("session",), lambda context: (context["session"] == which).astype(float))
    return make_effect(f"session@{what}", _DIFFERING[what], one, value, number=number)


def _sessions(context: Context) -> tuple[str, ...]:
    """Every session, of two the second."""
    if "session" not in context:
        return ()
    numbers = 1 + np.unique(context["session"]).astype(int)
    kinds = ("scale", "sensor", *(("inclination",) if "inclination" in context else ()))
    return tuple(f"{n}:{kind}" for n in numbers[len(numbers) < 3 :] for kind in kinds)


# Moments: a bias that jumps (a knock, a new battery, a restart), a scale (an amplifier, a supply,
# another range), a tool that slips in its clamp, a dial whose zero moves.


def _from_record(value: str) -> tuple[int, Covariate]:
    """17 of "record17", counted from 1, and what is 1 from there on; ValueError otherwise."""
    if not value.startswith("record"):
        raise ValueError(f"no record: {value}")
    first = int(value.removeprefix("record"))
    since = Covariate(("record",), lambda c: (c["record"] >= first - 1).astype(float))
    return first, since


def bias_step(value: str) -> Effect:
    """The step at a time such as "86400s" after the recording's start, or from a record of a table
    on, "record17" (counted from 1); ValueError otherwise."""
    if value.startswith("record"):
        first, since = _from_record(value)
        return make_effect(
            "bias_step@", BIAS, since, value, when=f"before record {first}", clock="record"
        )
    at = float(value.removesuffix("s"))
    since = Covariate(("time",), lambda context: (context["time"] >= at).astype(float))
    when = f"{at / 3600.0:.2f} h after the start"
    return make_effect("bias_step@", BIAS, since, value, when=when, clock="time")


def moment_of(name: str) -> float:
    """s after the start at which an effect of this name jumps; NaN where it does not."""
    family, _, value = name.partition("@")
    if ":time:step:" in value:
        return float(value.rpartition(":")[2])
    return float(value[:-1]) if family == "bias_step" and value.endswith("s") else float("nan")


def trust_records(context: Context, first: float, last: float) -> Context:
    """The context with the records first to last, from 0, said to stand as they were set."""
    said = {name: np.full(context.n, at) for name, at in zip(TRUSTED, (first, last), strict=True)}
    return replace(context, covariates={**context.covariates, **said})


def _count_from(value: str) -> tuple[int, Covariate]:
    """17 of "record17", and what is 1 from there on; where a part from there on is trusted, 0 there
    and -1 before. ValueError otherwise."""
    first, since = _from_record(value)

    def values(context: Context) -> Array:
        trusted = context.covariates.get(TRUSTED[0], np.zeros(context.n))
        return since.values(context) - (trusted >= first - 1)

    return first, Covariate(since.needs, values)


def scale_step(value: str) -> Effect:
    """The step of the scale from a record of a table on, "record17" (counted from 1); ValueError
    otherwise."""
    first, since = _from_record(value)
    return make_effect("scale_step@", SCALE, since, value, record=first)


def slip(value: str) -> Effect:
    """The slip from a record of a table on, "record17" (counted from 1), in any way, or about the
    tool's own axis, "record17:z"; ValueError otherwise."""
    record, _, axis = value.partition(":")
    if axis not in ("", "z"):
        raise ValueError(f"no way to slip: {value}")
    first, since = _count_from(record)
    return make_effect(f"slip@{axis}", CLAMP_Z if axis else CLAMP, since, value, record=first)


def inclination_step(value: str) -> Effect:
    """The inclination dial whose zero moves before a record of a table, "record17" (counted from
    1); ValueError otherwise."""
    first, since = _count_from(value)
    return make_effect("inclination_step@", INCLINATION, since, value, record=first)


def _between(context: Context) -> Array:
    """Times between neighbouring observations, far enough from both ends."""
    time = np.unique(context["time"]) if "time" in context else np.zeros(0)
    if time.size <= 2 * _FEWEST:
        return np.zeros(0)
    return np.asarray(np.round(0.5 * (time[1:] + time[:-1]), 3)[_FEWEST - 1 : -_FEWEST + 1])


def _inner_records(context: Context) -> Array:
    """First records, from 0, of what may stand after a jump."""
    return context["record"][_FEWEST_RECORDS : 1 - _FEWEST_RECORDS]


def _records(context: Context) -> tuple[str, ...]:
    """Every record of a sheet; of a longer one evenly spread ones."""
    first = _inner_records(context)
    picked = np.unique(np.linspace(0, first.size - 1, min(2 * _SCANNED, first.size)).astype(int))
    return tuple(f"record{int(r) + 1}" for r in first[picked])


def _finer_records(context: Context, value: str) -> tuple[str, ...]:
    """Records between those that are tried beside one, in the same way."""
    first, (record, *way) = _inner_records(context), value.split(":")
    reach = -(-first.size // (2 * _SCANNED))
    near = np.abs(first + 1.0 - float(record.removeprefix("record"))) < reach
    return tuple(":".join((f"record{int(r) + 1}", *way)) for r in first[near])


def _on_dials(context: Context) -> tuple[str, ...]:
    """Gravity alone does not see how a tool stands."""
    return _records(context) if "tool_face" in context and "record" in context else ()


def _on_standing_dials(context: Context) -> tuple[str, ...]:
    """But for jumps within a part that stands as it was set."""
    low, high = (context.covariates.get(name, np.zeros(1))[0] for name in TRUSTED)
    number = (float(text.removeprefix("record")) - 1.0 for text in _on_dials(context))
    return tuple(f"record{r + 1.0:.0f}" for r in number if not low < r <= high)


def _of_records(context: Context) -> tuple[str, ...]:
    """Records of a table that follow each other but have no clock."""
    return () if "time" in context or "record" not in context else _records(context)


def _times(context: Context) -> tuple[str, ...]:
    every = _between(context)
    if not every.size:
        return _of_records(context)
    picked = np.unique(np.linspace(0, every.size - 1, min(_SCANNED, every.size)).astype(int))
    return tuple(f"{t:.10g}s" for t in every[picked])


def _finer_times(context: Context, value: str) -> tuple[str, ...]:
    if value.startswith("record"):
        return _finer_records(context, value)
    every = _between(context)
    reach = max(1, every.size // _SCANNED) + 1
    at = int(np.searchsorted(every, float(value.removesuffix("s"))))
    return tuple(f"{t:.10g}s" for t in every[max(0, at - reach) : at + reach + 1])


# The temperature's past, and its square.


def _late(name: str) -> Covariate:
    return Covariate((name,), lambda context: context[name] - 25.0)


def thermal_hysteresis(value: str) -> Effect:
    """With the play given as "2C"; ValueError otherwise."""
    width = PLAY.size(value)
    return make_effect(
        "thermal_hysteresis@", BIAS, _late(PLAY.covariate(value)), value, width=width
    )


def thermal_lag(value: str) -> Effect:
    """The lag given as "1.5h" or "2rows"; ValueError otherwise."""
    size, unit = LAG.size(value), ROWS if value.endswith(ROWS) else "hours"
    return make_effect(
        "thermal_lag@", BIAS, _late(LAG.covariate(value)), value, size=size, unit=unit
    )


def temperature_rate(value: str) -> Effect:
    """Over the time given as "12min" or "3rows"; ValueError otherwise.

    A late bias has the temperature itself beside its rate; this one has the rate alone.
    """
    time, name = RATE.size(value), RATE.covariate(value)
    rate = Covariate((name,), lambda context: context[name])
    if value.endswith(ROWS):
        return make_effect("temperature_rate@rows", BIAS, rate, value, time=time, unit=ROWS)
    return make_effect("temperature_rate@", BIAS, rate, value, time=60.0 * time, unit="min")


def _turning_point(value: str) -> float:
    """°C of "22C"; ValueError otherwise."""
    if not value.endswith("C"):
        raise ValueError(f"no temperature in °C: {value}")
    return float(value.removesuffix("C"))


def temperature_square(value: str) -> Effect:
    """About the turning point given as "22C"; ValueError otherwise.

    About any other temperature the square has a linear part as well, which `temperature_bias`
    holds: where both are in a model, the turning point of each axis follows from the two.
    """
    at = _turning_point(value)
    square = Covariate(("temperature",), lambda context: (context["temperature"] - at) ** 2)
    return make_effect("temperature_square@", BIAS, square, value, at=at)


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
    misfit = share**2 - line @ np.linalg.lstsq(line, share**2, rcond=None)[0]
    return float(np.std(misfit))


def _finer_turning_points(context: Context, value: str) -> tuple[str, ...]:
    at, reach = _turning_point(value), _PARTS[0] * float(np.ptp(context["temperature"]))
    steps = np.arange(1, int(reach / _FINE) + 1) * _FINE
    return tuple(f"{at + step:.4g}C" for step in np.concatenate([-steps[::-1], [0.0], steps]))


FAMILIES = (
    scan("follows", follows, _columns),
    scan("curve", curve, lambda context: (), free=True),
    scan("cycle", cycle, _all_periods, _finer_periods, unfounded=True),
    scan("scale_cycle", scale_cycle, _all_periods, _finer_periods, unfounded=True),
    scan("session", session, _sessions),
    scan("bias_step", bias_step, _times, _finer_times),
    scan(
        "scale_step",
        scale_step,
        lambda context: _on_dials(context) or _of_records(context),
        _finer_records,
        unfounded=True,
    ),
    scan(
        "slip",
        slip,
        lambda context: tuple(r + w for r in _on_standing_dials(context) for w in ("", ":z")),
        _finer_records,
        unfounded=True,
    ),
    scan("inclination_step", inclination_step, _on_standing_dials, _finer_records, unfounded=True),
    scan("shape", shape, lambda context: (), unfounded=True, free=True),
    scan("thermal_hysteresis", thermal_hysteresis, PLAY.select_recorded),
    scan("thermal_lag", thermal_lag, LAG.select_recorded),
    scan("temperature_rate", temperature_rate, RATE.select_recorded),
    scan("temperature_square", temperature_square, _turning_points, _finer_turning_points),
)
