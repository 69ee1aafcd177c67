"""Which channels go into which topic, block by block: a topic a triad where their times agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UsageError
from imucalib.readers.messages.fields import (
    META_ACC_UNIT,
    META_DATED,
    META_GYRO_UNIT,
    META_ORIGIN,
    META_QUANTITIES,
    META_TRIAD,
)
from imucalib.recording.recording import Channel, Recording
from imucalib.writers import ChannelsChange
from imucalib.writers.mcap.messages import Output, record_type

SHORT_NAMES = {"acceleration": "acc", "angular_rate": "gyro", "temperature": "temperature"}
_SPUN, _DOUBTED = "angular_acceleration", "_covariance"
_WIDTHS = {"acceleration": 3, "angular_rate": 3, "temperature": 1, _SPUN: 3}
_WIDTHS |= {f"{name}{_DOUBTED}": 9 for name in ("acceleration", "angular_rate", _SPUN)}
_UNITS = {
    "acceleration": "m/s2", "angular_rate": "rad/s", "temperature": "degC", _SPUN: "rad/s2",
    "acceleration_covariance": "m2/s4", "angular_rate_covariance": "rad2/s2",
    "angular_acceleration_covariance": "rad2/s4",
}  # fmt: skip
Part = tuple[str, tuple[str, ...]]  #: a topic, and the names of the channels in it


def outputs_of(
    recording: Recording, names: dict[str, str], first: int, origin: int
) -> list[Output]:
    """One output a topic; raises UsageError for a channel that no ROS message can hold.

    names : channel -> topic; first : lowest free channel number; origin : ns added to log times
    """
    _demand_messages(recording)
    groups: dict[tuple[str, str], list[str]] = {}
    for name, channel in recording.channels.items():
        groups.setdefault((names[name], channel.triad), []).append(name)
    split = [
        part for (topic, _), group in groups.items() for part in _by_times(topic, group, recording)
    ]
    used = [topic for topic, _ in split]
    if len(set(used)) != len(used):
        raise UsageError(
            "two triads would share a topic", where=recording.path, remedy="rename the triads"
        )
    return [
        _output(recording, topic, channels, first + i, origin)
        for i, (topic, channels) in enumerate(split)
    ]


def following(outputs: list[Output], recording: Recording) -> list[Output]:
    """The outputs of the block after, in the topics of the one before.

    Raises ChannelsChange for a channel that is in none, or whose times leave those that share its
    topic.
    """
    _demand_messages(recording)
    found = []
    for before in outputs:
        present = tuple(n for n in before.channels if n in recording.channels)
        done = before.done + before.ns.size
        if not present:
            none = slice(0)
            values = tuple((q, v[none]) for q, v in before.values)
            empty = replace(before, ns=before.ns[none], log=before.log[none], values=values)
            found.append(replace(empty, done=done))
            continue
        times = [recording.channels[n].t for n in present]
        if present != before.channels or any(not np.array_equal(times[0], t) for t in times[1:]):
            raise _changed(recording, before.channels)
        now = _output(recording, before.topic, present, before.number, 0)
        if (now.schema, now.metadata) != (before.schema, before.metadata):
            raise _changed(recording, before.channels)
        found.append(replace(now, done=done))
    unknown = set(recording.channels) - {n for output in outputs for n in output.channels}
    if unknown:
        raise _changed(recording, tuple(sorted(unknown)))
    return found


def _changed(recording: Recording, channels: tuple[str, ...]) -> ChannelsChange:
    return ChannelsChange(
        f"channels change within the recording: {', '.join(channels)}",
        where=recording.path,
        remedy="write HDF5 (.h5) instead",
    )


def _demand_messages(recording: Recording) -> None:
    """Raise UsageError for a channel that no message can hold."""
    for name, channel in recording.channels.items():
        if _WIDTHS.get(channel.quantity) != channel.values.shape[1]:
            raise UsageError(
                f"channel {name} ({channel.quantity}, {channel.values.shape[1]} columns) has no"
                " ROS message",
                where=recording.path,
                remedy="write HDF5 (.h5) instead",
            )


def _by_times(topic: str, group: list[str], recording: Recording) -> list[Part]:
    """Channels of one topic; those with other times or units go to a topic beside it."""
    first = recording.channels[group[0]]
    together, apart = [group[0]], list[str]()
    for name in group[1:]:
        channel = recording.channels[name]
        same = np.array_equal(first.t, channel.t) and _raw(first) == _raw(channel)
        (together if same else apart).append(name)
    if not apart:
        return [(topic, tuple(together))]
    words = {"acceleration": "accel", "angular_rate": "gyro", "temperature": "temperature"}
    words |= {f"{name}{_DOUBTED}": f"{word}{_DOUBTED}" for name, word in words.items()}
    quantities = {n: recording.channels[n].quantity for n in (*together, *apart)}
    return [(f"{topic}/{words[quantities[n]]}", (n,)) for n in (*together, *apart)]


def _raw(channel: Channel) -> bool:
    return channel.unit != _UNITS[channel.quantity]


def _output(
    recording: Recording, topic: str, names: tuple[str, ...], number: int, origin: int
) -> Output:
    channels = [recording.channels[n] for n in names]
    units = {SHORT_NAMES[c.quantity]: c.unit for c in channels if c.quantity in SHORT_NAMES}
    start = recording.start_ns or 0
    metadata = {
        META_TRIAD: channels[0].triad,
        META_QUANTITIES: " ".join(units),
        META_ORIGIN: str(start),
        META_DATED: "yes" if recording.start_ns is not None else "no",
        META_ACC_UNIT: units.get("acc", ""),
        META_GYRO_UNIT: units.get("gyro", ""),
    }
    temperature = channels[0].quantity == "temperature"
    spun = any(c.quantity.startswith(_SPUN) for c in channels)
    schema = 3 if temperature else 4 if spun else 2 if any(_raw(c) for c in channels) else 1
    if temperature and _raw(channels[0]):
        raise UsageError("a temperature in counts has no ROS message", where=recording.path)
    steps = np.rint(channels[0].t * 1e9).astype(np.int64)
    ns, log = start + steps, (start + origin + steps).astype(np.uint64)
    values = tuple((c.quantity, c.values[:, 0] if temperature else c.values) for c in channels)
    if spun:
        values = _accel(recording, channels[0].triad, channels[0].t)
    frame = channels[0].triad.encode() + b"\0"
    dtype = record_type(len(frame), schema)
    return Output(
        number=number,
        schema=schema,
        topic=topic,
        metadata=metadata,
        ns=ns,
        log=log,
        values=values,
        dtype=dtype,
        frame=frame,
        channels=names,
    )


def _accel(recording: Recording, triad: str, t: Array) -> tuple[tuple[str, Array], ...]:
    """The six of an acceleration message and their covariance; NaN of what the triad has not."""
    own = {
        c.quantity: c.values
        for c in recording.channels.values()
        if c.triad == triad and np.array_equal(c.t, t)
    }
    covariance = np.zeros((len(t), 6, 6))
    for k, name in enumerate(("acceleration", _SPUN)):
        inner = slice(3 * k, 3 * k + 3)
        found = own.get(f"{name}{_DOUBTED}")
        covariance[:, inner, inner] = np.nan if found is None else found.reshape(-1, 3, 3)
    none = np.full((len(t), 3), np.nan)
    return (
        ("acceleration", own.get("acceleration", none)),
        (_SPUN, own.get(_SPUN, none)),
        ("covariance", covariance),
    )
