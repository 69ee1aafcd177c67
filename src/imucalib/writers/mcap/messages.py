"""Topics as ROS 2 messages: whole arrays of MCAP message records, in chunks in time order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.readers.messages.definition import ACCEL_ROS2, IMU_ROS2, TEMPERATURE_ROS2
from imucalib.readers.messages.records import MESSAGE

#: Some 380 messages of one IMU: what one damaged byte costs. (1 MiB packs 12 % better on a board.)
_CHUNK_BYTES = 1 << 17
SCHEMAS = {
    1: ("sensor_msgs/msg/Imu", IMU_ROS2),
    2: ("imucal_msgs/msg/RawImu", IMU_ROS2),  # counts are no m/s2: another type says so
    3: ("sensor_msgs/msg/Temperature", TEMPERATURE_ROS2),
    4: ("geometry_msgs/msg/AccelWithCovarianceStamped", ACCEL_ROS2),
}
_IMU: dict[str, tuple[object, int]] = {
    "no_orientation": ("<f8", 32),
    "angular_rate": (("<f8", (3,)), 104),
    "angular_rate_covariance": (("<f8", (9,)), 128),
    "acceleration": (("<f8", (3,)), 200),
    "acceleration_covariance": (("<f8", (9,)), 224),
}
#: Of each schema the size of what follows the header, and type and place of its fields there.
_BODIES: dict[int, tuple[int, dict[str, tuple[object, int]]]] = {
    1: (296, _IMU),
    2: (296, _IMU),
    3: (16, {"temperature": ("<f8", 0)}),
    4: (336, {
        "acceleration": (("<f8", (3,)), 0),
        "angular_acceleration": (("<f8", (3,)), 24),
        "covariance": (("<f8", (6, 6)), 48),
    }),
}  # fmt: skip


@dataclass(frozen=True)
class Output:
    """One topic to be written: its message records but for the values.

    channels : names of the recording's channels in it; done : messages written before these
    """

    number: int
    schema: int
    topic: str
    metadata: dict[str, str]
    ns: NDArray[np.int64]
    log: NDArray[np.uint64]
    values: tuple[tuple[str, Array], ...]
    dtype: np.dtype[np.void]
    frame: bytes
    channels: tuple[str, ...]
    done: int = 0

    def records(self, rows: slice) -> NDArray[np.void]:
        """The message records of some samples."""
        ns, log = self.ns[rows], self.log[rows]
        out = np.zeros(ns.size, dtype=self.dtype)
        out["opcode"], out["length"] = MESSAGE, self.dtype.itemsize - 9
        out["channel"], out["log"], out["publish"] = self.number, log, log
        numbers = self.done + np.arange(rows.start, rows.start + ns.size)
        out["sequence"] = numbers & 0xFFFF_FFFF
        out["cdr"], out["sec"], out["nanosec"] = 0x0100, ns // 10**9, ns % 10**9
        out["frame_length"], out["frame"] = len(self.frame), np.void(self.frame)
        for name, values in self.values:
            out[name] = values[rows]
        if "no_orientation" in (out.dtype.names or ()):
            out["no_orientation"] = -1.0  # what the message defines for "not estimated"
        return out


def record_type(frame: int, schema: int) -> np.dtype[np.void]:
    """A whole message record: 31 bytes of MCAP, 4 of encapsulation, then the CDR message."""
    begin = 35 + 12 + frame
    begin += -(begin - 35) % 8
    fields: list[tuple[str, object, int]] = [
        ("opcode", "u1", 0), ("length", "<u8", 1), ("channel", "<u2", 9), ("sequence", "<u4", 11),
        ("log", "<u8", 15), ("publish", "<u8", 23), ("cdr", "<u2", 31), ("sec", "<i4", 35),
        ("nanosec", "<u4", 39), ("frame_length", "<u4", 43), ("frame", f"V{frame}", 47),
    ]  # fmt: skip
    size, body = _BODIES[schema]
    fields += [(name, kind, begin + at) for name, (kind, at) in body.items()]
    columns = {
        "names": [f[0] for f in fields],
        "formats": [f[1] for f in fields],
        "offsets": [f[2] for f in fields],
        "itemsize": begin + size,
    }
    return np.dtype(columns)  # type: ignore[call-overload, no-any-return]


#: Records of a chunk, and of each message its start, channel number and log time (ns).
ChunkData = tuple[bytes, NDArray[np.int64], NDArray[np.int64], NDArray[np.uint64]]


def chunks_of(outputs: list[Output]) -> Iterator[ChunkData]:
    """Chunks of about 128 KiB, the topics interleaved in time order."""
    outputs = [output for output in outputs if output.ns.size]
    if not outputs:
        return
    total = sum(output.ns.size * output.dtype.itemsize for output in outputs)
    first = min(int(output.log.min()) for output in outputs)
    last = max(int(output.log.max()) for output in outputs)
    step = max(1, (last - first) * _CHUNK_BYTES // total)
    done = [0] * len(outputs)
    edge = first
    peaks = [np.maximum.accumulate(output.log) for output in outputs]
    while any(d < o.ns.size for d, o in zip(done, outputs, strict=True)):
        waiting = [int(p[d]) for p, d in zip(peaks, done, strict=True) if d < p.size]
        edge = max(edge + step, min(waiting) + 1)
        stops = [int(np.searchsorted(peak, np.uint64(edge))) for peak in peaks]
        yield _interleaved(outputs, [slice(a, b) for a, b in zip(done, stops, strict=True)])
        done = stops


def _interleaved(outputs: list[Output], parts: list[slice]) -> ChunkData:
    records = [output.records(part) for output, part in zip(outputs, parts, strict=True)]
    log = np.concatenate([output.log[part] for output, part in zip(outputs, parts, strict=True)])
    sizes = np.concatenate([np.full(r.size, r.dtype.itemsize) for r in records])
    channels = np.concatenate([r["channel"].astype(np.int64) for r in records])
    order = np.argsort(log, kind="stable")
    starts = np.empty(log.size, dtype=np.int64)
    starts[order] = np.cumsum(sizes[order]) - sizes[order]
    data, at = np.zeros(int(sizes.sum()), dtype=np.uint8), 0
    for part in records:
        if part.size:
            whole = np.dtype(f"V{part.dtype.itemsize}")
            view = np.ndarray((data.size - whole.itemsize + 1,), whole, data, 0, (1,))
            view[starts[at : at + part.size]] = part.view(whole)
        at += part.size
    return data.tobytes(), starts[order], channels[order], log[order]
