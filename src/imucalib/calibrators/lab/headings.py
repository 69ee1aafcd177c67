"""Headings of position tables: which column is what, in the words of the trade and in German."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.columns import without_tex
from imucalib.readers.csv.text import is_number

#: What a column can be, and the names under which it is found, as `bare` gives them.
ROLES: dict[str, tuple[str, ...]] = {
    "inclination": ("inclination", "incl", "inc", "inclinaison", "neigung", "neigungswinkel"),
    "tool_face": (
        "toolface",
        "tool_face",
        "tf",
        "gtf",
        "toolface_angle",
        "tool_face_angle",
        "gravity_toolface",
        "gravity_tool_face",
        "high_side",
        "highside",
        "hstf",
        "hs_tf",
        "high_side_toolface",
        "high_side_tool_face",
        "werkzeuglage",
        "werkzeugwinkel",
        "werkzeug_winkel",
        "werkzeugflaeche",
        "werkzeugfläche",
    ),
    "x": (
        "x",
        "raw_x",
        "ax",
        "a_x",
        "acc_x",
        "accel_x",
        "rawx",
        "gx",
        "g_x",
        "beschleunigung_x",
        "beschl_x",
    ),
    "y": (
        "y",
        "raw_y",
        "ay",
        "a_y",
        "acc_y",
        "accel_y",
        "rawy",
        "gy",
        "g_y",
        "beschleunigung_y",
        "beschl_y",
    ),
    "z": (
        "z",
        "raw_z",
        "az",
        "a_z",
        "acc_z",
        "accel_z",
        "rawz",
        "gz",
        "g_z",
        "beschleunigung_z",
        "beschl_z",
    ),
    "temperature": ("temperature", "temp", "t_sensor", "temperatur"),
    "time": ("time", "t", "zeit"),
    "inclination_approach": ("inclination_approach", "incl_approach"),
    "tool_face_approach": ("tool_face_approach", "toolface_approach", "tf_approach"),
    "inclination_setting": ("inclination_setting",),
    "tool_face_setting": ("tool_face_setting", "toolface_setting"),
    "samples": ("samples", "n"),
    "session": ("session", "power_up", "powerup", "sitzung"),
    "ux": ("ux", "u_x"),
    "uy": ("uy", "u_y"),
    "uz": ("uz", "u_z"),
}
_UNIT = re.compile(
    r"(?:[_\s]*[\[(]\s*|[_\s]+|(?=°))(degrees|degree|deg|grad|rad|degc|c|°|°c|g|mg|ug|m/s2|m/s\^2|"
    r"lsb|counts|volts?|mv|v|s)\s*[\])]?$"
)
#: A temperature with its unit, which for any other quantity would mean another thing.
_WARM = re.compile(
    r"(temperature|temperatur|temp|t_sensor)[\s_\-.]*[\[(]?\s*"
    r"(?:[^\w\s]{1,3}\s*|deg(?:rees?)?[\s_]*)?(c|f|k|celsius|fahrenheit|kelvin)\s*[\])]?"
)
_SCALES = {"c": "degC", "f": "degF", "k": "K"}
#: Roles of columns that may drive what is left: "driver", "driver_2" and so on.
_DRIVER = re.compile(r"driver(_\d+)?")
_SPELLINGS = {"degrees": "deg", "degree": "deg"}
#: Beginnings of German headings, where "Grad" is a degree; elsewhere it may be a gon.
_GERMAN = ("neigung", "werkzeug")
#: "(deg from vertical)": where the inclination's zero is.
_ZERO = re.compile(
    r"\s*\b(?:from|off|to|von|zur|gegen)\s+(?:the\s+|der\s+|die\s+)?"
    r"(vertical|horizontal|vertikalen?|horizontalen?|senkrechten?|waagerechten?)\b"
)
_VERTICAL = ("vert", "senk")


@dataclass(frozen=True)
class Heading:
    """name : bare and in lower case; unit : as stated; zero : "vertical", "horizontal" or "" """

    name: str
    unit: str
    zero: str


def bare(text: str) -> Heading:
    """The parts of a heading such as "Inclination (deg from vertical)"."""
    name, zero = without_tex(text.strip()).lower(), ""
    warm = _WARM.fullmatch(name)
    if warm:
        return Heading(warm[1], _SCALES[warm[2][0]], "")
    found = _ZERO.search(name)
    if found:
        zero = "vertical" if found[1].startswith(_VERTICAL) else "horizontal"
        name = (name[: found.start()] + name[found.end() :]).strip()
        name = re.sub(r"[\[(]\s*[\])]$", "", name).strip()
    unit = _UNIT.search(name) if len(name) > 2 else None
    if unit:
        name = name[: unit.start()]
    name = re.sub(r"[\s\-.]+", "_", name.strip())
    stated = unit.group(1) if unit else ""
    if stated == "grad" and name.startswith(_GERMAN):
        stated = "deg"
    return Heading(name, _SPELLINGS.get(stated, stated), zero)


def is_driver(role: str) -> bool:
    """Whether a column's role is to be looked at as a driver of what is left."""
    return _DRIVER.fullmatch(role) is not None


def driver_name(heading: str) -> str:
    """A driver's heading as names of effects hold it, whose parts colons separate."""
    return heading.strip().replace(":", " ")


def roles_of(headings: list[str], chosen: Mapping[str, str], where: str) -> dict[str, str]:
    """Role -> heading: those chosen, then those found by name.

    Raises UnreadableInput where several fit and UsageError for what is not there.
    """
    names: dict[str, str] = {}
    for role, called in chosen.items():
        heading = called
        if role not in ROLES and not is_driver(role):
            remedy = f"use: {', '.join(ROLES)}, driver, driver_2"
            raise UsageError(f"unknown column role '{role}'", remedy=remedy)
        if heading not in headings and is_driver(role):  # as a calibration names it
            heading = next((h for h in headings if driver_name(h) == heading), heading)
        if heading not in headings:
            remedy = f"there are: {', '.join(headings)}"
            raise UsageError(f"no column is called '{heading}'", where=where, remedy=remedy)
        names[role] = heading
    for role, known in ROLES.items():
        if role in names:
            continue
        hits = [h for h in headings if h.strip().lower() in known or bare(h).name in known]
        hits = [h for h in hits if h not in names.values()]
        if len(hits) > 1:
            raise UnreadableInput(
                f"several columns could be {role}: {', '.join(hits)}",
                where=where,
                remedy=f"choose one with --columns {role}={hits[0]}",
            )
        if hits:
            names[role] = hits[0]
    return names


def says_something(cells: Array | list[str]) -> bool:
    """Whether a column holds numbers, and neither a constant nor a count of the rows."""
    if len(cells) < 2 or not all(is_number(str(cell)) for cell in cells):
        return False
    return bool(np.ptp(np.diff([float(cell) for cell in cells])) > 0.0)
