"""Which fields of a message are acceleration, angular rate and time, by the names in use.

There is no common IMU schema outside ROS, so the names decide; a `FieldMapping` overrides them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from imucalib.readers.messages.layout import Groups
from imucalib.readers.messages.records import Topic

Leaves = dict[str, int]

_ACC = (
    "linearacceleration", "acceleration", "accelerometerms2", "accelerometer", "specificforce",
    "linearacc", "accel", "acc", "a",
)  # fmt: skip
_GYRO = (
    "angularvelocity", "angularrate", "gyrorad", "gyroscope", "gyro", "gyr", "rotationrate", "w",
    "g",
)  # fmt: skip
_STAMPS = ("stamp", "timestamp", "timestampns", "timestampus", "timestampms", "timens", "timeus",
           "time", "t")  # fmt: skip
_SECONDS = (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"), ("seconds", "nanos"))
#: Channel metadata of the files that this package writes: what a ROS message cannot say.
META_TRIAD, META_QUANTITIES = "imucal.triad", "imucal.quantities"
META_ACC_UNIT, META_GYRO_UNIT = "imucal.acc_unit", "imucal.gyro_unit"
META_ORIGIN, META_DATED = "imucal.origin_ns", "imucal.dated"

_AXES = (("x", "y", "z"), ("0", "1", "2"))
#: Names that state their unit themselves (PX4's SensorCombined).
_UNITS = {"accelerometerms2": "m/s2", "gyrorad": "rad/s"}


@dataclass(frozen=True)
class Field:
    """A quantity in a topic's messages.

    quantity : "acc", "gyro" or "temperature", as in FieldMapping
    address : its place as the mapping writes it; leaves : the numbers that make it
    unit : what the message type states, "" when it does not
    found : whether the names decided, rather than the user
    """

    quantity: str
    address: str
    leaves: tuple[str, ...]
    unit: str = ""
    found: bool = True


@dataclass(frozen=True)
class TopicFields:
    """What is read from one topic.

    time : address of its stamp, "" for none
    frame : the frame_id of its first message, "" for none
    triad, origin_ns, dated : as this package's own files state them, else "" and None
    """

    fields: tuple[Field, ...]
    time: str = ""
    time_leaves: tuple[str, ...] = ()
    frame: str = ""
    triad: str = ""
    origin_ns: int | None = None
    dated: bool = True

    @property
    def groups(self) -> Groups:
        """The leaves of every field, and of the stamp as the last group when there is one."""
        last = (self.time_leaves,) if self.time_leaves else ()
        return tuple(f.leaves for f in self.fields) + last

    @property
    def widths(self) -> tuple[int, ...]:
        """How many numbers each group has."""
        last = (len(self.time_leaves),) if self.time_leaves else ()
        return tuple(1 if f.quantity == "temperature" else 3 for f in self.fields) + last


def is_imu(topic: Topic) -> bool:
    """Whether the topic's type is sensor_msgs/Imu, in any of its spellings, or this package's."""
    own = META_TRIAD in dict(topic.metadata)
    return own or bool(re.fullmatch(r"sensor_msgs[/.](msg[/.])?Imu", topic.type_name))


def vector(leaves: Leaves, address: str) -> tuple[str, ...]:
    """Leaves of the 3-vector at an address; "acc_*" stands for acc_x, acc_y, acc_z."""
    if "*" in address:
        paths = tuple(address.replace("*", axis) for axis in "xyz")
        return paths if all(leaves.get(p) == 1 for p in paths) else ()
    if leaves.get(address) == 3:
        return (address,)
    for axes in _AXES:
        paths = tuple(f"{address}.{axis}" for axis in axes)
        more = f"{address}.w", f"{address}.3"  # a quaternion, or a longer list
        if all(leaves.get(p) == 1 for p in paths) and not any(p in leaves for p in more):
            return paths
    return ()


def vectors_of(leaves: Leaves) -> dict[str, tuple[str, ...]]:
    """Address of every 3-vector, with its leaves."""
    stars = [a for a in _stars(leaves) if a.replace("*", "w") not in leaves]  # no quaternion
    addresses = (*_nodes(leaves), *stars)
    named = {found: a for a in reversed(addresses) if (found := vector(leaves, a))}
    return {a: found for found, a in reversed(named.items())}


def instant(leaves: Leaves, address: str) -> tuple[str, ...]:
    """Leaves of the time at an address: one number, or seconds and nanoseconds."""
    if leaves.get(address) == 1:
        return (address,)
    for names in _SECONDS:
        paths = tuple(f"{address}.{name}" for name in names)
        if all(leaves.get(p) == 1 for p in paths):
            return paths
    return ()


def scalar(leaves: Leaves, address: str) -> tuple[str, ...]:
    """The leaf of a single number."""
    return (address,) if leaves.get(address) == 1 else ()


def find_acc(leaves: Leaves) -> str:
    """Address of the acceleration, or ""."""
    return _find(leaves, _ACC)


def find_gyro(leaves: Leaves) -> str:
    """Address of the angular rate, or ""."""
    return _find(leaves, _GYRO)


def find_time(leaves: Leaves) -> str:
    """Address of the sensor's own time stamp, or ""."""
    best: list[tuple[int, int, str]] = []
    for path in _nodes(leaves):
        name = _plain(path.rpartition(".")[2])
        if name in _STAMPS and instant(leaves, path):
            best.append((path.count(".") if name != "stamp" else -1, _STAMPS.index(name), path))
    return min(best)[2] if best else ""


def stated_unit(topic: Topic, address: str, imu_unit: str) -> str:
    """The unit that the message type or the field's own name states, or ""."""
    own = {"m/s2": META_ACC_UNIT, "rad/s": META_GYRO_UNIT}.get(imu_unit, "")
    if own in dict(topic.metadata):
        return dict(topic.metadata)[own]
    if is_imu(topic):
        return imu_unit
    return _UNITS.get(_plain(address.rpartition(".")[2]), "")


def _find(leaves: Leaves, names: tuple[str, ...]) -> str:
    best: list[tuple[int, int, str]] = []
    for path in (*_nodes(leaves), *_stars(leaves)):
        name = _plain(path.rpartition(".")[2].replace("*", ""))
        # One letter means something only beside an axis letter ("ax", "g_x").
        usable = name in names and (len(name) > 1 or "*" in path)
        if usable and vector(leaves, path):
            best.append((names.index(name), path.count("."), path))
    return min(best)[2] if best else ""


def _nodes(leaves: Leaves) -> list[str]:
    nodes: dict[str, None] = {}
    for path in leaves:
        parts = path.split(".")
        nodes.update(dict.fromkeys(".".join(parts[: i + 1]) for i in range(len(parts))))
    return list(nodes)


def _stars(leaves: Leaves) -> list[str]:
    return [f"{path[:-1]}*" for path in leaves if len(path) > 1 and path[-1] in "x"]


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())
