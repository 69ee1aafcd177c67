"""Which topics and fields are read, and which triad each of them belongs to."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from imucalib.errors import UsageError
from imucalib.readers.messages import fields as mf
from imucalib.readers.messages.fields import Field, Leaves, TopicFields
from imucalib.readers.messages.records import Topic
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.pairing import distinct_names

QUANTITIES = ("acc", "gyro", "temperature")
_UNITS = {"acc": "m/s2", "gyro": "rad/s", "temperature": ""}
_FINDERS = {"acc": mf.find_acc, "gyro": mf.find_gyro}
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
    own = dict(topic.metadata).get(mf.META_QUANTITIES, "").split()
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
        resolve = mf.scalar if quantity == "temperature" else mf.vector
        found = resolve(leaves, address) if address else ()
        if not found:
            raise UsageError(
                f"topic {topic.name} has no {'number' if quantity == 'temperature' else '3-vector'}"
                f" '{path}'",
                where=f"mapping: {quantity}",
                remedy=f"its fields: {', '.join(list(leaves)[:40])}",
            )
        unit = mf.stated_unit(topic, address, _UNITS[quantity])
        fields.append(Field(quantity, address, found, unit, found=False))
    return fields


def _found(topic: Topic, leaves: Leaves, quantity: str) -> list[Field]:
    if quantity == "temperature":  # asked for only where a file of this package has it
        found = mf.scalar(leaves, quantity)
        return [Field(quantity, quantity, found, "degC")] if found else []
    address = _FINDERS[quantity](leaves) if quantity in _FINDERS else ""
    if not address:
        return []
    unit = mf.stated_unit(topic, address, _UNITS[quantity])
    return [Field(quantity, address, mf.vector(leaves, address), unit)]


def _timed(
    topic: Topic, leaves: Leaves, mapping: FieldMapping, fields: tuple[Field, ...]
) -> TopicFields:
    own = dict(topic.metadata)
    origin = own.get(mf.META_ORIGIN, "")
    whole = TopicFields(
        fields,
        triad=own.get(mf.META_TRIAD, ""),
        origin_ns=int(origin) if re.fullmatch(r"-?\d{1,19}", origin) else None,
        dated=own.get(mf.META_DATED) != "no",
    )
    if mapping.time in _CLOCKS:
        return replace(whole, time=mapping.time)
    if not mapping.time:
        address = mf.find_time(leaves)
        stamps = mf.instant(leaves, address) if address else ()
        return replace(whole, time=address, time_leaves=stamps)
    path = split_address(mapping.time, topic) or mapping.time
    stamps = mf.instant(leaves, path)
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
