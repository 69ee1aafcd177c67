"""What a file's columns are, by their names: quantity, axis, triad and unit; and the list of them.

Column names of loggers differ in case, separators and order, but are made of the same words. Where
they do not tell, the user gets the contents of the file, field by field.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from imucalib.arrays import Array
from imucalib.units import ACCELERATION_UNITS, RATE_UNITS, canonical, without_brackets

T = TypeVar("T")


def by_word(table: Mapping[T, str]) -> dict[str, T]:
    """Every word of the texts of a table, and whose it is."""
    return {word: value for value, words in table.items() for word in words.split()}


_MEANING = by_word(
    {
        "acceleration": "a acc accel acceleration accelerometer accelerations accelero "
        "beschleunigung beschl beschleunigungssensor accelerometre aceleracion aceleraciones "
        "acelerometro acel",
        "angular_rate": "g w gyr gyro gyros gyroscope omega angular angvel angrate drehrate "
        "gyroskop gyrometre drehgeschwindigkeit giroscopo giro",
    }
)
_TEMPERATURE = {"temp", "temperature", "temps", "temperatur", "temperatura"}
_TIME = set(
    str.split(
        "time timestamp timestamps stamp t datetime seconds secs sec sampletimefine utc epoch "
        "elapsed stamps zeit zeitstempel uhrzeit tiempo hora heure horodatage"
    )
)
_SILENT = set(
    str.split(
        "rs s b field data raw cal calibrated uncal linear angular velocity rate imu sensor "
        "sensors axis value values header acceleration meas rot rotation vel speed achse axe eje "
        "de en la le"
    )
)
# Quantities that share words with the two above but are not them.
_OTHER = set(
    str.split(
        "mag magnetometer magnetic free freeacc gravity grav mean std var enmo mad cov covariance "
        "quat quaternion orientation bias svm vm norm inc velinc oriinc pos position user ori "
        "offset euler counts1 vector magnitude b_w b_a"
    )
)
_COMPACT = re.compile(
    r"^(accel|acc|a|gyro|gyr|g|w|omega)_?(\d*)_?([xyz])(\d*)$|^([xyz])_?(accel|acc|gyro|gyr)(\d*)$"
)
_BRACKETED = re.compile(r"\s*(\[[^\[\]]*\]|\((?:[^()]|\([^()]*\))*\))\s*$")
#: A unit behind a name without brackets, where it is written with a slash: "acc_x_m/s^2".
_SLASHED = re.compile(r"[\s_.\-]+([^\s_]+/[^\s_]+|[^\s_]+/\(?s\^?2\)?)$")
_TEX = re.compile(r"\\(?:hat|vec|bar|tilde|mathrm|mathbf|text|dot)\s*|[\\${}]|\^\{?\\circ\}?")
_UNIT_WORDS = by_word(
    {
        "m/s2": "ms2 mps2 mss",
        "mg": "mg",
        "ug": "ug",
        "rad/s": "rads rps",
        "deg/s": "dps degs",
        "degC": "degc celsius",
        "ns": "ns nsec nanoseconds nanosec",
        "us": "us usec microseconds",
        "ms": "ms msec milliseconds",
        "counts": "counts lsb",
        "s": "seconds sec secs",
    }
)
# Last words of a temperature's name, joined; "tempC" and "temp_degC" are split before the C.
_TEMPERATURE_UNITS = by_word(
    {
        "degC": "c degc celsius degreesc",
        "degF": "f degf fahrenheit degreesf",
        "K": "k kelvin degk",
    }
)
#: Units that a name may state of a column without saying that it is a time, and last words that
#: name the unit of one that does ("elapsed_min"; of "acc_x_min" it is a minimum).
_STAMP_UNITS = {"s", "ms", "us", "ns", "100us"}
_TIME_WORDS = by_word(
    {
        "min": "min mins minutes minute",
        "h": "h hr hrs hours hour",
        "d": "d day days",
        "s": "s",
        "datenum": "datenum",
        "filetime": "filetime",
        "ticks": "ticks",
    }
)
#: Parts of a stamp in columns of their own, in its order; i and u are whole ms and us.
_PARTS = {
    "Y": "year yr",
    "M": "month mon",
    "D": "day",
    "h": "hour hr hours",
    "m": "minute min minutes",
    "s": "second sec seconds secs",
    "i": "millisecond ms msec milliseconds",
    "u": "microsecond us usec microseconds",
}
_PART_OF = by_word(_PARTS)


@dataclass(frozen=True)
class Column:
    """Meaning of one column.

    index : position, from 0; name : as in the file, without its unit
    quantity : "acceleration", "angular_rate", "temperature", "time" or "" (not used)
    axis : 0, 1, 2 or -1; triad : sensor name; unit : as stated by the name, or ""
    """

    index: int
    name: str
    quantity: str = ""
    axis: int = -1
    triad: str = ""
    unit: str = ""


def understand(names: Sequence[str], bare: str = "acceleration") -> list[Column]:
    """The meaning of every column name; bare x, y, z are `bare` ("angular_rate" in the file of a
    gyroscope), or a rate by their unit, if nothing else is an acceleration.
    """
    columns = [_column(i, name) for i, name in enumerate(names)]
    if not any(c.quantity == "time" for c in columns):  # the French word, without a unit
        columns = [
            replace(c, quantity="time", triad="")
            if _words(c.name) == ["temps"] and not c.unit
            else c
            for c in columns
        ]
    columns = _of_kalibr(columns)
    if not any(c.quantity == "acceleration" for c in columns):
        columns = [_bare_axis(c, bare) for c in columns]
    return columns


def unaccented(text: str) -> str:
    """Letters without their accents; the Spanish ordinal that stands for a degree as one."""
    parts = unicodedata.normalize("NFD", text.replace("º", "°"))
    return "".join(c for c in parts if unicodedata.category(c) != "Mn")


def without_tex(text: str) -> str:
    """A heading without the marks of TeX that a copy of a paper's has: "$\\hat{a}_x$" is "a_x"."""
    return _TEX.sub("", text).strip() if "$" in text or "\\" in text else text


def is_date(name: str) -> bool:
    """Whether a name says that the column holds dates, which may have a time of day elsewhere."""
    return _words(name) in (["date"], ["datum"], ["day"], ["local", "date"], ["utc", "date"])


def parts_of_time(names: Sequence[str]) -> dict[str, int]:
    """Letter of each part of a stamp -> index, in order, where all from year to second are there.

    The letters are those of `TextTime.order`.
    """
    found: dict[str, int] = {}
    for k, words in enumerate(map(_words, names)):
        if len(words) == 1 and words[0] in _PART_OF:
            found.setdefault(_PART_OF[words[0]], k)
    if not {"Y", "M", "D", "h", "m", "s"} <= found.keys():
        return {}
    return {letter: found[letter] for letter in _PARTS if letter in found}


def _of_kalibr(columns: list[Column]) -> list[Column]:
    """Kalibr calls the acceleration alpha, with a rate called omega; else that is no force."""
    names = {c.name.lower() for c in columns}
    known = {f"{letter}_{axis}" for letter in ("omega", "alpha") for axis in "xyz"}
    if not names >= known or any(c.quantity == "acceleration" for c in columns):
        return columns
    return [
        replace(c, quantity="acceleration", axis="xyz".index(c.name.lower()[-1]), triad="imu0")
        if re.fullmatch("alpha_[xyz]", c.name.lower())
        else c
        for c in columns
    ]


def _bare_axis(column: Column, bare: str) -> Column:
    words = [w for w in _words(column.name) if w != "axis"]
    if words[1:] == ["g"] and column.quantity in ("", "angular_rate"):
        column = replace(column, quantity="", unit="g")  # where nothing else is an acceleration
    if len(words) == 2 and column.unit in ("g", _UNIT_WORDS.get(words[1])):
        words = words[:1]
    unit = canonical(column.unit)
    if unit in ("", "counts"):
        quantity = bare
    else:
        quantity = "acceleration" if unit in ACCELERATION_UNITS else "angular_rate"
        quantity = quantity if unit in {**ACCELERATION_UNITS, **RATE_UNITS} else ""
    if column.quantity or not quantity or len(words) != 1 or words[0] not in ("x", "y", "z"):
        return column
    return replace(column, quantity=quantity, axis="xyz".index(words[0]), triad="imu0")


def _words(name: str) -> list[str]:
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name)
    return [w for w in re.split(r"[^0-9a-zµ]+", unaccented(spaced).lower()) if w]


def _column(index: int, text: str) -> Column:
    name, unit = without_tex(text.strip().lstrip("#%").strip()), ""
    found = _BRACKETED.search(name)
    slashed = None if found else _SLASHED.search(name)
    if found:
        name, unit = name[: found.start()].strip(), without_brackets(found.group(1))
    elif slashed and canonical(slashed[1]) in {**ACCELERATION_UNITS, **RATE_UNITS}:
        name, unit = name[: slashed.start()], slashed[1]
    words = _words(name)
    if not unit and len(words) > 1:
        unit = _UNIT_WORDS.get(words[-1], "")
        if not unit and len(words) > 2 and words[-1] == "g" and words[-2] in ("x", "y", "z"):
            unit = "g"
        words = words[:-1] if unit else words
    column = _vector(index, name, words, unit)
    if column is not None:
        return column
    if words == ["temps"] and (canonical(unit) in _STAMP_UNITS or unit in _TIME_WORDS):
        return Column(index, name, "time", unit=unit)  # the French word
    if name == "T" or _TEMPERATURE & set(words):
        words, unit = (words, unit) if unit else _with_unit(words)
        words = [w for w in words if w not in _MEANING]
        return Column(index, name, "temperature", triad=_triad(words), unit=unit)
    if _TIME & set(words) or (unit in _STAMP_UNITS and not _OTHER & set(words)):
        stated = _TIME_WORDS.get(words[-1], "") if len(words) > 1 else ""
        return Column(
            index, name, "time", unit=unit or stated or _UNIT_WORDS.get("".join(words), "")
        )
    return Column(index, name, unit=unit)


def _with_unit(words: list[str]) -> tuple[list[str], str]:
    """The words of a temperature without its unit, and the unit: one last word, or two."""
    for last in (2, 1):
        unit = _TEMPERATURE_UNITS.get("".join(words[-last:])) if len(words) > last else None
        if unit:
            return words[:-last], unit
    return words, ""


def _vector(index: int, name: str, words: list[str], unit: str) -> Column | None:
    """The column as one axis of an acceleration or an angular rate, if it is one."""
    if _OTHER & set(words):
        return None
    for position, word in enumerate(words):
        match = _COMPACT.match(word)
        if match:
            kind = match.group(1) or match.group(6)
            axis = "xyz".index(match.group(3) or match.group(5))
            number = match.group(2) or match.group(4) or match.group(7)
            rest = words[:position] + words[position + 1 :]
            break
    else:
        axes = [w for w in words if w in ("x", "y", "z")]
        kinds = [w for w in words if w.rstrip("0123456789") in _MEANING]
        if len(axes) != 1 or not kinds:
            return None
        axis = "xyz".index(axes[0])
        kind = kinds[0].rstrip("0123456789")
        number = kinds[0][len(kind) :]
        rest = [w for w in words if w not in (axes[0], kinds[0])]
    triad = _triad([w for w in rest if w not in _MEANING], number)
    return Column(index, name, _MEANING[kind], axis, triad, unit)


def _triad(words: Sequence[str], number: str = "") -> str:
    own = [w for w in words if w not in _SILENT | _TEMPERATURE | {"t"}]
    return "_".join(own + [f"imu{number}"] * bool(number)) or "imu0"


_SHOWN = 12
#: Median norms that gravity has in the units in use, within this factor.
_GRAVITY, _WITHIN = (9.80665, 1.0, 1000.0), 1.15


@dataclass(frozen=True)
class Content:
    """One topic, column, dataset or field.

    address : what the options --acc, --gyro and --time take
    kind : type, encoding, shape, as the format says it
    count : messages or rows; rate : Hz, NaN when unknown
    norm : median norm of a 3-vector in the file's unit, else NaN; median : of a single number
    why : why it could not be read, or empty
    """

    address: str
    kind: str
    count: int
    rate: float = math.nan
    norm: float = math.nan
    median: float = math.nan
    why: str = ""

    def __str__(self) -> str:
        parts = [f"{self.count} x" if self.count else "", self.kind]
        parts += [f"{self.rate:.4g} Hz" if math.isfinite(self.rate) else ""]
        parts += [f"median norm {self.norm:.5g}" if math.isfinite(self.norm) else ""]
        parts += [f"median {self.median:.6g}" if math.isfinite(self.median) else "", self.why]
        return f"{self.address}: {', '.join(filter(None, parts))}"

    @property
    def like_gravity(self) -> bool:
        """Whether the norm is that of gravity in m/s², g or mg."""
        return any(g / _WITHIN <= self.norm <= g * _WITHIN for g in _GRAVITY)


def norm_of(values: Array) -> float:
    """Median norm of (n, 3) values, the incomplete ones left out; NaN when none is left."""
    norms = np.linalg.norm(values[np.isfinite(values).all(axis=1)], axis=1)
    return float(np.median(norms)) if norms.size else math.nan


def listing(contents: Sequence[Content]) -> str:
    """One indented line each, for an error's text."""
    lines = [f"\n  {content}" for content in contents[:_SHOWN]]
    more = len(contents) - _SHOWN
    return "".join(lines) + (f"\n  and {more} more" if more > 0 else "")


def suggestion(contents: Sequence[Content]) -> str:
    """The field whose norm is that of gravity, as an option; empty when there is none or two."""
    fitting = [c.address for c in contents if c.like_gravity]
    return f"; the norm of gravity is in: --acc {fitting[0]}" if len(fitting) == 1 else ""
