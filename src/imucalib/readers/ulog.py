"""PX4 logs (.ulg), through the package pyulog: raw sensors where they are logged as fast as what
the filter was fed, else that. (The default profile logs raw sensors at 1 Hz.)

Topics and fields by PX4's message definitions: sensor_accel (x, y, z in m/s²), sensor_gyro (rad/s),
one instance a sensor; sensor_combined (accelerometer_m_s2, gyro_rad). Stamps are µs since boot.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.hdf5.reader import Held, HeldReader, put_channel
from imucalib.recording.onboard import AHEAD, TAKEN, Onboard, Parameters, in_px4, parameters_from

_MAGIC = b"ULog\x01\x12\x35"
_US = 1e-6
_SLOTS = 4  # of calibrations that PX4 keeps
_LONGEST_MESSAGE = 3 + (1 << 16)  # bytes
#: The filter is fed each sample once, or some raw samples integrated to one: raw sensors that are
#: logged at less than a third of its rate were thinned out.
_THINNED = 1.0 / 3.0
#: Topic, quantity, its fields, its unit.
_RAW = (
    ("sensor_accel", "acceleration", ("x", "y", "z"), "m/s2"),
    ("sensor_accel", "temperature", ("temperature",), "degC"),
    ("sensor_gyro", "angular_rate", ("x", "y", "z"), "rad/s"),
)
_COMBINED, _SELECTION = "sensor_combined", "sensor_selection"
_FILTERED = (
    (_COMBINED, "acceleration", tuple(f"accelerometer_m_s2[{k}]" for k in range(3)), "m/s2"),
    (_COMBINED, "angular_rate", tuple(f"gyro_rad[{k}]" for k in range(3)), "rad/s"),
)


class UlogReader(HeldReader):
    """Reader of PX4 logs; needs the extra `px4`. See `imucalib.readers.Reader`."""

    name = "ulog"
    suffixes = (".ulg",)

    def recognises(self, path: Path, head: bytes) -> bool:
        """The seven bytes that every such log begins with."""
        return head.startswith(_MAGIC)

    def fill(self, held: Any, path: Path, *, strict: bool) -> Held:
        """Put the log's sensors in."""
        log, said = _log(path)
        topics, thinned = _choose(log.data_list)
        notes = (*_damage(log, said, path, strict=strict), *thinned)
        _fill(held, topics, path)
        return Held(notes, _onboard(log, topics))


READER = UlogReader()


def _log(path: Path) -> tuple[Any, str]:
    """The log, and what the package says of it, which must not reach our stdout."""
    try:
        from pyulog import ULog
    except ImportError as error:
        raise UsageError(
            "PX4 logs need the package pyulog, which is not installed",
            where=str(path),
            remedy="install the extra: pip install 'imucalib[px4]'",
        ) from error
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), _WithoutZeros(path) as content:
            log = ULog(
                io.BufferedReader(content, 1 << 16),
                sorted({_SELECTION, *(topic for topic, *_ in (*_RAW, *_FILTERED))}),
            )
        return log, said.getvalue()
    except Exception as error:  # what the package raises on damage depends on where the damage is
        raise UnreadableInput(
            f"the log cannot be read: {error}", where=str(path), remedy="download it again"
        ) from error


class _WithoutZeros(io.FileIO):
    """A file up to its last byte that is not zero: where power failed, a log ends in zeros, which
    the package searches byte by byte."""

    _end: int | None = None

    def readinto(self, into: Any) -> int:
        """Fill a buffer with the next bytes."""
        if self._end is None:
            self._end = self._last()
        view = memoryview(into).cast("B")
        return super().readinto(view[: max(self._end - self.tell(), 0)]) or 0

    def _last(self) -> int:
        at, end = self.tell(), self.seek(0, io.SEEK_END)
        while end:
            begin = max(end - (1 << 20), 0)
            self.seek(begin)
            block = bytearray(end - begin)
            kept = bytes(block[: super().readinto(block) or 0]).rstrip(b"\0")
            if kept:
                # A whole message may end in zeros of its own.
                end = begin + len(kept) + _LONGEST_MESSAGE
                break
            end = begin
        self.seek(at)
        return end


def _damage(log: Any, said: str, path: Path, *, strict: bool) -> tuple[str, ...]:
    notes = []
    if log.file_corruption or "corrupt" in said:
        notes.append("parts of the log are damaged: what they held is missing")
    if log.dropouts:
        lost = sum(d.duration for d in log.dropouts) / 1e3
        notes.append(f"the logger dropped out {len(log.dropouts)} times, {lost:.3g} s in all")
    if strict and notes:
        raise UnreadableInput(notes[0], where=str(path), remedy="read it without --strict")
    return tuple(notes)


def _choose(topics: Sequence[Any]) -> tuple[list[Any], tuple[str, ...]]:
    """The topics to read, and a sentence on those that are left out for their rate."""
    fed = max((_rate(d) for d in topics if d.name == _COMBINED), default=0.0)
    raw = [d for d in topics if d.name not in (_COMBINED, _SELECTION)]
    slow = [d for d in raw if _rate(d) < _THINNED * fed]
    if not slow:
        return list(topics), ()
    names = ", ".join(f"{d.name} {d.multi_id} ({_rate(d):.3g} Hz)" for d in slow)
    note = f"logged more slowly than {_COMBINED} ({fed:.4g} Hz), and left out: {names}"
    return [d for d in topics if d not in slow], (note,)


def _rate(topic: Any) -> float:
    """Samples a second; 0 where its stamps give none."""
    t = _seconds(topic.data)
    span = float(t[-1] - t[0]) if t.size > 1 else 0.0
    return (t.size - 1) / span if span > 0.0 else 0.0


def _fill(held: Any, topics: Sequence[Any], path: Path) -> None:
    for table in (_RAW, _FILTERED):
        for topic, quantity, fields, unit in table:
            for one in (d for d in topics if d.name == topic):
                name = f"imu{one.multi_id}/{quantity}"
                if name not in held and set(fields) <= set(one.data):
                    columns = [one.data[f] for f in fields]
                    put_channel(held, name, _seconds(one.data), columns, unit)
        if len(held):
            return
    raise UnreadableInput(
        "the log has no samples of sensor_accel, sensor_gyro or sensor_combined",
        where=str(path),
        remedy="log raw sensors: set the parameter SDLOG_PROFILE so that it includes them",
    )


def _onboard(log: Any, topics: Sequence[Any]) -> dict[str, Onboard]:
    """What was done to each channel. sensor_accel and sensor_gyro are what the drivers read, unless
    their raw counts stand beside (before PX4 1.11, corrected by drivers); sensor_combined is
    corrected and turned (src/lib/sensor_calibration)."""
    changes = [(name, value) for _, name, value in log.changed_parameters]
    known = parameters_from([*log.initial_parameters.items(), *changes])
    found = dict[str, Onboard]()
    for topic, quantity, kind in (
        ("sensor_accel", "acceleration", "ACC"),
        ("sensor_gyro", "angular_rate", "GYRO"),
        (_COMBINED, "acceleration", "ACC"),
        (_COMBINED, "angular_rate", "GYRO"),
    ):
        for one in (d for d in topics if d.name == topic):
            ids = _devices(one, known, kind, log)
            found.setdefault(f"imu{one.multi_id}/{quantity}", _done(one, known, kind, ids))
    return found


def _devices(topic: Any, known: Parameters, kind: str, log: Any) -> set[int]:
    """The ids of the chips that a topic may be of."""
    source, field = topic.data, "device_id"
    if topic.name == _COMBINED:
        field = "accel_device_id" if kind == "ACC" else "gyro_device_id"
        source = next((d.data for d in log.data_list if d.name == _SELECTION), {})
    if field in source:
        return set(np.unique(source[field]).tolist())
    return {int(known.number(f"{in_px4(kind, k)}_ID")) for k in range(_SLOTS)} - {0}


def _done(topic: Any, known: Parameters, kind: str, ids: set[int]) -> Onboard:
    """What was done to a topic's readings, of a chip by its ids."""
    device = next(iter(ids)) if len(ids) == 1 else 0
    own = (k for k in range(_SLOTS) if device and known.number(f"{in_px4(kind, k)}_ID") == device)
    slot = next(own, topic.multi_id)
    name, thermal = in_px4(kind, slot), f"TC_{kind[0]}"
    follows = known.number(f"{thermal}_ENABLE") and any(
        device and known.number(f"{thermal}{k}_ID") == device for k in range(_SLOTS)
    )
    if topic.name != _COMBINED and "x_raw" not in topic.data:
        return Onboard(slot, device, law=AHEAD if follows else "")
    turns = ("SENS_BOARD_ROT", *(f"SENS_BOARD_{a}_OFF" for a in "XYZ"), f"{name}_ROT")
    turns = turns if topic.name == _COMBINED else ()
    law = TAKEN if follows else ""
    done = known.onboard(slot, device, f"{name}_{{}}OFF", f"{name}_{{}}SCALE", law, turns)
    if topic.name == _COMBINED and len(ids) != 1:
        return replace(done, fault=f"{_COMBINED} is of one of {len(ids)} sensors")
    return done


def _seconds(data: Any) -> Array:
    """When the sensor was sampled, where the log says so, else when the message was published."""
    stamps = data.get("timestamp_sample")
    if stamps is None or not np.all(stamps > 0):
        stamps = data["timestamp"]
    return np.asarray(stamps.astype(np.float64) * _US)
