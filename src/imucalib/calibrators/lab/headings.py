"""Headings of position tables: which column is what, in the words of the trade."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput, UsageError
from imucalib.question import paste
from imucalib.readers.csv.text import is_number
from imucalib.readers.fields.words import strip_accents, strip_tex

_UNIT = re.compile(
    r"(?:[_\s]*[\[(]\s*|[_\s]+|(?=°))(degrees|degree|degres|degre|deg|grados|grado|grad|rad|degc|c|°|°c|g|mg|ug|m/s2|m/s\^2|"
    r"lsb|counts|volts?|mv|v|s)\s*[\])]?$"
)
#: A temperature with its unit, which for any other quantity would mean another thing.
_WARM = re.compile(
    r"(temperature|temperatura|temperatur|temp|t_sensor)[\s_\-.]*[\[(]?\s*"
    r"(?:[^\w\s]{1,3}\s*|deg(?:rees?)?[\s_]*)?(c|f|k|celsius|fahrenheit|kelvin)\s*[\])]?"
)
_SCALES = {"c": "degC", "f": "degF", "k": "K"}
#: Roles of columns that bias and scale may follow: "driver", "driver_2" and so on.
_COVARIATE = re.compile(r"driver(_\d+)?")
_SPELLINGS = dict.fromkeys(("degrees", "degree", "degres", "degre", "grados", "grado"), "deg")
#: Beginnings of German headings, where "Grad" is a degree; elsewhere it may be a gon.
_GERMAN = ("neigung", "inklination", "werkzeug")
#: "(deg from vertical)": where the inclination's zero is.
_ZERO = re.compile(
    r"\s*\b(?:from|off|to|von|zur|gegen|de|depuis|desde|par rapport a|respecto a)\s+"
    r"(?:the\s+|der\s+|die\s+|la\s+|l['’]\s*)?"
    r"(verticale?|horizontale?|vertikalen?|horizontalen|senkrechten?|waagerechten?)\b"
)
_VERTICAL = ("vert", "senk")


def _words(text: str) -> tuple[str, ...]:
    return tuple(text.split())


#: Words for what an accelerometer reads, which an axis follows or precedes.
_READ = _words(
    """
    raw a acc accel acceleration accelerometer g beschleunigung beschl roh brut brute acel
    aceleracion crudo bruto
    """
)
_AXIS = _words("axis achse axe eje")


def _axis(letter: str) -> tuple[str, ...]:
    """Names of a reading's column."""
    own = (letter, f"a{letter}", f"raw{letter}", f"g{letter}")
    before = (f"{word}_{letter}" for word in (*_READ, *_AXIS))
    # x_g is x in g.
    after = (f"{letter}_{word}" for word in (*_READ, "achse", "axis") if word != "g")
    return (*own, *before, *after)


#: What a column can be, and the names under which it is found, as `bare` gives them: without
#: accents, in the words of the trade in English, German, French and Spanish.
ROLES: dict[str, tuple[str, ...]] = {
    "inclination": _words(
        """
        inclination incl inc neigung neigungswinkel inklination inclinaison angle_d_inclinaison
        inclinacion angulo_de_inclinacion
        """
    ),
    "tool_face": _words(
        """
        toolface tool_face tf gtf toolface_angle tool_face_angle gravity_toolface gravity_tool_face
        high_side highside hstf hs_tf high_side_toolface high_side_tool_face werkzeuglage
        werkzeugwinkel werkzeug_winkel werkzeugflaeche werkzeugflache werkzeugstellung face_outil
        face_de_l_outil angle_face_outil angle_de_face_outil angle_outil orientation_outil
        cara_de_herramienta cara_de_la_herramienta cara_herramienta angulo_de_herramienta
        angulo_de_la_herramienta
        """
    ),
    "x": _axis("x"),
    "y": _axis("y"),
    "z": _axis("z"),
    "temperature": _words("temperature temp t_sensor temperatur temperatura"),
    "time": _words("time t zeit uhrzeit temps heure tiempo hora"),
    "inclination_approach": _words("inclination_approach incl_approach"),
    "tool_face_approach": _words("tool_face_approach toolface_approach tf_approach"),
    "inclination_setting": ("inclination_setting",),
    "tool_face_setting": ("tool_face_setting", "toolface_setting"),
    "samples": ("samples", "n"),
    "session": _words("session power_up powerup sitzung seance sesion"),
    **{f"u{axis}": (f"u{axis}", f"u_{axis}") for axis in "xyz"},
}


@dataclass(frozen=True)
class Heading:
    """name : bare and in lower case; unit : as stated; zero : "vertical", "horizontal" or "" """

    name: str
    unit: str
    zero: str


def bare(text: str) -> Heading:
    """The parts of a heading such as "Inclination (deg from vertical)"."""
    name, zero = strip_accents(strip_tex(text.strip())).lower(), ""
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
    name = re.sub(r"[\s\-.'’]+", "_", name.strip())
    stated = unit.group(1) if unit else ""
    if stated == "grad" and name.startswith(_GERMAN):
        stated = "deg"
    return Heading(name, _SPELLINGS.get(stated, stated), zero)


def is_covariate(role: str) -> bool:
    """Whether bias and scale may follow a column of this role."""
    return _COVARIATE.fullmatch(role) is not None


def covariate_name(heading: str) -> str:
    """A covariate's heading as names of effects hold it, whose parts colons separate."""
    return heading.strip().replace(":", " ")


def roles_of(headings: list[str], chosen: Mapping[str, str], where: str) -> dict[str, str]:
    """Role -> heading: those chosen, then those found by name.

    Raises UnreadableInput where several fit and UsageError for what is not there.
    """
    names: dict[str, str] = {}
    for role, called in chosen.items():
        heading = called
        if role not in ROLES and not is_covariate(role):
            remedy = f"use: {', '.join(ROLES)}, driver, driver_2"
            raise UsageError(f"unknown column role '{role}'", remedy=remedy)
        if heading not in headings and is_covariate(role):  # as a calibration names it
            heading = next((h for h in headings if covariate_name(h) == heading), heading)
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
                remedy=f"choose one with {paste('--columns', f'{role}={hits[0]}')}",
            )
        if hits:
            names[role] = hits[0]
    return names


def says_something(cells: Array | list[str]) -> bool:
    """Whether a column holds numbers, and neither a constant nor a count of the rows."""
    if len(cells) < 2 or not all(is_number(str(cell)) for cell in cells):
        return False
    return bool(np.ptp(np.diff([float(cell) for cell in cells])) > 0.0)
