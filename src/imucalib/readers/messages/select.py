"""Which topics and fields are read, and which triad each of them belongs to.

There is no common IMU schema outside ROS, so the names decide which fields are acceleration,
angular rate and time; a `FieldMapping` overrides them. Where nothing is found, `contents_of` lists
the log.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.errors import UsageError
from imucalib.readers.fields.choice import OPTIONS, Field, Vector, find_vectors, join_units
from imucalib.readers.fields.contents import Content, norm_of
from imucalib.readers.fields.words import INERTIAL, bare_quantity, instant_rank, understand
from imucalib.readers.messages.decode import Decoder, Look, decoder_for
from imucalib.readers.messages.layout import FieldGroup, LayoutError
from imucalib.readers.messages.records import MessageBlock, MessageLog, Topic
from imucalib.readers.messages.topics import TopicField, TopicSource
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.pairing import distinct_names

_SECONDS = (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"), ("seconds", "nanos"))
_AXES = (("x", "y", "z"), ("0", "1", "2"))
_CLOCKS = ("log_time", "publish_time")
_SENSOR_WORDS = re.compile(
    r"acc(?:el)?(?:erometer|eration)?|gyr(?:o(?:scope)?)?|angular_(?:velocity|rate)", re.IGNORECASE
)
_SI = {"acceleration": "m/s2", "angular_rate": "rad/s", "temperature": "degC"}
#: Channel metadata of the files that this package writes: what a ROS message cannot say.
META_TRIAD, META_QUANTITIES = "imucal.triad", "imucal.quantities"
META_ORIGIN, META_DATED = "imucal.origin_ns", "imucal.dated"
META_UNITS = {"acceleration": "imucal.acc_unit", "angular_rate": "imucal.gyro_unit"}

Leaves = Mapping[str, int]  # path -> how many numbers
_SAMPLED = 2000  # messages of a topic that give its norms, of the first block that has any
_Parts = dict[str, tuple[str, int]]


@dataclass(frozen=True)
class TopicTriad:
    """One sensor: its name and, by quantity, the topic and the place in that topic's fields.

    numbered : whether the name is only a number, since topics do not name the sensors
    """

    name: str
    parts: Mapping[str, tuple[str, int]]
    numbered: bool = False


def is_imu(topic: Topic) -> bool:
    """Whether the topic's type is sensor_msgs/Imu, in any of its spellings, or this package's."""
    own = META_TRIAD in topic.metadata
    return own or bool(re.fullmatch(r"sensor_msgs[/.](msg[/.])?Imu", topic.type_name))


def is_stated(mapping: FieldMapping, topic: Topic | None = None) -> bool:
    """Whether the mapping names a field of a topic, or of any."""
    texts = filter(None, addresses(mapping))
    return any(topic is None or split_address(text, topic) is not None for text in texts)


def addresses(mapping: FieldMapping) -> tuple[str, ...]:
    """All fields that the mapping names; of a sensor that lacks one, an empty text."""
    return (*mapping.acc, *mapping.gyro, *mapping.temperature)


def split_address(text: str, topic: Topic) -> str | None:
    """The field path of "topic:path" when it is of this topic ("" for none), else None."""
    if text == topic.name:
        return ""
    name, colon, path = text.rpartition(":")
    return path if colon and name == topic.name else None


# -- fields of a message ----------------------------------------------------------------------


def vector(leaves: Leaves, address: str) -> FieldGroup | None:
    """The 3-vector at an address; "acc_*" is short for acc_x, acc_y, acc_z, and "p+q+r" is three
    fields that share no name."""
    if "*" in address or "+" in address:
        each = address.split("+") if "+" in address else [address.replace("*", c) for c in "xyz"]
        known = len(each) == 3 and all(leaves.get(p) == 1 for p in each)
        return FieldGroup(tuple(each), 3) if known else None
    if leaves.get(address) == 3:
        return FieldGroup((address,), 3)
    for axes in _AXES:
        paths = tuple(f"{address}.{axis}" for axis in axes)
        more = f"{address}.w", f"{address}.3"  # a quaternion, or a longer list
        if all(leaves.get(p) == 1 for p in paths) and not any(p in leaves for p in more):
            return FieldGroup(paths, 3)
    return None


def scalar(leaves: Leaves, address: str) -> FieldGroup | None:
    """The single number at an address."""
    return FieldGroup((address,), 1) if leaves.get(address) == 1 else None


def instant(leaves: Leaves, address: str) -> FieldGroup | None:
    """The time at an address: one number, or seconds and nanoseconds."""
    pairs = (tuple(f"{address}.{name}" for name in names) for names in _SECONDS)
    two = (FieldGroup(paths, 2) for paths in pairs if all(leaves.get(p) == 1 for p in paths))
    return scalar(leaves, address) or next(two, None)


def _nodes(leaves: Leaves) -> list[str]:
    """Every path and those of what holds it, in order."""
    nodes: dict[str, None] = {}
    for path in leaves:
        parts = path.split(".")
        nodes.update(dict.fromkeys(".".join(parts[: i + 1]) for i in range(len(parts))))
    return list(nodes)


def _stars(leaves: Leaves) -> list[str]:
    return [f"{path[:-1]}*" for path in leaves if len(path) > 1 and path[-1] == "x"]


def _named(leaves: Leaves, topic: Topic) -> list[tuple[Vector, str, FieldGroup]]:
    """Every acceleration and angular rate that names tell, with its address and its numbers."""
    paths = list(leaves)
    fields = [Field(tuple(path.split(".")), count) for path, count in leaves.items()]
    found = []
    for one in find_vectors(
        fields, understand([f.name for f in fields], bare_quantity(topic.name))
    ):
        three = [paths[k] for k in one.parts]
        address = three[0] if len(three) == 1 else _address_of(three)
        if group := one.quantity in INERTIAL and vector(leaves, address):
            found.append((one, address, group))
    return found


def _address_of(three: Sequence[str]) -> str:
    """The shortest text that `vector` reads as these three paths."""
    for address in (three[0][:-2], f"{three[0][:-1]}*"):
        for path in (f"{address}.", address.rstrip("*")):
            if list(three) == [f"{path}{axis}" for axis in "xyz"]:
                return address
    return "+".join(three)


def _address(leaves: Leaves, topic: Topic, quantity: str) -> str:
    """The address of the field with the best name of a quantity, or ""; of a topic that holds one
    vector that of this."""
    own = [address for one, address, _ in _named(leaves, topic) if one.quantity == quantity]
    every = list(_vectors_of(leaves))
    return (own or (every if len(every) == 1 else [""]))[0]


def _time_address(leaves: Leaves) -> str:
    """The address of the time with the best name, or ""."""
    best = list[tuple[int, int, str]]()
    for path in _nodes(leaves):
        rank, depth = instant_rank(path.rpartition(".")[2]), path.count(".")
        if rank >= 0 and instant(leaves, path):
            best.append((depth if rank else -1, rank, path))
    return min(best)[2] if best else ""


def source_of(topic: Topic, look: Look, mapping: FieldMapping) -> TopicSource | None:
    """What to read from a topic, or None when it holds nothing that is wanted.

    Raises UsageError when the mapping names a field that the messages do not have.
    """
    leaves = look.leaves
    stated = [f for q in OPTIONS for f in _stated(topic, leaves, mapping, q)]
    if not stated and is_stated(mapping):
        return None
    own = topic.metadata.get(META_QUANTITIES)
    fields = stated
    if own is not None and not stated:
        every = [*_find(topic, leaves), *_own_temperature(leaves)]
        fields = [replace(f, found=False) for f in every if OPTIONS[f.quantity] in own.split()]
    elif len(stated) <= 1:
        named = [q for q, option in OPTIONS.items() if getattr(mapping, option)]
        fields = stated + [f for f in _find(topic, leaves) if f.quantity not in named]
        told = bare_quantity(topic.name) == "angular_rate"
        if not (stated or told or any(f.quantity == "acceleration" for f in fields)):
            return None  # a rate alone is also in odometry and in many a controller's messages
    if not fields:
        return None
    fields.sort(key=lambda f: list(OPTIONS).index(f.quantity))
    time, stamp = _time(topic, leaves, mapping)
    origin = topic.metadata.get(META_ORIGIN, "")
    return TopicSource(
        name=topic.name,
        imu=is_imu(topic),
        fields=tuple(fields),
        time=time,
        instant=stamp,
        frame=look.texts.get("header.frame_id", ""),
        triad=topic.metadata.get(META_TRIAD, ""),
        origin_ns=int(origin) if re.fullmatch(r"-?\d{1,19}", origin) else None,
        dated=topic.metadata.get(META_DATED) != "no",
    )


def _stated(topic: Topic, leaves: Leaves, mapping: FieldMapping, quantity: str) -> list[TopicField]:
    """The fields of a quantity that the mapping names in this topic."""
    fields, option = [], OPTIONS[quantity]
    single = quantity == "temperature"
    for text in getattr(mapping, option):
        path = split_address(text, topic) if text else None
        if path is None:
            continue
        address = path or ("" if single else _address(leaves, topic, quantity))
        group = (scalar if single else vector)(leaves, address) if address else None
        if group is None:
            raise UsageError(
                f"topic {topic.name} has no {'number' if single else '3-vector'} '{path}'",
                where=f"mapping: {option}",
                remedy=f"its fields: {', '.join(list(leaves)[:40])}",
            )
        named = understand([tuple(path.split(".")) for path in group.paths])
        unit = "" if single else _unit_of(topic, quantity, join_units([m.unit for m in named]))
        fields.append(TopicField(quantity, address, group, unit, found=False))
    return fields


def _find(topic: Topic, leaves: Leaves) -> list[TopicField]:
    """The vectors that their names tell, a field for each sensor and quantity."""
    fields = [
        TopicField(q := one.quantity, address, group, _unit_of(topic, q, one.unit), True, one.triad)
        for one, address, group in _named(leaves, topic)
    ]
    force = [f for f in fields if f.quantity == "acceleration"]
    if len(force) > 1:
        return [f for f in fields if f.sensor in {one.sensor for one in force}]
    turn = [f for f in fields if f.quantity == "angular_rate"]
    turn.sort(key=lambda f: f.sensor not in {one.sensor for one in force})
    return [replace(f, sensor="") for f in (*force, *turn[:1])]


def _own_temperature(leaves: Leaves) -> list[TopicField]:
    """Read only where a file of this package has it."""
    number = scalar(leaves, "temperature")
    name = "temperature"
    return [TopicField(name, name, number, _SI[name])] if number else []


def _unit_of(topic: Topic, quantity: str, named: str) -> str:
    """The unit that the message type states, or that the field's own name does."""
    usual = _SI[quantity] if is_imu(topic) else named
    return topic.metadata.get(META_UNITS[quantity], usual)


def _time(topic: Topic, leaves: Leaves, mapping: FieldMapping) -> tuple[str, FieldGroup | None]:
    """The address of a topic's time and the numbers there; a clock of the log has none."""
    if mapping.time in _CLOCKS:
        return mapping.time, None
    if not mapping.time:
        address = _time_address(leaves)
        return address, instant(leaves, address) if address else None
    path = split_address(mapping.time, topic) or mapping.time
    group = instant(leaves, path)
    if group is None:
        known = ", ".join(list(leaves)[:40])
        raise UsageError(
            f"topic {topic.name} has no time '{path}'",
            where="mapping: time",
            remedy=f"use log_time, publish_time or one of its fields: {known}",
        )
    return path, group


# -- triads -----------------------------------------------------------------------------------


def natural_key(text: str) -> tuple[tuple[bool, int, str], ...]:
    """Sort key under which imu2 comes before imu10."""
    parts = re.split(r"(\d+)", text)
    return tuple((p.isdigit(), int(p) if p.isdigit() else 0, p) for p in parts)


def triads_of(mapping: FieldMapping, sources: Mapping[str, TopicSource]) -> list[TopicTriad]:
    """The triads, in the natural order of topics, named as the mapping does, as the file does, or
    by the part of the topic that is theirs alone; a single one, or where topics do not say, imu0,
    imu1, ...

    A vector that is always zero is a part of a split topic, or was never filled: it is left out
    unless the user named it.
    """
    parts = (_stated_parts if is_stated(mapping) else _find_parts)(mapping, sources)
    owns = [{sources[topic].triad for topic, _ in part.values()} for part in parts]
    own = tuple(name for names in owns if len(names) == 1 for name in names if name)
    numbered = False
    if len(set(own)) != len(parts):
        topics_of = [
            list(dict.fromkeys(n for t, i in p.values() for n in (t, sources[t].fields[i].sensor)))
            for p in parts
        ]
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
    return [TopicTriad(name, part, numbered) for name, part in zip(names, parts, strict=True)]


def _stated_parts(mapping: FieldMapping, sources: Mapping[str, TopicSource]) -> list[_Parts]:
    count = max(len(mapping.acc), len(mapping.gyro), len(mapping.temperature))
    parts: list[_Parts] = [{} for _ in range(count)]
    used: set[tuple[str, int]] = set()
    for quantity, option in OPTIONS.items():
        for part, text in zip(parts, getattr(mapping, option), strict=False):
            place = next(
                (
                    (name, i)
                    for name, source in sources.items()
                    for i, f in enumerate(source.fields)
                    if f.quantity == quantity
                    and not f.found
                    and (name, i) not in used
                    and text in (name, f"{name}:{f.address}")
                ),
                None,
            )
            if place is not None:
                used.add(place)
                part[quantity] = place
            elif text:
                names = ", ".join(sorted(sources, key=natural_key)) or "none"
                raise UsageError(
                    f"'{text}' is not a topic of this file, or has no readable messages",
                    where=f"mapping: {option}",
                    remedy=f"topics found: {names}",
                )
    for part in parts:  # the other vector of the same messages
        for name, _ in tuple(part.values()):
            for i, f in enumerate(sources[name].fields):
                if f.found and f.quantity not in part and sources[name].alive[i]:
                    part[f.quantity] = (name, i)
    return parts


def _find_parts(mapping: FieldMapping, sources: Mapping[str, TopicSource]) -> list[_Parts]:
    parts: list[_Parts] = []
    halves: dict[str, list[_Parts]] = {}
    for name in sorted(sources, key=natural_key):
        source = sources[name]
        live = [(i, f) for i, f in enumerate(source.fields) if source.alive[i] or not f.found]
        sensors = [
            {f.quantity: (name, i) for i, f in live if f.sensor == sensor}
            for sensor in dict.fromkeys(f.sensor for _, f in live)
        ]
        parts += sensors[1:]
        if not sensors:
            continue
        part = sensors[0]
        stem = source.triad or _SENSOR_WORDS.sub("*", name)
        other = next((o for o in halves.get(stem, []) if not set(o) & set(part)), None)
        if other is not None:
            other.update(part)
            continue
        parts.append(part)
        if len(part) == 1 or source.triad:
            halves.setdefault(stem, []).append(part)
    return parts


# -- what a log holds -------------------------------------------------------------------------


def contents_of(log: MessageLog, topics: Mapping[int, Topic]) -> tuple[Content, ...]:
    """Every topic of a log, by its channel, in natural order, and below it its vectors; after one
    pass over it."""
    times = dict[int, tuple[int, float, float]]()  # messages, first and last log time
    held = dict[int, list[Content]]()
    why = dict.fromkeys(topics, "")
    for block in log.blocks():
        channels, log_time = block.header("channel"), block.header("log_time")
        for number in np.flatnonzero(np.bincount(channels)).tolist():
            if number not in topics:
                continue
            rows = np.flatnonzero(channels == number)
            low, high = int(log_time[rows].min()), int(log_time[rows].max())
            count, first, last = times.get(number, (0, math.inf, -math.inf))
            times[number] = count + rows.size, min(first, low), max(last, high)
            if number not in held:
                held[number] = []
                try:
                    held[number] = _held(topics[number], block.take(rows[:_SAMPLED]))
                except (LayoutError, UsageError) as error:  # the latter: a package is missing
                    why[number] = str(error)
    found = list[Content]()
    for number, topic in sorted(topics.items(), key=lambda item: natural_key(item[1].name)):
        count, first, last = times.get(number, (0, math.inf, -math.inf))
        rate = (count - 1) * 1e9 / (last - first) if count > 1 and last > first else math.nan
        kind = f"{topic.type_name} ({topic.encoding or 'no encoding'})"
        found.append(Content(topic.name, kind, count, rate, why=why[number]))
        found += held.get(number, [])
    return tuple(found)


def _held(topic: Topic, block: MessageBlock) -> list[Content]:
    """The vectors of a topic with their median norms in some messages."""
    decoder = decoder_for(topic)
    vectors = _vectors_of(decoder.look(block.payload(0)).leaves)
    named = {f"{topic.name}:{address}": group for address, group in vectors.items()}
    return _contents(decoder, block, named)


def _contents(
    decoder: Decoder, block: MessageBlock, vectors: Mapping[str, FieldGroup]
) -> list[Content]:
    """Vectors by their address, with their median norms in some messages."""
    if not vectors:
        return []
    columns, good, *_ = decoder.decode(block, tuple(vectors.values()))
    return [
        Content(address, "3 numbers", 0, norm=norm_of(column[good].astype(np.float64)))
        for address, column in zip(vectors, columns, strict=True)
    ]


def _vectors_of(leaves: Leaves) -> dict[str, FieldGroup]:
    """Every 3-vector by its address."""
    stars = [a for a in _stars(leaves) if a.replace("*", "w") not in leaves]  # no quaternion
    addresses = (*_nodes(leaves), *stars)
    named = {found: a for a in reversed(addresses) if (found := vector(leaves, a))}
    return {a: found for found, a in reversed(named.items())}


def list_left(
    decoder: Decoder, look: Look, payload: bytes, source: TopicSource | None
) -> list[Content]:
    """What a message of a topic holds beside what is read: its vectors with their norm, and other
    numbers, but for those of its header."""
    groups = source.groups if source else ()
    used = {path for group in groups for path in group.paths}
    block = MessageBlock(payload, np.array([0]), np.array([len(payload)]))
    vectors = {a: g for a, g in _vectors_of(look.leaves).items() if not used & set(g.paths)}
    found = _contents(decoder, block, vectors)
    used |= {path for address, group in vectors.items() for path in (*group.paths, address)}
    texts = {path for path in look.texts if path not in used}
    rest = [p for p in look.leaves if p not in used | texts and not p.startswith("header.")]
    return [*found, *(Content(path, f"{look.leaves[path]} numbers", 0) for path in rest)]
