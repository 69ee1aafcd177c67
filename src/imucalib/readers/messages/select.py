"""Which topics and fields are read, and which triad each of them belongs to.

There is no common IMU schema outside ROS, so the names decide which fields are acceleration,
angular rate and time; a `FieldMapping` overrides them. Where nothing is found, `contents_of` lists
the log.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UsageError
from imucalib.readers.columns import Content, norm_of
from imucalib.readers.messages.decode import Decoder, decoder_for
from imucalib.readers.messages.layout import Groups, LayoutError
from imucalib.readers.messages.records import MessageBlock, MessageLog, Topic
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.pairing import distinct_names

Leaves = dict[str, int]

_ACC = tuple(
    str.split(
        """
        linearacceleration acceleration accelerometerms2 accelerometer specificforce linearacc
        accel acc a
        """
    )
)
_GYRO = tuple(str.split("angularvelocity angularrate gyrorad gyroscope gyro gyr rotationrate w g"))
_STAMPS = tuple(
    str.split("stamp timestamp timestampns timestampus timestampms timens timeus time t")
)
_SECONDS = (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"), ("seconds", "nanos"))
#: Channel metadata of the files that this package writes: what a ROS message cannot say.
META_TRIAD, META_QUANTITIES = "imucal.triad", "imucal.quantities"
META_ACC_UNIT, META_GYRO_UNIT = "imucal.acc_unit", "imucal.gyro_unit"
META_ORIGIN, META_DATED = "imucal.origin_ns", "imucal.dated"

_AXES = (("x", "y", "z"), ("0", "1", "2"))
#: Names that state their unit themselves (PX4's SensorCombined).
_UNITS_OF_NAMES = {"accelerometerms2": "m/s2", "gyrorad": "rad/s"}


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
    return _UNITS_OF_NAMES.get(_plain(address.rpartition(".")[2]), "")


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


QUANTITIES = ("acc", "gyro", "temperature")
_UNITS = {"acc": "m/s2", "gyro": "rad/s", "temperature": ""}
_FINDERS = {"acc": find_acc, "gyro": find_gyro}
_CLOCKS = ("log_time", "publish_time")
_SENSOR_WORDS = re.compile(r"accelerometer|accel|acc|gyroscope|gyro|gyr", re.IGNORECASE)


@dataclass(frozen=True)
class Triad:
    """One sensor: its name and, by quantity, the topic and the place in that topic's fields.

    numbered : whether the name is only a number, since topics do not tell the sensors apart
    """

    name: str
    parts: Mapping[str, tuple[str, int]]
    numbered: bool = False


def fields_of(topic: Topic, leaves: Leaves, mapping: FieldMapping) -> TopicFields | None:
    """What to read from a topic, or None when it holds nothing that is wanted.

    Raises UsageError when the mapping names a field that the messages do not have.
    """
    stated = [f for q in QUANTITIES for f in _stated(topic, leaves, mapping, q)]
    if not stated and _any_stated(mapping):
        return None
    own = dict(topic.metadata).get(META_QUANTITIES, "").split()
    if own and not stated:
        mine = [replace(f, found=False) for q in own for f in _found(topic, leaves, q)]
        return _timed(topic, leaves, mapping, tuple(mine)) if mine else None
    fields = stated
    for quantity in ("acc", "gyro"):
        alone = sum(f.quantity != quantity for f in stated) == len(stated) <= 1
        if alone and not getattr(mapping, quantity):
            fields = [*fields, *_found(topic, leaves, quantity)]
    if not stated and not any(f.quantity == "acc" for f in fields):
        return None  # a rate alone is also in odometry and in many a controller's messages
    fields.sort(key=lambda f: QUANTITIES.index(f.quantity))
    return _timed(topic, leaves, mapping, tuple(fields))


def _any_stated(mapping: FieldMapping) -> bool:
    return any(any(getattr(mapping, quantity)) for quantity in QUANTITIES)


def split_address(text: str, topic: Topic) -> str | None:
    """The field path of "topic:path" when it is of this topic ("" for none), else None."""
    if text == topic.name:
        return ""
    name, colon, path = text.rpartition(":")
    return path if colon and name == topic.name else None


def _stated(topic: Topic, leaves: Leaves, mapping: FieldMapping, quantity: str) -> list[Field]:
    fields = []
    for text in getattr(mapping, quantity):
        path = split_address(text, topic) if text else None
        if path is None:
            continue
        address = path or (_FINDERS[quantity](leaves) if quantity in _FINDERS else "")
        resolve = scalar if quantity == "temperature" else vector
        found = resolve(leaves, address) if address else ()
        if not found:
            raise UsageError(
                f"topic {topic.name} has no {'number' if quantity == 'temperature' else '3-vector'}"
                f" '{path}'",
                where=f"mapping: {quantity}",
                remedy=f"its fields: {', '.join(list(leaves)[:40])}",
            )
        unit = stated_unit(topic, address, _UNITS[quantity])
        fields.append(Field(quantity, address, found, unit, found=False))
    return fields


def _found(topic: Topic, leaves: Leaves, quantity: str) -> list[Field]:
    if quantity == "temperature":  # asked for only where a file of this package has it
        found = scalar(leaves, quantity)
        return [Field(quantity, quantity, found, "degC")] if found else []
    address = _FINDERS[quantity](leaves) if quantity in _FINDERS else ""
    if not address:
        return []
    unit = stated_unit(topic, address, _UNITS[quantity])
    return [Field(quantity, address, vector(leaves, address), unit)]


def _timed(
    topic: Topic, leaves: Leaves, mapping: FieldMapping, fields: tuple[Field, ...]
) -> TopicFields:
    own = dict(topic.metadata)
    origin = own.get(META_ORIGIN, "")
    whole = TopicFields(
        fields,
        triad=own.get(META_TRIAD, ""),
        origin_ns=int(origin) if re.fullmatch(r"-?\d{1,19}", origin) else None,
        dated=own.get(META_DATED) != "no",
    )
    if mapping.time in _CLOCKS:
        return replace(whole, time=mapping.time)
    if not mapping.time:
        address = find_time(leaves)
        stamps = instant(leaves, address) if address else ()
        return replace(whole, time=address, time_leaves=stamps)
    path = split_address(mapping.time, topic) or mapping.time
    stamps = instant(leaves, path)
    if not stamps:
        known = ", ".join(list(leaves)[:40])
        raise UsageError(
            f"topic {topic.name} has no time '{path}'",
            where="mapping: time",
            remedy=f"use log_time, publish_time or one of its fields: {known}",
        )
    return replace(whole, time=path, time_leaves=stamps)


def natural(text: str) -> tuple[tuple[bool, int, str], ...]:
    """Sort key under which imu2 comes before imu10."""
    parts = re.split(r"(\d+)", text)
    return tuple((p.isdigit(), int(p) if p.isdigit() else 0, p) for p in parts)


def triads_of(
    mapping: FieldMapping, topics: Mapping[str, TopicFields], alive: Mapping[str, list[bool]]
) -> list[Triad]:
    """The triads, in the natural order of topics, named as the mapping does, as the file does, or
    by the part of the topic that is theirs alone; a single one, or where topics do not tell, imu0,
    imu1, ...

    alive : per topic and field, whether any value differs from zero. A vector that is always zero
    is a part of a split topic, or was never filled: it is left out unless the user named it.
    """
    if _any_stated(mapping):
        parts = _stated_parts(mapping, topics, alive)
    else:
        parts = _found_parts(topics, alive)
    owns = [{topics[topic].triad for topic, _ in part.values()} for part in parts]
    own = tuple(name for names in owns if len(names) == 1 for name in names if name)
    numbered = False
    if len(set(own)) != len(parts):
        topics_of = [list(dict.fromkeys(topic for topic, _ in p.values())) for p in parts]
        own = distinct_names(topics_of) if len(parts) > 1 else ()
        numbered = not own and not mapping.triads
        own = own or tuple(f"imu{i}" for i in range(len(parts)))
    names = mapping.triads or own
    if len(names) != len(parts) or len(set(names)) != len(names):
        raise UsageError(
            f"{len(names)} triad names for {len(parts)} triads, or names that repeat",
            where="mapping: triads",
            remedy="give one name for each triad, or none",
        )
    return [Triad(name, part, numbered) for name, part in zip(names, parts, strict=True)]


def _stated_parts(
    mapping: FieldMapping, topics: Mapping[str, TopicFields], alive: Mapping[str, list[bool]]
) -> list[dict[str, tuple[str, int]]]:
    count = max(len(getattr(mapping, q)) for q in QUANTITIES)
    parts: list[dict[str, tuple[str, int]]] = [{} for _ in range(count)]
    taken: set[tuple[str, int]] = set()
    for quantity in QUANTITIES:
        for part, text in zip(parts, getattr(mapping, quantity), strict=False):
            places = _places(text, quantity, topics)
            place = next((p for p in places if p not in taken), None)
            if text and place is None:
                names = ", ".join(sorted(topics, key=natural)) or "none"
                raise UsageError(
                    f"'{text}' is not a topic of this file, or has no readable messages",
                    where=f"mapping: {quantity}",
                    remedy=f"topics found: {names}",
                )
            if place is not None:
                taken.add(place)
                part[quantity] = place
    for part in parts:
        _complete(part, topics, alive)
    return parts


def _places(
    text: str, quantity: str, topics: Mapping[str, TopicFields]
) -> Iterable[tuple[str, int]]:
    for name, fields in topics.items():
        for i, f in enumerate(fields.fields):
            if f.quantity == quantity and not f.found and text in (name, f"{name}:{f.address}"):
                yield name, i


def _complete(
    part: dict[str, tuple[str, int]],
    topics: Mapping[str, TopicFields],
    alive: Mapping[str, list[bool]],
) -> None:
    for name, _ in tuple(part.values()):
        for i, f in enumerate(topics[name].fields):
            if f.found and f.quantity not in part and alive[name][i]:
                part[f.quantity] = (name, i)


def _found_parts(
    topics: Mapping[str, TopicFields], alive: Mapping[str, list[bool]]
) -> list[dict[str, tuple[str, int]]]:
    parts: list[dict[str, tuple[str, int]]] = []
    halves: dict[str, list[dict[str, tuple[str, int]]]] = {}
    for name in sorted(topics, key=natural):
        fields = topics[name].fields
        usable = [alive[name][i] or not f.found for i, f in enumerate(fields)]
        part = {f.quantity: (name, i) for i, f in enumerate(fields) if usable[i]}
        if not part:
            continue
        stem = topics[name].triad or _SENSOR_WORDS.sub("*", name)
        for other in halves.get(stem, []):
            if not set(other) & set(part):
                other.update(part)
                break
        else:
            parts.append(part)
            if len(part) == 1 or topics[name].triad:
                halves.setdefault(stem, []).append(part)
    return parts


def resolved(
    mapping: FieldMapping, triads: list[Triad], topics: Mapping[str, TopicFields], units: list[str]
) -> FieldMapping:
    """The mapping that reads the same channels again; units : of acc and gyro, as found."""
    addresses: dict[str, tuple[str, ...]] = {}
    for quantity in QUANTITIES:
        texts = []
        for triad in triads:
            name, i = triad.parts.get(quantity, ("", 0))
            texts.append(f"{name}:{topics[name].fields[i].address}" if name else "")
        addresses[quantity] = tuple(texts) if any(texts) else ()
    return replace(
        mapping,
        acc=addresses["acc"],
        gyro=addresses["gyro"],
        temperature=addresses["temperature"],
        triads=tuple(triad.name for triad in triads),
        acc_unit=mapping.acc_unit or units[0],
        gyro_unit=mapping.gyro_unit or units[1],
    )


_SAMPLED = 2000  # messages of a topic that its norms are taken from, a stretch of each block
_STRETCH = 50


@dataclass
class _Seen:
    topic: Topic
    count: int = 0
    first: int = 0
    last: int = 0
    sampled: int = 0
    why: str = ""
    vectors: dict[str, tuple[str, ...]] | None = None
    values: dict[str, list[Array]] = field(default_factory=dict)
    decoder: Decoder | None = None

    def add(self, block: MessageBlock) -> None:
        """Consecutive messages of this topic."""
        times = block.header("log_time").astype(np.int64)
        self.first = min(self.first, int(times.min())) if self.count else int(times.min())
        self.last = max(self.last, int(times.max()))
        self.count += times.size
        if self.sampled >= _SAMPLED or self.why:
            return
        part = block.take(np.arange(min(_STRETCH, times.size)))
        try:
            self._sample(part)
        except (LayoutError, UsageError) as error:  # the latter: a package is missing
            self.why = str(error)
        self.sampled += part.starts.size

    def _sample(self, part: MessageBlock) -> None:
        if self.decoder is None or self.vectors is None:
            self.decoder = decoder_for(self.topic)
            self.vectors = vectors_of(self.decoder.leaves(part.payloads()[0]))
        if not self.vectors:
            return
        groups = tuple(self.vectors.values())
        decoded = self.decoder.decode(part, groups, (3,) * len(groups))
        for address, column in zip(self.vectors, decoded.columns, strict=True):
            values = column[decoded.good].astype(np.float64)
            self.values.setdefault(address, []).append(values)

    def contents(self) -> list[Content]:
        """The topic, and below it its vectors."""
        name, span = self.topic.name, (self.last - self.first) * 1e-9
        rate = (self.count - 1) / span if self.count > 1 and span > 0 else math.nan
        kind = f"{self.topic.type_name} ({self.topic.encoding or 'no encoding'})"
        own = [Content(name, kind, self.count, rate, why=self.why)]
        for address, pieces in self.values.items():
            norm = norm_of(np.concatenate(pieces))
            own.append(Content(f"{name}:{address}", "3 numbers", 0, norm=norm))
        return own


def contents_of(log: MessageLog) -> tuple[Content, ...]:
    """Every topic of a log in natural order, after one pass over it."""
    scan, hints = log.scan(strict=False), log.summary().topics
    seen: dict[int, _Seen] = {}
    for block in scan.blocks():
        channels: NDArray[np.int64] = block.header("channel").astype(np.int64)
        for number in np.flatnonzero(np.bincount(channels)).tolist():
            topic = scan.topics.get(number) or hints.get(number)
            if topic is None:
                continue
            seen.setdefault(number, _Seen(topic)).add(block.take(channels == number))
    for number, topic in {**hints, **scan.topics}.items():
        seen.setdefault(number, _Seen(topic))
    ordered = sorted(seen.values(), key=lambda s: natural(s.topic.name))
    return tuple(content for one in ordered for content in one.contents())
