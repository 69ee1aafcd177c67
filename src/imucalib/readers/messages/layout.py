"""ROS message definitions, and their layouts: byte offsets at which whole blocks decode as arrays.

The offsets of a message depend on its contents only through the lengths of its strings and
sequences. A `MessageLayout` walks one message, notes those lengths as guards, and then holds for
every message with the same length fields and size.

Sources: the ROS 1 wiki page "msg"; the ROS 2 interface definition; OMG DDS-XTypes 1.3, section 7.4
(CDR versions 1 and 2); DDSI-RTPS 2.5, table 10.3 (encapsulation identifiers).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imucalib.readers.messages.records import record_type

_PRIMITIVES = {
    word: value
    for value, words in {
        "u1": "bool byte char octet boolean uint8",
        "i1": "int8",
        "i2": "int16",
        "u2": "uint16",
        "i4": "int32",
        "u4": "uint32",
        "i8": "int64",
        "u8": "uint64",
        "f4": "float32",
        "f8": "float64",
    }.items()
    for word in words.split()
}
_NEXT = "=" * 80  # between types; other readers look for exactly this
_VECTOR = f"{_NEXT}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
_HEADER = f"{_NEXT}\nMSG: std_msgs/Header\n"
#: With the type of the stamp, as rosbag2 writes it: Rerun reads no definition without.
_HEADER_ROS2 = f"""{_HEADER}builtin_interfaces/Time stamp
string frame_id
{_NEXT}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_IMU = f"""std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
{_NEXT}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
{_VECTOR}"""
#: sensor_msgs/Imu, also for a file that names the type without defining it in ROS's own syntax.
IMU_ROS2 = _IMU + _HEADER_ROS2
_IMU_ROS1 = _IMU + _HEADER + "uint32 seq\ntime stamp\nstring frame_id\n"
TEMPERATURE_ROS2 = "std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n" + _HEADER_ROS2
#: geometry_msgs/AccelWithCovarianceStamped, the covariance 6 x 6 in rows, linear before angular.
ACCEL_ROS2 = f"""std_msgs/Header header
geometry_msgs/AccelWithCovariance accel
{_NEXT}
MSG: geometry_msgs/AccelWithCovariance
geometry_msgs/Accel accel
float64[36] covariance
{_NEXT}
MSG: geometry_msgs/Accel
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
{_VECTOR}{_HEADER_ROS2}"""
#: A rest of one accelerometer: s; m/s²; mg beyond gravity.
REST_ROS2 = f"""std_msgs/Header header
float64 duration
geometry_msgs/Vector3 before
geometry_msgs/Vector3 after
float64 residual_before
float64 residual_after
{_VECTOR}{_HEADER_ROS2}"""
_FIELD = re.compile(r"([\w/]+)(?:<=\d+)?(\[(?:<=)?(\d*)\])?\s+(\w+)\s*(=?)")
_BOUND = "[<="  # begins a sequence of at most so many
#: Structures in a message, and how deep: beyond it a message is no sensor reading. Also what ends
#: a type that contains itself.
_MAX_ELEMENTS, _DEEPEST = 4096, 32
#: encapsulation identifier -> (byte order, largest alignment)
_ENCAPSULATIONS = {
    0x00: (">", 8),
    0x01: ("<", 8),
    0x06: (">", 4),
    0x07: ("<", 4),
    0x10: (">", 4),
    0x11: ("<", 4),
}


class LayoutError(ValueError):
    """The message does not match its definition, or uses a part of it that is not supported."""


@dataclass(frozen=True)
class DefinedField:
    """One field of a definition; `count` is -1 for a scalar, 0 for a sequence, N for N[...]."""

    name: str
    type: str
    count: int = -1


@dataclass(frozen=True)
class Definition:
    """A message type with every type that it uses, by full name ("pkg/Type")."""

    root: str
    types: dict[str, list[DefinedField]]
    ros1: bool


def parse_definition(name: str, text: str, ros1: bool) -> Definition:
    """Parse a concatenated ROS definition; raises LayoutError for a syntax that it is not."""
    root = _full(name, "")
    types: dict[str, list[DefinedField]] = {}
    for kind, word in (("time", "uint32"), ("duration", "int32")) if ros1 else ():
        types[kind] = [DefinedField("sec", word), DefinedField("nanosec", word)]
    for kind in () if ros1 else ("builtin_interfaces/Time", "builtin_interfaces/Duration"):
        types[kind] = [DefinedField("sec", "int32"), DefinedField("nanosec", "uint32")]
    current, members = root, types.setdefault(root, [])
    for raw in text.splitlines():
        line = raw.partition("#")[0].strip()
        if line.startswith("MSG:"):
            current = _full(line[4:].strip(), "")
            members = [] if current in types else types.setdefault(current, [])
        elif line and not line.startswith("==="):
            found = _FIELD.match(line)
            if found is None:
                raise LayoutError(f"the definition line '{line[:60]}' is not understood")
            base, array, size, field_name, constant = found.groups()
            if constant:
                continue
            count = -1 if array is None else 0 if array.startswith(_BOUND) else int(size or 0)
            known = base in _PRIMITIVES or base in ("string", "wstring", "time", "duration")
            members.append(DefinedField(field_name, base if known else _full(base, current), count))
    return Definition(root, types, ros1)


def _full(name: str, owner: str) -> str:
    parts = [p for p in name.split("/") if p != "msg"]
    if len(parts) == 1:
        package = "std_msgs" if parts[0] == "Header" else owner.rpartition("/")[0]
        parts = [package, parts[0]] if package else parts
    return "/".join(parts)


def definition_of(name: str, encoding: str, text: str) -> Definition:
    """The definition in a schema record; sensor_msgs/Imu is also known without one."""
    ros1 = encoding == "ros1msg"
    if encoding in ("ros1msg", "ros2msg") and text.strip():
        return parse_definition(name, text, ros1)
    if _full(name, "") == "sensor_msgs/Imu":
        return parse_definition(name, _IMU_ROS1 if ros1 else IMU_ROS2, ros1)
    raise LayoutError(f"its schema is '{encoding}', and {name} is not known without ros2msg text")


class FieldGroup(NamedTuple):
    """Field paths that are read together (the axes of a vector), and their numbers in all."""

    paths: tuple[str, ...]
    width: int


Groups = tuple[FieldGroup, ...]


class MessageLayout:
    """Where the numbers of a message are, and of all that share its lengths.

    fields : path ("linear_acceleration.x") -> (byte offset, numpy type, element count)
    texts : path -> string, of the one message that was walked
    guards : (offset, value) of every 4-byte length that the offsets depend on
    head : the encapsulation bytes that the message must begin with
    end : size of the message; up to `slack` bytes of padding may follow; order : of its bytes
    Raises LayoutError for a message that its definition does not fit.
    """

    def __init__(self, definition: Definition, data: bytes) -> None:
        self.fields: dict[str, tuple[int, str, int]] = {}
        self.texts: dict[str, str] = {}
        self.guards: list[tuple[int, int]] = []
        self.order, self.head, self.slack = "<", b"", 0
        self._definition, self._data = definition, data
        self._widest = 1  # largest alignment; 1 for none
        self._origin = self.end = 0 if definition.ros1 else 4
        self._visited = self._depth = 0
        if not definition.ros1:
            if len(data) < 4:
                raise LayoutError("the message is shorter than its CDR header")
            if data[0] != 0 or data[1] not in _ENCAPSULATIONS:
                raise LayoutError(f"the CDR encapsulation {data[:2].hex()} is not a plain one")
            self.order, self._widest = _ENCAPSULATIONS[data[1]]
            self.head, self.slack = data[:2], 3
        self._structure(definition.root, "")
        if not self.end <= len(data) <= self.end + self.slack:
            raise LayoutError(f"the message has {len(data)} bytes, its definition {self.end}")
        del self._data

    def _structure(self, name: str, prefix: str) -> None:
        """Pass over a type's members."""
        if name not in self._definition.types:
            raise LayoutError(f"the type {name} is not defined in the file")
        members = self._definition.types[name]
        if self._depth >= _DEEPEST:
            raise LayoutError(f"its types are nested deeper than {_DEEPEST}, or in a circle")
        if not members and not self._definition.ros1:
            self.end += 1  # IDL forbids empty structures, so ROS 2 stores one byte
        self._depth += 1
        for member in members:
            path = prefix + member.name
            count = self._length() if member.count == 0 else member.count
            if member.type in _PRIMITIVES:
                self._numbers(_PRIMITIVES[member.type], abs(count), path)
                continue
            if count > _MAX_ELEMENTS:
                raise LayoutError(f"'{path}' has {count} elements")
            for i in range(abs(count)):
                self._element(member.type, path if member.count < 0 else f"{path}.{i}")
        self._depth -= 1

    def _element(self, kind: str, path: str) -> None:
        self._visited += 1
        if self._visited > _MAX_ELEMENTS:
            raise LayoutError(f"it has more than {_MAX_ELEMENTS} elements")
        if kind == "string":
            size = self._length()
            raw = self._data[self.end : self.end + size]
            self.texts[path] = raw.rstrip(b"\0").decode("utf-8", "replace")
            self.end += size
        elif kind == "wstring":
            raise LayoutError(f"'{path}' is a wide string, which is not supported")
        else:
            self._structure(kind, f"{path}.")

    def _numbers(self, kind: str, count: int, path: str) -> None:
        if count:
            self._align(int(kind[1]))
            self.fields[path] = (self.end, kind, count)
            self.end += int(kind[1]) * count
        if self.end > len(self._data):
            raise LayoutError("the message is shorter than its definition")

    def _length(self) -> int:
        self._align(4)
        raw = self._data[self.end : self.end + 4]
        if len(raw) < 4:
            raise LayoutError("the message is shorter than its definition")
        value = int.from_bytes(raw, "little" if self.order == "<" else "big")
        if value > len(self._data):
            raise LayoutError("a length inside the message exceeds the message")
        self.guards.append((self.end, value))
        self.end += 4
        return value

    def _align(self, size: int) -> None:
        self.end += -(self.end - self._origin) % min(size, self._widest)

    def pick(self, groups: Groups) -> tuple[np.dtype[np.void], list[list[str]]]:
        """A record type holding the paths of every group, and the field names of each group.

        Neighbours of one type become one field, so that a vector is read at once. Fields "head"
        and "guard<offset>" are there too. Raises LayoutError for a group that the message lacks.
        """
        spec: list[tuple[str, object, int]] = []
        names: list[list[str]] = []
        for group in groups:
            names.append([])
            for offset, kind, count in self._merge(group):
                names[-1].append(f"f{len(spec)}")
                spec.append((names[-1][-1], (self.order + kind, (count,)), offset))
        spec += [(f"guard{at}", self.order + "u4", at) for at, _ in self.guards]
        if self.head:
            spec.append(("head", f"V{len(self.head)}", 0))
        return record_type(spec, self.end), names

    def _merge(self, group: FieldGroup) -> list[tuple[int, str, int]]:
        merged: list[tuple[int, str, int]] = []
        for path in group.paths:
            if path not in self.fields:
                raise LayoutError(f"the message has no field '{path}'")
            offset, kind, count = self.fields[path]
            if merged:
                last, same, before = merged[-1]
                if same == kind and last + before * int(kind[1]) == offset:
                    merged[-1] = (last, kind, before + count)
                    continue
            merged.append((offset, kind, count))
        found = sum(count for *_, count in merged)
        if found != group.width:
            raise LayoutError(f"'{group.paths[0]}' has {found} numbers instead of {group.width}")
        return merged
