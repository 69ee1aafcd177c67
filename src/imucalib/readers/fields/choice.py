"""Which fields of a file are read, and as what: by their names, or as the user states it; for every
format. A format says what its fields are called and how many numbers a row of them holds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from imucalib.readers.fields.words import INERTIAL, Meaning, Name
from imucalib.recording.mapping import FieldMapping

#: Quantities of channels, in the order in which they are given, and what a mapping calls them.
OPTIONS = {"acceleration": "acc", "angular_rate": "gyro", "temperature": "temperature"}


@dataclass(frozen=True)
class Field:
    """Numbers that each row of a table holds.

    name : a column's heading, or the names of what it lies in and its own
    width : how many they are; 0 of what is no number
    rows : of its table, where a file has several; number : of the vector, in a field of several
    """

    name: Name
    width: int = 1
    rows: int = 0
    number: int = -1


@dataclass(frozen=True)
class Vector:
    """One quantity of one sensor.

    parts : the fields that make it: three of one number, or one
    unit : that their names state, of all axes or one an axis: "m/s2,m/s2,g"
    numbered : whether `triad` is only a number, since nothing in the file names the sensor
    clock : the field of its own stamps, where it has one
    """

    quantity: str
    triad: str
    parts: tuple[int, ...]
    unit: str = ""
    numbered: bool = False
    clock: int = -1

    @property
    def name(self) -> str:
        """Of its channel."""
        return f"{self.triad}/{self.quantity}"


def join_units(units: Sequence[str]) -> str:
    """The unit of all axes, or one an axis where they differ."""
    return units[0] if len(set(units)) == 1 else ",".join(units)


def vector_of(quantity: str, triad: str, parts: Sequence[int], told: Sequence[Meaning]) -> Vector:
    """A vector with the unit that the names of its fields state."""
    unit = join_units([told[k].unit for k in parts]) if told else ""
    return Vector(quantity, triad, tuple(parts), unit)


def find_vectors(fields: Sequence[Field], told: Sequence[Meaning]) -> list[Vector]:
    """The vectors and temperatures that names tell, one of each quantity of a sensor: that which is
    not called linear (gravity may lack), then the one that lies in the fewest groups.

    told : what the name of each field means, from `words.understand`
    """
    found, axes = list[tuple[bool, int, Vector]](), dict[tuple[Any, ...], dict[int, int]]()
    for k, (field, one) in enumerate(zip(fields, told, strict=True)):
        path = (field.name,) if isinstance(field.name, str) else field.name
        linear, depth = "linear" in "/".join(path).lower(), len(path)
        if one.is_axis and field.width == 1:
            key = linear, depth - (len(path[-1]) == 1), path[:-1], one.quantity, one.triad
            axes.setdefault(key, {}).setdefault(one.axis, k)
        elif field.width == (3 if one.is_vector else {"temperature": 1}.get(one.quantity, -1)):
            number = f"imu{field.number}"
            lone = one.triad in ("", "imu0")
            several = number if lone else f"{one.triad}_{number}"
            triad = several if field.number >= 0 else one.triad or "imu0"
            whole = vector_of(one.quantity, triad, (k,), told)
            found.append((linear, depth, replace(whole, numbered=triad == number)))
    for (linear, depth, _, quantity, triad), three in axes.items():
        if len(three) == 3 and len({fields[k].rows for k in three.values()}) == 1:
            parts = [three[axis] for axis in range(3)]
            found.append((linear, depth, vector_of(quantity, triad, parts, told)))
    return _pair(_firsts([one for *_, one in sorted(found, key=lambda each: each[:2])]))


def choose(
    fields: Sequence[Field],
    told: Sequence[Meaning],
    mapping: FieldMapping,
    stated: Mapping[str, Sequence[tuple[int, ...]]],
) -> list[Vector]:
    """The vectors to read.

    stated : of a quantity the fields of each sensor, as the user names them. Of the others those of
        the same sensors are read, by their names, or that of a file in which one sensor is named
    """
    own, names = list[Vector](), mapping.triads
    for quantity, every in stated.items():
        # Those of gyroscopes may be named behind those of accelerometers.
        forces = len(stated.get("acceleration", ())) if quantity == "angular_rate" else 0
        before = forces if len(names) >= forces + len(every) else 0
        for k, parts in enumerate(every):
            numbered = before + k >= len(names)
            triad = f"imu{k}" if numbered else names[before + k]
            own.append(replace(vector_of(quantity, triad, parts, told), numbered=numbered))
    triads = dict.fromkeys(v.triad for v in own if v.quantity in INERTIAL)
    sensors = [(told[v.parts[0]].triad or "imu0", v.triad) for v in own] if told else []
    for one in find_vectors(fields, told):
        same = [triad for sensor, triad in sensors if sensor == one.triad and triad in triads]
        if one.quantity not in stated:
            others = tuple(triads)[: len(triads) == 1] if triads else (one.triad,)
            own += [replace(one, triad=triad) for triad in dict.fromkeys(same) or others]
    return _firsts(own)


def resolve_mapping(
    mapping: FieldMapping, read: Sequence[tuple[Any, Sequence[str], str]], **more: Any
) -> FieldMapping:
    """The mapping that reads a file, and others like it, the same way.

    read : of each vector (what has its quantity and triad) the addresses of its fields and the unit
        that they have; more : other fields of the mapping
    """
    fields: dict[str, Any] = {}
    triads = dict[str, tuple[str, ...]]()
    for quantity, option in OPTIONS.items():
        own = [one for one in read if one[0].quantity == quantity]
        units = {unit for *_, unit in own}
        fields[f"{option}_unit"] = units.pop() if len(units) == 1 else ""
        fields[option] = tuple(dict.fromkeys(a for _, addresses, _ in own for a in addresses))
        triads[quantity] = tuple(v.triad for v, *_ in own)
    acc, gyro = triads["acceleration"], triads["angular_rate"]
    fields["triads"] = acc if gyro == acc[: len(gyro)] else acc + gyro
    return replace(mapping, **fields, **more)


def _firsts(vectors: Sequence[Vector]) -> list[Vector]:
    first = {v.name: v for v in reversed(vectors)}
    return [v for v in vectors if first[v.name] is v]


def _pair(vectors: list[Vector]) -> list[Vector]:
    """A gyroscope whose name begins that of one accelerometer only ("s1", "s1_ln") is with it."""
    acc = [v.triad for v in vectors if v.quantity == "acceleration"]
    out = []
    for v in vectors:
        fitting = [a for a in acc if a.startswith(f"{v.triad}_")]
        lonely = v.quantity == "angular_rate" and v.triad not in acc and len(fitting) == 1
        out.append(replace(v, triad=fitting[0]) if lonely else v)
    return out
