"""ROS message definitions: the text of a schema record to types and their fields.

Sources: the ROS 1 wiki page "msg" and the ROS 2 interface definition."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache

PRIMITIVES = {
    "bool": "u1", "byte": "u1", "char": "u1", "octet": "u1", "boolean": "u1", "int8": "i1",
    "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8",
    "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_FIELD = re.compile(r"^(\S+)\s+(\w+)\s*(=?)")
_TYPE = re.compile(r"^([\w/]+)(?:<=\d+)?(\[(?:<=)?\d*\])?$")
_VECTOR = "float64 x\nfloat64 y\nfloat64 z"
#: sensor_msgs/Imu, for a file that names the type without defining it in ROS's own syntax.
_NEXT = "=" * 80  # between types; readers of others look for exactly this
_IMU = f"""std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
{_NEXT}
MSG: geometry_msgs/Quaternion
{_VECTOR}
float64 w
{_NEXT}
MSG: geometry_msgs/Vector3
{_VECTOR}
{_NEXT}
MSG: std_msgs/Header
"""
IMU_ROS2 = _IMU + "builtin_interfaces/Time stamp\nstring frame_id\n"
TEMPERATURE_ROS2 = (
    "std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n"
    + IMU_ROS2[IMU_ROS2.rindex(_NEXT) :]
)
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
{_NEXT}
MSG: geometry_msgs/Vector3
{_VECTOR}
""" + IMU_ROS2[IMU_ROS2.rindex(_NEXT) :]
IMU_ROS1 = _IMU + "uint32 seq\ntime stamp\nstring frame_id\n"


class LayoutError(ValueError):
    """The message does not match its definition, or uses a part of it that is not supported."""


@dataclass(frozen=True)
class Member:
    """One field of a definition; `count` is -1 for a scalar, 0 for a sequence, N for N[...]."""

    name: str
    type: str
    count: int = -1


@dataclass(frozen=True)
class Definition:
    """A message type with every type that it uses, by full name ("pkg/Type")."""

    root: str
    types: dict[str, tuple[Member, ...]]
    ros1: bool


def parse_definition(name: str, text: str, ros1: bool) -> Definition:
    """Parse a concatenated ROS definition; raises LayoutError for a syntax that it is not."""
    root = _full(name, "")
    types: dict[str, tuple[Member, ...]] = {}
    stamp = (Member("sec", "int32"), Member("nanosec", "uint32"))
    if not ros1:
        types["builtin_interfaces/Time"] = types["builtin_interfaces/Duration"] = stamp
    current = root
    members: list[Member] = []
    for raw in text.splitlines():
        line = raw.split("#", 1)[0].strip()
        if line.startswith("==="):
            types.setdefault(current, tuple(members))
            current, members = "", []
        elif line.startswith("MSG:"):
            current, members = _full(line[4:].strip(), ""), []
        elif line:
            members += _member(line, current)
    types.setdefault(current, tuple(members))
    return Definition(root, types, ros1)


def _member(line: str, owner: str) -> list[Member]:
    match = _FIELD.match(line)
    if not match:
        raise LayoutError(f"the definition line '{line[:60]}' is not understood")
    spelled, name, constant = match.groups()
    kind = _TYPE.match(spelled)
    if constant or kind is None:
        if constant:
            return []
        raise LayoutError(f"the type '{spelled[:60]}' is not understood")
    base, array = kind.groups()
    count = -1 if array is None else int(array[1:-1]) if array[1:-1].isdigit() else 0
    known = base in PRIMITIVES or base in ("string", "wstring", "time", "duration")
    return [Member(name, base if known else _full(base, owner), count)]


def _full(name: str, owner: str) -> str:
    parts = [p for p in name.split("/") if p != "msg"]
    if len(parts) == 1:
        package = "std_msgs" if parts[0] == "Header" else owner.rpartition("/")[0]
        parts = [package, parts[0]] if package else parts
    return "/".join(parts)


@cache
def definition_of(name: str, encoding: str, text: str) -> Definition:
    """The definition in a schema record; sensor_msgs/Imu is also known without one."""
    ros1 = encoding == "ros1msg"
    if encoding in ("ros1msg", "ros2msg") and text.strip():
        return parse_definition(name, text, ros1)
    if _full(name, "") == "sensor_msgs/Imu":
        return parse_definition(name, IMU_ROS1 if ros1 else IMU_ROS2, ros1)
    raise LayoutError(f"its schema is '{encoding}', and {name} is not known without ros2msg text")
