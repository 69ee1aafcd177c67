"""From the numbers of a file to SI, once, at the border: unit, counts, offset and axes.

The unit comes from, in this order: the user's mapping, the file, the norm at rest. What was
decided, and why, is one sentence in `Conversion.note`. An analogue sensor behind a converter is
counted from the middle of its supply (33,000 of 65,536, or 1.65 V of 3.3 V); no bias of an
accelerometer reaches as far as gravity itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from imucalib import units
from imucalib.arrays import Array
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.fields.words import INERTIAL
from imucalib.recording.mapping import UNCHANGED, AxisMap, FieldMapping, parse_axis_map

_FEWEST = 8
#: An offset is half of a converter's range, which is no hundred g: further off, what looks like a
#: sphere is the noise of one posture.
_FARTHEST = 50.0
#: What every direction of the sphere must hold of the readings' spread, and how far the middle one
#: of them may lie from the sphere, of its radius: scales and misalignments differ by less.
_SPREAD, _OFF = 0.05, 0.05
COUNTS = "counts"
_IMPLAUSIBLE = 3.0  # a stated unit is refused when the norm at rest is off by this factor
_SAME_SCALE = 1.25  # the same for a device that has a few known scales
_LIKE_1024 = (1012.0, 1037.0)  # norms that 1024 counts a g explain better than mg
_REST_SECONDS = 0.5  # window of the look for rest
_STILL_SHARE = 0.1  # the quietest windows that stand for "at rest"
#: Values that are written where there is none, as integers of 16 and 32 bits and by hand.
_MISSING = (-999.0, 9999.0, -9999.0, 99999.0, -99999.0, 1e20, -1e20, -32768.0, -2147483648.0)
_SET_APART = 3.0  # times what else an axis reads
_BITS = (12, 16, 24, 32)
T = TypeVar("T")
#: What is said of a rate whose unit nobody states.
UNKNOWN_RATE = "angular rate: no unit is stated, kept as raw counts; name it with --gyro-unit"
#: degC = (raw - offset) * factor
_CELSIUS, _FAHRENHEIT = (1.0, 0.0), (5.0 / 9.0, 32.0)
_TEMPERATURE = {
    **dict.fromkeys(("degC", "C", "°C", "deg C", "celsius", "Celsius", "deg_C"), _CELSIUS),
    **dict.fromkeys(("degF", "F", "°F"), _FAHRENHEIT),
    "K": (1.0, 273.15),
}
#: A degree sign that a conversion between character sets has made into something else.
_MANGLED = re.compile(r"[^\w\s/]{1,3}\s?C|[ÂÃïº˚ª½\W]{1,3}C|\u2103")


@dataclass(frozen=True)
class ZeroG:
    """level : (3,) reading of each axis at zero g; radius : of the sphere, what one g reads"""

    level: Array
    radius: float

    @property
    def sentence(self) -> str:
        return (
            f"at rest the readings lie around {', '.join(f'{v:.6g}' for v in self.level)}, each "
            f"{self.radius:.4g} away: they are counted from an offset"
        )

    @property
    def options(self) -> tuple[str, ...]:
        level = ",".join(f"{v:.6g}" for v in self.level)
        return ("--unit", "counts", "--lsb", f"{self.radius:.4g}", f"--acc-offset={level}")

    def error(self, where: str) -> UnreadableInput:
        """What refuses such readings until somebody says where they are counted from."""
        remedy = "take zero and scale from the data sheet (--acc-offset, --lsb)"
        return UnreadableInput(self.sentence, where=where, remedy=remedy, add=self.options)


def zero_g(rest: Array) -> ZeroG | None:
    """The sphere that readings at rest (n, 3) lie on, where its centre is further from zero than
    gravity is large; None where they tell no sphere, or one about zero."""
    if len(rest) < _FEWEST or not np.ptp(rest):
        return None
    middle, scale = rest.mean(axis=0), float(rest.std())
    own = (rest - middle) / scale
    terms = np.column_stack([2.0 * own, np.ones(len(own))])
    (*shift, rest_of_it), *_ = np.linalg.lstsq(terms, (own**2).sum(axis=1))
    centre = np.array(shift)
    radius = float(np.sqrt(max(rest_of_it + centre @ centre, 0.0)))
    out = own - centre
    away = float(np.median(np.abs(np.linalg.norm(out, axis=1) - radius)))
    least = float(np.linalg.eigvalsh(np.cov(out.T))[0])
    if not radius or away > _OFF * radius or least < _SPREAD * radius**2:
        return None
    level = middle + scale * centre
    if not 1.0 < np.linalg.norm(level) / (scale * radius) < _FARTHEST:
        return None
    return ZeroG(level, scale * radius)


@dataclass(frozen=True)
class Conversion:
    """Output = axes((raw - offset) * factor), in `unit`.

    unit : "m/s2", "rad/s", "degC", or "counts" when no scale is known
    source_unit : unit of the file
    factor, offset : (1,) or (3,) per file axis
    note : how the unit was found, or empty when the file states it
    counts_per_g : the device's scale, where the norm at rest chose it, else 0
    missing : raw values that stand for none: they become NaN
    wrap : of numbers in two's complement without their sign, 65536 for 16 bits; else 0
    """

    unit: str
    source_unit: str
    factor: Array
    offset: Array
    axes: AxisMap = UNCHANGED
    note: str = ""
    counts_per_g: float = 0.0
    missing: tuple[float, ...] = ()
    wrap: float = 0.0

    @property
    def units(self) -> dict[str, Any]:
        """Fields of a channel: the unit, and what the file has."""
        zero = tuple(self.offset.tolist()) if self.offset.any() else ()
        raw = {"raw_to_si": tuple(self.factor.tolist()), "raw_zero": zero}
        return {"unit": self.unit, "raw_unit": self.source_unit, **raw}

    def apply(self, raw: NDArray[np.generic]) -> Array:
        """Convert raw values (..., 3), or (..., 1) for a scalar quantity, to float64."""
        values = restore_sign(
            mask_missing(np.asarray(raw, dtype=np.float64), self.missing), self.wrap
        )
        if self.offset.any():
            values = values - self.offset
        if (self.factor != 1.0).any():
            values = values * self.factor
        return self.axes.apply(values)


def missing_values(looks: Sequence[Array]) -> tuple[float, ...]:
    """Which of the values that are written for none an axis of raw readings (n, 3) holds, far from
    all else that it reads."""
    whole = np.concatenate(looks)
    codes = np.isin(whole, _MISSING)
    if not codes.any():
        return ()
    most = np.where(codes | ~np.isfinite(whole), 0.0, np.abs(whole)).max(axis=0)
    apart = codes & (np.abs(whole) > _SET_APART * most) & (most > 0.0)
    return tuple(np.unique(whole[apart]).tolist())


def mask_missing(values: Array, missing: tuple[float, ...]) -> Array:
    """The values with NaN for those that stand for none."""
    return np.where(np.isin(values, missing), np.nan, values) if missing else values


def wrap_of(looks: Sequence[Array]) -> float:
    """How many numbers there are in the converter's range, where readings (n, 3) are its two's
    complement read without the sign: they leap over half of the range, and else never do. Else 0"""
    low, high = min(v.min() for v in looks), max(v.max() for v in looks)
    size = next((2.0**bits for bits in _BITS if high < 2.0**bits), np.inf)
    if low < 0.0 or high < 0.5 * size or any((v != np.rint(v)).any() for v in looks):
        return 0.0
    leaps = [max(_leap(f(v)) for v in looks) for f in (np.asarray, lambda v: restore_sign(v, size))]
    return size if leaps[0] > 0.5 * size >= leaps[1] else 0.0


def _leap(values: Array) -> float:
    return float(np.abs(np.diff(values, axis=0)).max(initial=0.0))


def restore_sign(values: Array, wrap: float) -> Array:
    """Numbers of a two's complement with their sign."""
    return np.where(values >= 0.5 * wrap, values - wrap, values) if wrap else values


#: Numbers that are kept as they are.
AS_STORED = Conversion(COUNTS, COUNTS, np.ones(1), np.zeros(1))


def readings_at_rest(pieces: Sequence[Array], window: int) -> Array:
    """(k, 3) window means of the quietest tenth of all windows.

    pieces : arrays (n, 3) of consecutive raw samples; window : samples. Constant windows (idle or
    dead sensor) and windows with a missing value say nothing about gravity and are left out.
    """
    means, spreads = [], []
    for piece in pieces:
        width = min(window, piece.shape[0])
        count = piece.shape[0] // width if width else 0
        if count == 0:
            continue
        windows = piece[: count * width].reshape(count, width, 3)
        # A damaged number may be of any size: its window has no finite spread and is left out.
        with np.errstate(over="ignore", invalid="ignore"):
            means.append(windows.mean(axis=1))
            spreads.append(windows.std(axis=1).sum(axis=1))
    if not means:
        return np.empty((0, 3))
    mean, spread = np.concatenate(means), np.concatenate(spreads)
    usable = np.isfinite(spread) & (np.any(mean != 0.0, axis=1))
    alive = usable & (spread > 0.0)
    usable = alive if alive.any() else usable
    mean, spread = mean[usable], spread[usable]
    quietest = np.argsort(spread)[: max(1, int(_STILL_SHARE * spread.size))]
    rest: Array = mean[quietest]
    return rest


@dataclass(frozen=True)
class UnitSource:
    """What is known of an acceleration before its numbers are looked at.

    unit : that the file (or its format) states, or ""; scales : counts a g that the device's models
    have, one of which its file does not name; fixed : the format itself fixes the unit: what the
    numbers say against it is a caution; whole : every number is an integer
    """

    unit: str = ""
    scales: tuple[float, ...] = ()
    fixed: bool = False
    whole: bool = False


def _acceleration(mapping: FieldMapping, source: UnitSource, rest: Array, where: str) -> Conversion:
    """Conversion of raw acceleration to m/s².

    rest : (k, 3) raw readings at rest, from `readings_at_rest`, used to find the unit and to refuse
    a wrong one, whoever states it. Raises UnreadableInput when no unit fits, UsageError for an
    unknown one.
    """
    offset = _per_axis(mapping.acc_offset, "acc_offset", 0.0)
    unit = unit_of_axes(mapping.acc_unit or source.unit, "--unit", where)
    norms = np.linalg.norm(rest - offset, axis=1)
    norm = float(np.median(norms)) if rest.size else np.nan

    def found(source_unit: str, factor: Array, note: str = "", scale: float = 0.0) -> Conversion:
        axes = parse_axis_map(mapping.axis_map)
        return Conversion("m/s2", source_unit, factor, offset, axes, note, counts_per_g=scale)

    if source.fixed and not (mapping.acc_unit or mapping.lsb_per_g):
        return found(unit, np.array([units.ACCELERATION_UNITS[unit]]), _caution(norm, unit))
    away = None if mapping.acc_offset else zero_g(rest)
    if away is not None and (unit != COUNTS or mapping.lsb_per_g):
        raise away.error(where)
    if mapping.lsb_per_g and unit in ("", COUNTS):
        scale = units.STANDARD_GRAVITY / _per_axis(mapping.lsb_per_g, "lsb_per_g", 1.0)
        if rest.size:
            si = float(np.median(np.linalg.norm((rest - offset) * scale, axis=1)))
            _refuse_wrong(COUNTS, norm, si / units.STANDARD_GRAVITY, True, where)
        return found(COUNTS, scale, "acceleration from counts per g")
    if source.scales and not unit:
        one = _scale_of(source.scales, norm, where)
        note = f"acceleration: norm at rest = {norm:.6g} -> {one:g} counts a g, as the device has"
        return found(COUNTS, np.array([units.STANDARD_GRAVITY / one]), note, one)
    if unit == COUNTS:
        note = "acceleration kept as raw counts"
        return replace(found(COUNTS, np.ones(1), note), unit=COUNTS)
    if not unit:
        unit, note = _by_norm(source, norms, where)
        return found(unit, np.array([units.ACCELERATION_UNITS[unit]]), note)
    factor = _factor(unit, units.ACCELERATION_UNITS, mapping.acc_unit, "--unit", where)
    if rest.size:
        si = float(np.median(np.linalg.norm((rest - offset) * factor, axis=1)))
        _refuse_wrong(unit, norm, si / units.STANDARD_GRAVITY, bool(mapping.acc_unit), where)
    return found(unit, factor)


def find_conversion(
    quantity: str,
    mapping: FieldMapping,
    source: UnitSource,
    looks: Sequence[Array],
    *,
    rate: float,
    where: str,
) -> Conversion:
    """Conversion of any quantity; of an acceleration or an angular rate also of what it holds for
    "no value", and of a sign that was lost.

    looks : raw values (n, k), of consecutive samples each; rate : Hz, 0 where it is not known
    """
    if quantity not in INERTIAL:
        return temperature(mapping, source.unit, np.concatenate(looks), where)
    missing = missing_values(looks)
    looks = [mask_missing(v, missing) for v in looks]
    known = [v[np.isfinite(v).all(axis=1)] for v in looks]
    wrap = wrap_of(known) if any(v.size for v in known) else 0.0
    if quantity == "acceleration":
        window = max(3, round(_REST_SECONDS * rate))
        rest = readings_at_rest([restore_sign(v, wrap) for v in looks], window)
        whole = all((v == np.rint(v)).all() for v in known)
        how = _acceleration(mapping, replace(source, whole=whole), rest, where)
    else:
        how = _angular_rate(mapping, source.unit, where)
    said = [how.note] if how.note else []
    if missing:
        codes = ", ".join(f"{code:g}" for code in missing)
        said.append(f"{codes} stands for no value: such samples are left out")
    if wrap:
        said.append(f"numbers above {wrap / 2 - 1:.0f} are negative ones without their sign")
    return replace(how, missing=missing, wrap=wrap, note="; ".join(said))


def make_readable(
    channels: Sequence[Any], make: Callable[[Any], T], notes: list[str]
) -> tuple[T, ...]:
    """What `make` makes of each channel, which has a quantity and a triad; one that others can do
    without (a thermometer, a gyroscope beside an accelerometer) and that cannot be read is left
    out, and a note says why."""
    main = {c.quantity for c in channels if c.quantity != "temperature"}
    made = []
    for channel in channels:
        try:
            made.append(make(channel))
        except UnreadableInput as error:
            rate = channel.quantity == "angular_rate" and "acceleration" in main
            if not rate and channel.quantity != "temperature":
                raise
            name = f"{channel.triad}/{channel.quantity}"
            notes.append(f"{name} left out: {error.what}; {error.remedy}")
    return tuple(made)


def unit_of_axes(text: str, option: str, where: str) -> str:
    """The unit of all axes in its usual spelling, or "m/s2,m/s2,g" where they differ.

    text : one unit, or one an axis. Raises UnreadableInput where only some axes have one.
    """
    each = [units.canonical(part) for part in text.split(",")]
    if len(set(each)) == 1:
        return each[0]
    if len(each) != 3 or "" in each or COUNTS in each:
        said = ", ".join(f"{a} {u or 'nothing'}" for a, u in zip("xyz", each, strict=False))
        raise UnreadableInput(
            f"the axes state different units ({said}), which do not go together",
            where=where,
            remedy=f"name one for all with {option}, or one an axis: {option} m/s2,m/s2,g"
            if option == "--unit"
            else f"name one for all with {option}",
        )
    return ",".join(each)


def _by_norm(source: UnitSource, norms: Array, where: str) -> tuple[str, str]:
    """The unit that makes the norm at rest 1 g, and the sentence that says so."""
    norm = float(np.median(norms)) if norms.size else np.nan
    if norm < 1.0 / _IMPLAUSIBLE:  # the largest unit in use, g, has ones
        raise _without_gravity(norm, where)
    found = units.detect_acceleration_unit(norms, where)
    if source.whole and found.unit == "mg" and _LIKE_1024[0] < found.norm_at_rest < _LIKE_1024[1]:
        raise UnreadableInput(
            f"whole numbers whose norm at rest is {found.norm_at_rest:.6g}: mg, or counts",
            where=where,
            remedy="say which: --unit mg, or --unit counts --lsb 1024",
        )
    return found.unit, f"acceleration: {found.sentence}"


def _scale_of(scales: tuple[float, ...], norm: float, where: str) -> float:
    """The one of a device's scales that makes the norm at rest 1 g."""
    fitting = [s for s in scales if 1.0 / _SAME_SCALE < norm / s < _SAME_SCALE]
    if len(fitting) == 1:
        return fitting[0]
    raise UnreadableInput(
        f"the norm at rest is {norm:.6g} counts, and the device's models have "
        f"{', '.join(f'{s:g}' for s in scales)} a g",
        where=where,
        remedy="give the scale with --unit counts --lsb N",
    )


def _caution(norm: float, unit: str) -> str:
    """What is said of a norm that is not 1 g, in a format that leaves no doubt of its unit."""
    ratio = norm * units.ACCELERATION_UNITS[unit] / units.STANDARD_GRAVITY
    if np.isnan(norm) or 1.0 / _SAME_SCALE <= ratio <= _SAME_SCALE:
        return ""
    return (
        f"acceleration: the norm where it is quietest is {ratio:.3g} g: it was not at rest there, "
        "or its sensor is faulty (the format fixes the unit)"
    )


def _refuse_wrong(unit: str, norm: float, ratio: float, by_user: bool, where: str) -> None:
    """Refuse a unit in which the norm at rest is no gravity. ratio : of the norm to 1 g"""
    if 1.0 / _IMPLAUSIBLE <= ratio <= _IMPLAUSIBLE:
        return
    what = f"the norm at rest is {norm:.6g}, which is {ratio:.3g} g when the unit is {unit}"
    if by_user:
        remedy = "leave --unit away or name the true one; counts need --unit counts --lsb N"
        said = "--lsb states" if unit == COUNTS else "--unit states"
        raise UnreadableInput(f"{what}, as {said}", where=where, remedy=remedy)
    known = units.ACCELERATION_UNITS.items()
    fitting = [u for u, si in known if abs(norm * si / units.STANDARD_GRAVITY - 1.0) <= 0.25]
    if ratio < 1.0 and not fitting:
        raise _without_gravity(norm, where)
    option = f"--unit {fitting[0]}" if len(fitting) == 1 else "--unit"
    remedy = f"name the true unit with {option}, or the scale with --unit counts --lsb N"
    raise UnreadableInput(f"{what}, as the file states", where=where, remedy=remedy)


def _without_gravity(norm: float, where: str) -> UnreadableInput:
    """The error for numbers that are no gravity in any unit, and smaller than it in all."""
    return UnreadableInput(
        f"the norm at rest is {norm:.3g}, in which there is no gravity: it was removed (linear "
        "acceleration), or these are angular rates or steps of velocity",
        where=where,
        remedy="record the raw acceleration, gravity included; name rates with --gyro; if gravity "
        "is in it, give the scale with --unit counts --lsb N (steps of velocity: 9.80665 / rate)",
    )


def _angular_rate(mapping: FieldMapping, stated: str, where: str) -> Conversion:
    """Conversion of raw angular rate to rad/s; without any unit the numbers stay "counts"."""
    axes = parse_axis_map(mapping.axis_map)
    offset = _per_axis(mapping.gyro_offset, "gyro_offset", 0.0)
    unit = unit_of_axes(mapping.gyro_unit or stated, "--gyro-unit", where)
    if mapping.lsb_per_dps and unit in ("", COUNTS):
        scale = units.DEG / _per_axis(mapping.lsb_per_dps, "lsb_per_dps", 1.0)
        return Conversion("rad/s", COUNTS, scale, offset, axes, "angular rate from counts")
    if unit in ("", COUNTS):
        note = "angular rate kept as raw counts"
        if not unit:
            note = UNKNOWN_RATE
        return Conversion(COUNTS, COUNTS, np.ones(1), offset, axes, note)
    factor = _factor(unit, units.RATE_UNITS, mapping.gyro_unit, "--gyro-unit", where)
    return Conversion("rad/s", unit, factor, offset, axes)


def temperature(mapping: FieldMapping, stated: str, raw: Array, where: str) -> Conversion:
    """Conversion of raw temperature to °C.

    Without a unit, numbers that all lie in -60..130 are taken as °C, with a note; others stay
    "counts". raw : any sample of the values.
    """
    unit = units.canonical(mapping.temperature_unit or stated)
    unit = "degC" if _MANGLED.fullmatch(unit) else unit
    note = ""
    if not unit:
        known = raw[np.isfinite(raw)]
        unit = "degC" if known.size and known.min() >= -60 and known.max() <= 130 else COUNTS
        note = f"temperature: no unit is stated, taken as {unit}"
    if unit == COUNTS:
        return Conversion(COUNTS, COUNTS, np.ones(1), np.zeros(1), note=note)
    if unit not in _TEMPERATURE:
        raise _unknown(
            unit, "degC, K, degF, counts", mapping.temperature_unit, "--temperature-unit", where
        )
    factor, offset = _TEMPERATURE[unit]
    return Conversion("degC", unit, np.array([factor]), np.array([offset]), note=note)


def _per_axis(values: tuple[float, ...], name: str, default: float) -> Array:
    if len(values) not in (0, 1, 3):
        raise UsageError(f"{name} needs one value, or one an axis", where=f"mapping: {name}")
    return np.array(values or (default,), dtype=np.float64)


def _factor(unit: str, family: dict[str, float], by_user: str, option: str, where: str) -> Array:
    """(1,) or (3,) SI units in one of the file's."""
    each = unit.split(",")
    for one in each:
        if one not in family:
            raise _unknown(one, ", ".join((*family, COUNTS)), by_user, option, where)
    return np.array([family[one] for one in each])


def _unknown(
    unit: str, choices: str, by_user: str, option: str, where: str
) -> UsageError | UnreadableInput:
    if by_user:
        return UsageError(f"unknown unit '{unit}'", where=option, remedy=f"use one of: {choices}")
    return UnreadableInput(
        f"the file states the unknown unit '{unit}'",
        where=where,
        remedy=f"name it with {option}: {choices}",
    )
