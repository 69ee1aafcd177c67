"""ArduPilot's DataFlash logs (.bin): IMU, ACC and GYR messages, by the log's own FMT messages.

A message is A3 95, a type, and fields; type 128 (FMT) states type, length, name, one letter a field
and the fields' names. Letters and units: ArduPilot, libraries/AP_Logger/README.md and
LogStructure.h (accelerations m/s², rates rad/s, T in °C, TimeUS and SampleUS µs since boot).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.errors import UnreadableInput
from imucalib.readers.hdf5.reader import Held, HeldReader, put_channel
from imucalib.recording.onboard import TAKEN, Onboard, in_ardupilot, parameters_from

_MAGIC, _FMT, _FMT_SIZE = b"\xa3\x95", 128, 89
_LETTERS = {
    letter: kind
    for kind, letters in {
        "(32,)<i2": "a",
        "i1": "b",
        "u1": "BM",
        "<i2": "hc",
        "<u2": "HC",
        "<i4": "ieL",
        "<u4": "IE",
        "<f4": "f",
        "<f8": "d",
        "S4": "n",
        "S16": "N",
        "S64": "Z",
        "<i8": "q",
        "<u8": "Q",
        "<f2": "g",
    }.items()
    for letter in letters
}
#: Quantity, unit and fields of the messages that hold it, best first: samples as they came from the
#: sensor, then those that were fused.
_QUANTITIES = (
    ("acceleration", "m/s2", ("AccX", "AccY", "AccZ"), ("ACC", "IMU")),
    ("angular_rate", "rad/s", ("GyrX", "GyrY", "GyrZ"), ("GYR", "IMU")),
)
_INERTIAL = {"IMU", "ACC", "GYR"}  # without the digits that older logs number sensors with
_PARAMETER = "PARM"
_CLOCKS = (("SampleUS", 1e-6), ("TimeUS", 1e-6), ("TimeMS", 1e-3))  # s in one unit
#: Bytes read at a time; of two messages, which state their length in one byte; and bytes without a
#: message after which a file is no log.
_PIECE, _LONGEST, _MOST_WASTE = 16 << 20, 512, 64 << 20

_Layouts = dict[int, tuple[str, np.dtype[Any]]]
_Rows = dict[str, NDArray[Any]]  # structured messages by their name


class DataflashReader(HeldReader):
    """Reader of DataFlash logs; see `imucalib.readers.Reader`."""

    name = "dataflash"
    suffixes = (".bin",)

    def recognises(self, path: Path, head: bytes) -> bool:
        """Messages that state the format of messages, one after the other; the first may be
        damaged."""
        mark = _MAGIC + bytes([_FMT])
        at = [k for k in range(0, 8 * _FMT_SIZE, _FMT_SIZE) if head[k : k + 3] == mark]
        return len(at) > 1 or head.startswith(mark)

    def fill(self, held: Any, path: Path, *, strict: bool) -> Held:
        """Put the inertial messages in."""
        rows, lost = _messages(path)
        notes = (f"{lost} bytes belong to no message: what they held is missing",) if lost else ()
        if strict and notes:
            raise UnreadableInput(notes[0], where=str(path), remedy="read it without --strict")
        _fill(held, rows, path)
        return Held(notes, _onboard(rows))


READER = DataflashReader()


def _messages(path: Path) -> tuple[_Rows, int]:
    """Every inertial message and parameter, and the bytes that belong to no message; the file is
    read in pieces."""
    layouts: _Layouts = {}
    rows: dict[str, list[NDArray[Any]]] = {}
    lost, good, rest, more = 0, 0, np.empty(0, np.uint8), True
    with path.open("rb") as stream:
        while more:
            piece = np.frombuffer(stream.read(_PIECE), np.uint8)
            more, data = piece.size > 0, np.concatenate([rest, piece])
            header, length, end = _whole(data, layouts, last=not more)
            kinds = data[header + 2]
            for kind, (name, dtype) in layouts.items():
                at = header[kinds == kind]
                if at.size and (name.rstrip("123") in _INERTIAL or name == _PARAMETER):
                    packed = data[at[:, None] + np.arange(dtype.itemsize)]
                    rows.setdefault(name, []).append(np.ascontiguousarray(packed).view(dtype)[:, 0])
            good, lost = good + int(length.sum()), lost + end - int(length.sum())
            if lost > max(_MOST_WASTE, 8 * good):
                if not good:
                    raise UnreadableInput("this holds no messages", where=str(path))
                lost += path.stat().st_size - stream.tell() + data.size - end
                break
            rest = data[end:]
    return {name: np.concatenate(parts) for name, parts in rows.items()}, lost


def _whole(data: NDArray[np.uint8], layouts: _Layouts, *, last: bool) -> tuple[Index, Index, int]:
    """Where messages begin, how long they are, and up to where these bytes are done with: found by
    jumping from header to header, what does not fit is passed over up to the next that does.

    layouts : is filled meanwhile
    """
    header = np.flatnonzero((data[:-2] == _MAGIC[0]) & (data[1:-1] == _MAGIC[1]))
    _add_layouts(data, header, layouts)
    size = np.zeros(256, dtype=np.intp)
    for kind, (_, dtype) in layouts.items():
        size[kind] = dtype.itemsize
    header = header[size[data[header + 2]] > 0]
    length = size[data[header + 2]]
    # A message is one where another begins at its end: what lost bytes is no sample.
    ends = np.append(header, data.size) if last else header
    closed = np.isin(header + length, ends)
    header, length = header[closed], length[closed]
    keep = _chain_headers(header, length)
    header, length = header[keep], length[keep]
    if last:
        return header, length, data.size
    # Of what is longer than a message, what comes next says nothing.
    done = int(header[-1] + length[-1]) if header.size else 0
    return header, length, max(done, data.size - _LONGEST)


def _chain_headers(header: Index, length: Index) -> NDArray[np.bool_]:
    """Which headers are no bytes inside a message before them. Only those that overlap are walked:
    two bytes in 65,536 look like a header by chance."""
    keep = np.ones(header.size, dtype=bool)
    for k in np.flatnonzero(header[1:] < header[:-1] + length[:-1]):
        if not keep[k]:
            continue
        end = header[k] + length[k]
        inside = slice(k + 1, int(np.searchsorted(header, end)))
        keep[inside] = False
    return keep


def _add_layouts(data: NDArray[np.uint8], header: Index, layouts: _Layouts) -> None:
    """Name and fields of each type; types whose letters do not fill the length are left out."""
    for at in header[data[header + 2] == _FMT]:
        text = data[at + 3 : at + _FMT_SIZE].tobytes()
        if len(text) < _FMT_SIZE - 3:
            continue
        kind, size = text[0], text[1]
        name, letters, names = (_text(text[a:b]) for a, b in ((2, 6), (6, 22), (22, 86)))
        fields = names.split(",") if names else []
        if len(fields) != len(letters) or not set(letters) <= set(_LETTERS):
            continue
        if len(set(fields)) != len(fields) or not all(fields):
            continue
        dtype = np.dtype([("_header", "V3"), *zip(fields, map(_LETTERS.get, letters), strict=True)])
        if dtype.itemsize == size:
            layouts.setdefault(kind, (name, dtype))


def _text(raw: bytes) -> str:
    return raw.split(b"\0")[0].decode("ascii", "replace")


def _fill(held: Any, rows: _Rows, path: Path) -> None:
    for quantity, unit, axes, kinds in _QUANTITIES:
        for kind in kinds:
            for triad, some in _sensors(rows, kind):
                name = f"{triad}/{quantity}"
                if name not in held and all(_is_number(some, a) for a in axes):
                    put_channel(held, name, _seconds(some, path), [some[a] for a in axes], unit)
    if not len(held):
        raise UnreadableInput(
            "the log has no IMU, ACC or GYR messages",
            where=str(path),
            remedy="set LOG_BITMASK so that IMU or raw IMU messages are logged",
        )
    for triad, some in _sensors(rows, "IMU"):
        warm = next((name for name in ("T", "Temp") if _is_number(some, name)), None)
        name = f"{triad}/temperature"
        if warm is not None and name not in held:
            put_channel(held, name, _seconds(some, path), [some[warm]], "degC")


def _onboard(rows: _Rows) -> dict[str, Onboard]:
    """What was done to each channel: all messages hold scale (raw - law over temperature - offset),
    in the board's axes (AP_InertialSensor_Backend, _rotate_and_correct_accel and _gyro, before
    _notify_new_accel_raw_sample)."""
    some, found = rows.get(_PARAMETER), dict[str, Onboard]()
    stated: list[tuple[str, float]] = []
    if some is not None and _is_number(some, "Value") and some.dtype["Name"].kind == "S":
        names = (name.decode("ascii", "replace") for name in some["Name"].tolist())
        stated = list(zip(names, some["Value"].tolist(), strict=True))
    known = parameters_from(stated)
    for slot in range(3):
        law = TAKEN if known.number(f"INS_TCAL{slot + 1}_ENABLE") == 1.0 else ""
        for quantity, kind in (("acceleration", "ACC"), ("angular_rate", "GYR")):
            name = in_ardupilot(kind, slot)
            found[f"imu{slot}/{quantity}"] = known.onboard(
                slot,
                int(known.number(f"{name}_ID")),
                f"{name}OFFS_{{}}",
                f"{name}SCAL_{{}}",
                law,
                ("AHRS_ORIENTATION",),
            )
    return found


def _is_number(some: NDArray[Any], name: str) -> bool:
    """Whether messages have a field of this name, with one number each: letters may be damaged."""
    known = name in (some.dtype.names or ())
    return known and some.dtype[name].kind in "fiu" and some.dtype[name].shape == ()


def _sensors(rows: _Rows, kind: str) -> Iterator[tuple[str, NDArray[Any]]]:
    """Messages sensor by sensor: numbered by a field `I`, or in older logs by their name."""
    for name in sorted(n for n in rows if n.rstrip("123") == kind):
        some = rows[name]
        if _is_number(some, "I"):
            for number in np.unique(some["I"]):
                yield f"imu{number}", some[some["I"] == number]
        else:
            yield f"imu{int(name[len(kind) :] or 1) - 1}", some


def _seconds(some: NDArray[Any], path: Path) -> Array:
    """When a sample was taken, where the message says so, else when it was logged."""
    for name, unit in _CLOCKS:
        if _is_number(some, name) and some.dtype[name].kind in "iu" and np.any(some[name]):
            return np.asarray(some[name].astype(np.float64) * unit)
    raise UnreadableInput(
        "its inertial messages have no time (SampleUS, TimeUS or TimeMS)",
        where=str(path),
        remedy="download the log again",
    )
