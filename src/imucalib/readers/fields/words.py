"""What the names of fields mean: quantity, axis, sensor and unit. One table of words for columns of
text, datasets and fields of messages.

Names of loggers differ in case, separators and order, but are made of the same words.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from imucalib.units import ACCELERATION_UNITS, RATE_UNITS, canonical, strip_brackets

T = TypeVar("T")
INERTIAL = ("acceleration", "angular_rate")
#: Two words that are one.
_PHRASES = {
    ("rotation", "rate"): "rotationrate",
    ("rotation", "rates"): "rotationrate",
    ("rot", "rate"): "rotationrate",
    ("turn", "rate"): "turnrate",
    ("body", "rate"): "bodyrate",
    ("body", "rates"): "bodyrate",
    ("ang", "vel"): "angvel",
    ("ang", "velocity"): "angvel",
    ("ang", "rate"): "angrate",
    ("specific", "force"): "specificforce",
    **{("angular", word): "derivative" for word in ("acceleration", "accel", "acc")},
    **{("ang", word): "derivative" for word in ("acceleration", "accel", "acc")},
}
_TEMPERATURE = {"temp", "temperature", "temps", "temperatur", "temperatura"}
_TIME = set(
    str.split(
        "time timestamp timestamps times stamp t datetime seconds secs sec sampletimefine utc "
        "epoch elapsed stamps zeit zeitstempel uhrzeit tiempo hora heure horodatage"
    )
)
#: Whole names of a stamp, best first.
_INSTANTS = ("stamp", "timestamp", "timestamps", "time", "times", "t")
_SILENT = set(
    str.split(
        "rs s b field data raw cal calibrated uncal uncalib linear lin angular velocity rate imu "
        "sensor sensors axis value values header acceleration meas rot rotation vel speed achse "
        "axe eje de en la le counts xyz"
    )
)
#: Quantities that share words with the two above but are not them.
_OTHER = set(
    str.split(
        "mag magnetometer magnetic free freeacc gravity grav mean std var enmo mad cov covariance "
        "quat quaternion orientation bias biases svm vm norm inc velinc oriinc pos position user "
        "ori offset euler counts1 vector magnitude b_w b_a derivative delta scale noise sigma "
        "variance stddev matrix quality status flag flags valid mask error count id"
    )
)
#: What is told in x, y, z as well, by the name of its file or topic.
_NO_FORCE = set(
    str.split("mag magnetometer magnetic magfield compass gravity orientation euler quaternion")
)
#: Parts of a path that name no sensor.
_GENERIC = {""} | set(
    str.split(
        "sensors data raw calibrated imu readings table value values processed x linear angular"
    )
)
#: Three names that are one vector where nothing else is one: p, q, r of a body; f of a force.
#: Kalibr calls the acceleration alpha, with a rate called omega; else that is no force.
_TRIPLES = {
    ("p", "q", "r"): "angular_rate",
    ("rollrate", "pitchrate", "yawrate"): "angular_rate",
    ("rollspeed", "pitchspeed", "yawspeed"): "angular_rate",
    ("fx", "fy", "fz"): "acceleration",
    ("sfx", "sfy", "sfz"): "acceleration",
    ("alphax", "alphay", "alphaz"): "acceleration",
}
_WITH_ALPHA = {"omegax", "omegay", "omegaz"}
_BRACKETED = re.compile(r"\s*(\[[^\[\]]*\]|\((?:[^()]|\([^()]*\))*\))\s*$")
#: A unit behind a name without brackets, where it is written with a slash: "acc_x_m/s^2".
_SLASHED = re.compile(r"[\s_.\-]+([^\s_]+/[^\s_]+|[^\s_]+/\(?s\^?2\)?)$")
_TEX = re.compile(r"\\(?:hat|vec|bar|tilde|mathrm|mathbf|text|dot)\s*|[\\${}]|\^\{?\\circ\}?")
_RATE_WORDS = {"rad": "rad/s", "deg": "deg/s"}  # last words of the name of a rate alone
#: Units that a name may state of a column without saying that it is a time, and last words that
#: name the unit of one that does ("elapsed_min"; of "acc_x_min" it is a minimum).
_STAMP_UNITS = {"s", "ms", "us", "ns", "100us"}
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
Name = str | tuple[str, ...]


def by_word(table: Mapping[T, str]) -> dict[str, T]:
    """Every word of the texts of a table, and whose it is."""
    return {word: value for value, words in table.items() for word in words.split()}


_KINDS = by_word(
    {
        "acceleration": "a acc acce accel acceleration accelerometer accelerations accelero linacc "
        "linaccel linacce linearacceleration specificforce beschleunigung beschl "
        "beschleunigungssensor accelerometre aceleracion aceleraciones acelerometro acel",
        "angular_rate": "g w gyr gyro gyros gyroscope omega angular angvel angrate rotationrate "
        "rotrate turnrate bodyrate angularvelocity angularvelocities angularrate drehrate "
        "gyroskop gyrometre drehgeschwindigkeit giroscopo giro",
    }
)
_NAMES = "|".join(sorted(_KINDS, key=len, reverse=True))
_LONG = "|".join(sorted((word for word in _KINDS if len(word) > 1), key=len, reverse=True))
_COMPACT = re.compile(rf"^({_NAMES})(\d*)([xyz])(\d*)$|^([xyz])({_LONG})(\d*)$")
#: Last words of a name that state its unit.
_UNIT_WORDS = by_word(
    {
        "m/s2": "ms2 mps2 mss m_s2 m_s_2",
        "mg": "mg",
        "ug": "ug",
        "rad/s": "rads rps radps rad_s",
        "deg/s": "dps degs degps deg_s",
        "mdeg/s": "mdps mdegs mdegps",
        "mrad/s": "mrads mradps",
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
_PART_OF = by_word(_PARTS)


@dataclass(frozen=True)
class Meaning:
    """What a name says.

    index : position of the field, from 0; name : as in the file, without its unit
    quantity : "acceleration", "angular_rate", "temperature", "time" or "" (none of these)
    axis : 0, 1, 2; -1 of a whole vector, and of what has none
    triad : name of the sensor; of a time, the quantity that it is of ("acc_time"), or ""
    unit : as stated by the name, or ""
    """

    index: int
    name: str
    quantity: str = ""
    axis: int = -1
    triad: str = ""
    unit: str = ""

    @property
    def is_axis(self) -> bool:
        """Whether the field is one axis of an acceleration or an angular rate."""
        return self.axis >= 0

    @property
    def is_vector(self) -> bool:
        """Whether the name is that of a whole acceleration or angular rate."""
        return self.axis < 0 and self.quantity in INERTIAL


def understand(names: Sequence[Name], bare: str = "acceleration") -> list[Meaning]:
    """The meaning of every name; of a path, (group, group, name), its last part that has one.

    bare : what x, y, z alone are, from `bare_quantity`, if nothing else is an acceleration; by
        their unit where they have one
    """
    found = [_meaning(i, name) for i, name in enumerate(names)]
    if not any(m.quantity == "time" for m in found):  # the French word, without a unit
        found = [
            replace(m, quantity="time", triad="")
            if _words(m.name) == ["temps"] and not m.unit
            else m
            for m in found
        ]
    for names_of_three, quantity in _TRIPLES.items():
        if not any(m.quantity == quantity and m.is_axis for m in found):
            found = _of_three(found, names_of_three, quantity)
    if not any(m.quantity == "acceleration" for m in found):
        found = [_bare_axis(m, bare) for m in found]
    return found


def bare_quantity(name: str) -> str:
    """What x, y, z alone are in a file or topic of a name, or "" for neither of the two."""
    words = _join_words(_words(name))
    kinds = {_KINDS[word] for word in words if len(word) > 1 and word in _KINDS}
    if "acceleration" in kinds or not (kinds or _NO_FORCE & set(words)):
        return "acceleration"
    return "angular_rate" if kinds else ""


def triples_of(names: Sequence[str]) -> list[tuple[int, int, int]]:
    """Where three names differ in nothing but x, y, z."""
    at = {name: k for k, name in reversed(list(enumerate(names)))}
    found = list[tuple[int, int, int]]()
    for k, name in enumerate(names):
        for axes in ("xyz", "XYZ"):
            for place in (m.start() for m in re.finditer(axes[0], name)):
                three = [f"{name[:place]}{axis}{name[place + 1 :]}" for axis in axes]
                if at[name] == k and all(other in at for other in three):
                    found.append((k, at[three[1]], at[three[2]]))
    return found


def instant_rank(name: str) -> int:
    """How well a whole name, its unit left out, says that it is a stamp: 0 is best; -1 for none."""
    words = _words(name)
    while len(words) > 1 and words[-1] in {**_UNIT_WORDS, **_TIME_WORDS}:
        words = words[:-1]
    whole = "".join(words)
    return _INSTANTS.index(whole) if whole in _INSTANTS else -1


def strip_accents(text: str) -> str:
    """Letters without their accents; the Spanish ordinal that stands for a degree as one."""
    parts = unicodedata.normalize("NFD", text.replace("º", "°"))
    return "".join(c for c in parts if unicodedata.category(c) != "Mn")


def strip_tex(text: str) -> str:
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


def _plain(name: str) -> str:
    return "".join(_words(name))


def _of_three(found: list[Meaning], three: Sequence[str], quantity: str) -> list[Meaning]:
    at = {p: m.index for m in reversed(found) if (p := _plain(m.name)) in three and not m.quantity}
    alone = three[0] == "alphax" and not _WITH_ALPHA.issubset(_plain(m.name) for m in found)
    if len(at) < 3 or alone:
        return found
    axis_of = {at[name]: axis for axis, name in enumerate(three)}
    return [
        replace(m, quantity=quantity, axis=axis_of[m.index], triad="imu0")
        if m.index in axis_of
        else m
        for m in found
    ]


def _bare_axis(one: Meaning, bare: str) -> Meaning:
    words = [w for w in _words(one.name) if w != "axis"]
    if words[1:] == ["g"] and one.quantity in ("", "angular_rate"):
        one = replace(one, quantity="", unit="g")  # where nothing else is an acceleration
    if len(words) == 2 and one.unit in ("g", _UNIT_WORDS.get(words[1])):
        words = words[:1]
    unit = canonical(one.unit)
    if unit in ("", "counts"):
        quantity = bare
    else:
        quantity = "acceleration" if unit in ACCELERATION_UNITS else "angular_rate"
        quantity = quantity if unit in {**ACCELERATION_UNITS, **RATE_UNITS} else ""
    if one.quantity or not quantity or len(words) != 1 or words[0] not in ("x", "y", "z"):
        return one
    return replace(one, quantity=quantity, axis="xyz".index(words[0]), triad=one.triad or "imu0")


def _words(name: str) -> list[str]:
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name)
    return [w for w in re.split(r"[^0-9a-zµ]+", strip_accents(spaced).lower()) if w]


def _meaning(index: int, name: Name) -> Meaning:
    """Of a column's name, or of a path: of the last part that says something."""
    if isinstance(name, str):
        return _of_part(index, name)
    axis = f"_{name[-1]}" if len(name) > 1 and name[-1].lower() in ("x", "y", "z") else ""
    parts = name[:-1] if axis else name
    for k in range(len(parts) - 1, -1, -1):
        found, words = _of_part(index, parts[k] + axis), set(_words(parts[k]))
        forces = any(_of_part(0, part).quantity == "acceleration" for part in parts[:k])
        known = bool(_OTHER & words) or (words == {"angular"} and forces)
        if known or (found.quantity == "time" and k < len(parts) - 1):
            break  # the angular acceleration of geometry_msgs/Accel, a clock's folder
        if found.quantity == "time":
            return found
        if found.quantity:
            above = _sensor_of(parts[:k])
            own = found.triad if found.triad != "imu0" else above or "imu0"
            return replace(found, triad=own if found.triad else above)
    last = _of_part(index, name[-1])
    return Meaning(index, last.name, triad=_sensor_of(name[:-1]), unit=last.unit)


def _sensor_of(parts: Sequence[str]) -> str:
    """The sensor that the groups of a path name, or ""."""
    return "_".join(p for p in parts if p.lower() not in _GENERIC)


def _of_part(index: int, text: str) -> Meaning:
    name, unit = strip_tex(text.strip().lstrip("#%").strip()), ""
    found = _BRACKETED.search(name)
    slashed = None if found else _SLASHED.search(name)
    if found:
        name, unit = name[: found.start()].strip(), strip_brackets(found.group(1))
    elif slashed and canonical(slashed[1]) in {**ACCELERATION_UNITS, **RATE_UNITS}:
        name, unit = name[: slashed.start()], slashed[1]
    words = _words(name)
    if not unit:
        words, unit = _without_unit(words)
    column = _inertial(index, name, words, unit)
    if column is not None and column.is_axis:
        return column
    if words == ["temps"] and (canonical(unit) in _STAMP_UNITS or unit in _TIME_WORDS):
        return Meaning(index, name, "time", unit=unit)  # the French word
    if name == "T" or _TEMPERATURE & set(words):
        words, unit = (words, unit) if unit else _with_unit(words)
        words = [w for w in words if w not in _KINDS]
        return Meaning(index, name, "temperature", triad=_triad(words), unit=unit)
    if _TIME & set(words) or (unit in _STAMP_UNITS and not _OTHER & set(words)):
        stated = _TIME_WORDS.get(words[-1], "") if len(words) > 1 else ""
        unit = unit or stated or _UNIT_WORDS.get("".join(words), "")
        return Meaning(index, name, "time", triad=column.quantity if column else "", unit=unit)
    return column or Meaning(index, name, unit=unit)


def _without_unit(words: list[str]) -> tuple[list[str], str]:
    """The words of a name without those that state its unit, and the unit or ""."""
    for last in (3, 2, 1):
        unit = _UNIT_WORDS.get("_".join(words[-last:])) if len(words) > last else None
        if unit:
            return words[:-last], unit
    if len(words) > 2 and words[-1] == "g" and words[-2] in ("x", "y", "z"):
        return words[:-1], "g"
    return words, ""


def _with_unit(words: list[str]) -> tuple[list[str], str]:
    """The words of a temperature without its unit, and the unit: one last word, or two."""
    for last in (2, 1):
        unit = _TEMPERATURE_UNITS.get("".join(words[-last:])) if len(words) > last else None
        if unit:
            return words[:-last], unit
    return words, ""


def _join_words(words: Sequence[str]) -> list[str]:
    """The words, two that are one joined."""
    out = list[str]()
    for word in words:
        both = _PHRASES.get((out[-1], word)) if out else None
        out[-1:] = [both] if both else [*out[-1:], word]
    return out


def _inertial(index: int, name: str, words: list[str], unit: str) -> Meaning | None:
    """An acceleration or an angular rate, or one axis of it; None of another."""
    words = _join_words(words)
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
        kinds = [w for w in words if w.rstrip("0123456789") in _KINDS]
        # One letter means something only with an axis.
        kinds = kinds if axes else [w for w in kinds if len(w.rstrip("0123456789")) > 1]
        if len(axes) > 1 or not kinds:
            return None
        axis = "xyz".index(axes[0]) if axes else -1
        kind = kinds[0].rstrip("0123456789")
        number = kinds[0][len(kind) :]
        rest = [w for w in words if w not in (*axes, kinds[0])]
    if not unit and rest and _KINDS[kind] == "angular_rate" and rest[-1] in _RATE_WORDS:
        unit = _RATE_WORDS[rest.pop()]
    triad = _triad([w for w in rest if w not in _KINDS], number)
    return Meaning(index, name, _KINDS[kind], axis, triad, unit)


def _triad(words: Sequence[str], number: str = "") -> str:
    own = [w for w in words if w not in _SILENT | _TEMPERATURE | {"t"}]
    return "_".join(own + [f"imu{number}"] * bool(number)) or "imu0"
