"""Small recordings in every format, written by code that shares nothing with the readers (but for
this package's own outputs), with the truth of every sample."""

from __future__ import annotations

import gzip
import io
import json
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
from mcap.writer import CompressionType

from imucalib import writers
from imucalib.recording.recording import Channel, Recording
from worlds.bag_logs import ros1_bag
from worlds.flight_logs import dataflash, ulog
from worlds.fuzz.truth import Series, Truth
from worlds.logger_files import Sample, ax_file, gene_file, gt3x_second, old_gt3x
from worlds.mcap_logs import IMU_ROS1, Reading, cdr, packed, ros1, write_log

G, DEG = 9.80665, np.pi / 180.0
START = 1_700_000_000_000_000_000
WHEN = datetime.fromtimestamp(START // 10**9, UTC)
ROWS = 600


@dataclass(frozen=True)
class Made:
    """A file's bytes, the truth, and where its units begin.

    pack : what is done to the bytes after the damage (a log inside an archive), or nothing
    """

    data: bytes
    truth: Truth
    edges: Sequence[int] = ()
    pack: Callable[[bytes], bytes] = bytes


@dataclass(frozen=True)
class Kind:
    """One format. checked : a checksum covers all that the file says, its samples alone, or
    nothing; `length` : the file states how much it holds"""

    suffix: str
    make: Callable[[np.random.Generator, Path], Made]
    checked: str
    length: bool


def _poses(rng: np.random.Generator, rows: int) -> np.ndarray:
    """(n, 3) in g: a sensor put down five ways, with noise; no two samples alike."""
    ways = np.array(
        [[0.1, -0.2, 0.97], [0.9, 0.3, 0.3], [-0.5, 0.8, 0.33], [0, 0, -1], [-0.7, 0, 0.7]]
    )
    turn = ways[(np.arange(rows) * len(ways)) // rows]
    return turn + rng.normal(scale=0.012, size=(rows, 3))


def _counts(rng: np.random.Generator, rows: int, a_g: float) -> np.ndarray:
    """(n, 3) whole numbers, no two rows alike, not even in three neighbouring counts."""
    counts = np.rint(_poses(rng, rows) * a_g).astype(int)
    while len(np.unique(counts, axis=0)) < rows:
        _, first = np.unique(counts, axis=0, return_index=True)
        again = np.setdiff1d(np.arange(rows), first)
        counts[again] += rng.integers(-3, 4, (again.size, 3))
    return counts


def _times(rate: float, rows: int) -> np.ndarray:
    return START + np.rint(np.arange(rows) / rate * 1e9).astype(np.int64)


# -- MCAP ---------------------------------------------------------------------------------------


def _readings(rng: np.random.Generator, sensors: int) -> tuple[list[list[Reading]], Truth]:
    rows, acc, gyro = [], [], []
    for k in range(sensors):
        n = ROWS // sensors
        ns, a, w = _times(100.0, n), _poses(rng, n) * G, rng.normal(scale=0.01, size=(n, 3))
        frame = f"imu{k}"
        columns = zip(ns.tolist(), a.tolist(), w.tolist(), strict=True)
        rows.append([Reading(t, tuple(x), tuple(y), frame) for t, x, y in columns])
        acc.append(Series(ns, a))
        gyro.append(Series(ns, w))
    return rows, Truth({"acceleration": tuple(acc), "angular_rate": tuple(gyro)})


def _json(reading: Reading) -> bytes:
    vectors = {"linear_acceleration": reading.acc, "angular_velocity": reading.gyro}
    tree: dict[str, object] = {n: dict(zip("xyz", v, strict=True)) for n, v in vectors.items()}
    stamp = {"sec": reading.ns // 10**9, "nanosec": reading.ns % 10**9}
    return json.dumps({"header": {"stamp": stamp, "frame_id": "imu"}, **tree}).encode()


def _protobuf() -> tuple[tuple[str, str, bytes], Callable[[Reading], bytes]]:
    """The schema and the packing, by Google's own library."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

    files = descriptor_pb2.FileDescriptorSet()
    timestamp_pb2.DESCRIPTOR.CopyToProto(files.file.add())
    file = files.file.add(name="imu.proto", package="p", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    vector = file.message_type.add(name="Vector")
    for k, name in enumerate("xyz"):
        vector.field.add(name=name, number=k + 1, type=1, label=1)
    imu = file.message_type.add(name="Imu")
    names = ("timestamp", "linear_acceleration", "angular_velocity")
    kinds = (".google.protobuf.Timestamp", ".p.Vector", ".p.Vector")
    for k, (name, kind) in enumerate(zip(names, kinds, strict=True)):
        imu.field.add(name=name, number=k + 1, type=11, type_name=kind, label=1)
    pool = descriptor_pool.DescriptorPool()
    for part in files.file:
        pool.Add(part)
    found = message_factory.GetMessageClass(pool.FindMessageTypeByName("p.Imu"))

    def pack(reading: Reading) -> bytes:
        message = found()
        message.timestamp.FromNanoseconds(reading.ns)
        for name, v in zip(names[1:], (reading.acc, reading.gyro), strict=True):
            part = getattr(message, name)
            part.x, part.y, part.z = v
        return bytes(message.SerializeToString())

    return ("p.Imu", "protobuf", files.SerializeToString()), pack


def _mcap(
    encoding: str = "cdr", compression: CompressionType = CompressionType.ZSTD, sensors: int = 1,
    **options: object,
) -> Callable[[np.random.Generator, Path], Made]:  # fmt: skip
    def make(rng: np.random.Generator, folder: Path) -> Made:
        rows, truth = _readings(rng, sensors)
        pack: Callable[[Reading], bytes] = {"cdr": cdr, "ros1": ros1, "json": _json}.get(
            encoding, cdr
        )
        schema = ("sensor_msgs/msg/Imu", "ros2msg", b"")
        if encoding == "ros1":
            options["schema"] = ("sensor_msgs/Imu", "ros1msg", IMU_ROS1.encode())
        elif encoding == "json":
            options["schema"] = ("Imu", "jsonschema", b"{}")
        elif encoding == "protobuf":
            schema, pack = _protobuf()
            options["schema"] = schema
        topics = {f"/imu{k}": packed(r, pack) for k, r in enumerate(rows)}
        path = folder / "made.mcap"
        options.setdefault("chunk_size", 1 << 14)
        write_log(path, topics, encoding=encoding, compression=compression, **options)
        data = path.read_bytes()
        return Made(data, truth, _records(data))

    return make


def _records(data: bytes) -> list[int]:
    """Where MCAP records begin."""
    at, edges = 8, []
    while at + 9 <= len(data) - 8:
        edges.append(at)
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    return [*edges, len(data) - 8]


# -- this package's own outputs -----------------------------------------------------------------


def _own(suffix: str) -> Callable[[np.random.Generator, Path], Made]:
    def make(rng: np.random.Generator, folder: Path) -> Made:
        _, truth = _readings(rng, 2)
        channels = {}
        for quantity, unit in (("acceleration", "m/s2"), ("angular_rate", "rad/s")):
            for k, series in enumerate(truth.series[quantity]):
                t = (series.ns - START) * 1e-9
                name = f"imu{k}/{quantity}"
                channels[name] = Channel(t, series.values, unit, quantity, f"imu{k}", 100.0)
        path = folder / f"own{suffix}"
        writers.write(Recording(channels, "made", "made", "0" * 64, start_ns=START), path)
        data = path.read_bytes()
        edges = {".mcap": _records, ".csv": _lines}.get(suffix, _pages)(data)
        return Made(data, truth, edges)

    return make


def _lines(data: bytes) -> list[int]:
    return [0, *(k + 1 for k, byte in enumerate(data) if byte == 10)]


def _pages(data: bytes) -> list[int]:
    return list(range(0, len(data) + 1, 512))


# -- HDF5 and text ------------------------------------------------------------------------------


def _hdf5(**storage: object) -> Callable[[np.random.Generator, Path], Made]:
    def make(rng: np.random.Generator, folder: Path) -> Made:
        acc = _poses(rng, ROWS) * G
        path = folder / "made.h5"
        if storage:
            storage["chunks"] = (100, 3)
        with h5py.File(path, "w") as file:
            file["acceleration"] = 0
            del file["acceleration"]
            values = file.create_dataset("imu/acceleration", data=acc, **storage)
            values.attrs["units"] = "m/s2"
            if storage:
                storage["chunks"] = (100,)
            ns = _times(100.0, ROWS)
            file.create_dataset("imu/time", data=ns, **storage).attrs["units"] = "ns"
        data = path.read_bytes()
        return Made(data, Truth({"acceleration": (Series(ns, acc),)}), _pages(data))

    return make


def _euroc(rng: np.random.Generator, folder: Path) -> Made:
    """Nanoseconds, rates and forces, as the EuRoC sets have them."""
    ns, acc = _times(200.0, ROWS), np.round(_poses(rng, ROWS) * G, 5)
    gyro = np.round(rng.normal(scale=0.01, size=(ROWS, 3)), 5)
    lines = ["#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
             "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"]  # fmt: skip
    for t, w, a in zip(ns.tolist(), gyro.tolist(), acc.tolist(), strict=True):
        lines.append(",".join(map(str, [t, *w, *a])))
    data = ("\n".join(lines) + "\n").encode()
    truth = Truth({"acceleration": (Series(ns, acc),), "angular_rate": (Series(ns, gyro),)})
    return Made(data, truth, _lines(data))


def _seconds(rng: np.random.Generator, folder: Path) -> Made:
    """Seconds from zero, g, semicolons and decimal commas."""
    acc = np.round(_poses(rng, ROWS), 5)
    rows = zip(np.arange(ROWS).tolist(), acc.tolist(), strict=True)
    lines = ["time [s];acc_x [g];acc_y [g];acc_z [g]"]
    lines += [";".join(f"{v:.5f}".replace(".", ",") for v in (k / 50, *a)) for k, a in rows]
    data = ("\r\n".join(lines) + "\r\n").encode()
    ns = _times(50.0, ROWS) - START
    return Made(data, Truth({"acceleration": (Series(ns, acc * G),)}, 1e-12), _lines(data))


#: Text clocks: heading, strftime (%L is milliseconds) and hours east of UTC.
_TEXT_CLOCKS = {
    "iso": ("time", "%Y-%m-%d %H:%M:%S.%L", 0),
    "iso T Z": ("timestamp", "%Y-%m-%dT%H:%M:%S.%LZ", 0),
    "zone": ("time", "%Y-%m-%d %H:%M:%S.%L+02", 2),
    "zone by name": ("time", "%Y-%m-%d %H:%M:%S.%L CET", 1),
    "AM/PM": ("time", "%m/%d/%Y %I:%M:%S.%L %p", 0),
    "German": ("Zeit", "%d.%m.%Y %H:%M:%S.%L", 0),
    "month": ("time", "%d-%b-%Y %I:%M:%S.%L p.m.", 0),
    "Date, Time": ("Date,Time", "%d/%m/%Y,%H:%M:%S.%L", 0),
    "parts": ("Year,Month,Day,Hour,Minute,Second", "%Y,%m,%d,%H,%M,%S.%L", 0),
}  # fmt: skip


def _text_clock(name: str) -> Callable[[np.random.Generator, Path], Made]:
    """Stamps as text, 50 Hz; no two rows alike."""

    def make(rng: np.random.Generator, folder: Path) -> Made:
        heading, form, hours = _TEXT_CLOCKS[name]
        acc, ns = np.round(_poses(rng, ROWS), 5), _times(50.0, ROWS)
        lines = [f"{heading},acc_x [g],acc_y [g],acc_z [g]"]
        for t, a in zip(ns.tolist(), acc.tolist(), strict=True):
            when = datetime.fromtimestamp(t // 10**9, UTC) + timedelta(hours=hours)
            stamp = when.strftime(form.replace("%L", f"{t // 10**6 % 1000:03d}"))
            lines.append(",".join([stamp, *(f"{v:.5f}" for v in a)]))
        data = ("\n".join(lines) + "\n").encode()
        return Made(data, Truth({"acceleration": (Series(ns, acc * G),)}, 1e-12), _lines(data))

    return make


def _gzipped(
    make: Callable[[np.random.Generator, Path], Made],
) -> Callable[[np.random.Generator, Path], Made]:
    def zipped(rng: np.random.Generator, folder: Path) -> Made:
        plain = make(rng, folder)
        return Made(gzip.compress(plain.data, mtime=0), plain.truth)

    return zipped


# -- devices ------------------------------------------------------------------------------------


def _rows(counts: np.ndarray) -> list[Sample]:
    return [tuple(row) for row in counts.tolist()]


def _cwa(axes: int) -> Callable[[np.random.Generator, Path], Made]:
    def make(rng: np.random.Generator, folder: Path) -> Made:
        wide = axes >> 4
        per_sector = 120 if not axes & 15 else 480 // (2 * wide)
        rows = 20 * per_sector
        ns = _times(100.0, rows)
        series = {}
        if wide == 6:
            turn = rng.integers(-2000, 2000, (rows, 3))
            acc = _counts(rng, rows, 2048.0)
            samples = _rows(np.hstack([turn, acc]))
            scales = 3 << 13 | 2 << 10  # 2^-11 g, 2000 deg/s over 2^15
            series["angular_rate"] = (Series(ns, turn * (2000.0 / 32768.0) * DEG),)
            acc_g = acc / 2048.0
        else:
            counts = _counts(rng, rows, 256.0)
            # Three numbers share an exponent: above 511 the last bit goes.
            samples, scales, acc_g = (
                _rows(np.clip(counts, -511, 511)),
                0,
                np.clip(counts, -511, 511) / 256.0,
            )
        data = ax_file(
            samples, WHEN, rate=100.0, per_sector=per_sector, axes=axes, scales=scales, warm=0
        )
        series["acceleration"] = (Series(ns, acc_g * G),)
        edges = [1024 + 512 * k for k in range((len(data) - 1024) // 512 + 1)]
        return Made(data, Truth(series, 1e-12), edges)

    return make


def _gene(rng: np.random.Generator, folder: Path) -> Made:
    counts = _counts(rng, 2400, 255.0)
    gain, offset = np.array([25522, 25457, 24829]), np.array([272, -1129, 101])
    acc = (counts * 100.0 - offset) / gain * G
    data = gene_file(_rows(counts), WHEN, rate=50.0, zone="+00:00")
    ns = _times(50.0, 2400)
    warm = Series(ns[::300], 20.0 + np.arange(8)[:, None] / 10.0)
    series = {"acceleration": (Series(ns, acc),), "temperature": (warm,)}
    edges = [k for k in range(len(data)) if data.startswith(b"Recorded Data", k)]
    return Made(data, Truth(series, 1e-12), [*edges, len(data)])


def _old_gt3x(rng: np.random.Generator, folder: Path) -> Made:
    counts = _counts(rng, ROWS, 341.0)
    ns = _times(30.0, ROWS)
    truth = Truth({"acceleration": (Series(ns, counts / 341.0 * G),)}, 1e-12)
    return Made(old_gt3x(_rows(counts), WHEN, rate=30), truth)


GT3X_INFO = "Serial Number: X1\nSample Rate: 30\nAcceleration Scale: 256.0\nTimeZone: 00:00:00\n"


def gt3x_archive(log: bytes) -> bytes:
    """An archive around log.bin."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(zipfile.ZipInfo("info.txt"), GT3X_INFO)
        file.writestr(zipfile.ZipInfo("log.bin"), log, zipfile.ZIP_DEFLATED)
    return out.getvalue()


def _gt3x(inside: bool) -> Callable[[np.random.Generator, Path], Made]:
    def make(rng: np.random.Generator, folder: Path) -> Made:
        seconds = 40
        counts = _counts(rng, 30 * seconds, 256.0)
        wide = bool(rng.integers(2))
        log, edges = b"", [0]
        for k, some in enumerate(counts.reshape(seconds, 30, 3)):
            log += gt3x_second(some, START // 10**9 + k, 26 if wide else 0)
            edges.append(len(log))
        ns = _times(30.0, 30 * seconds)
        truth = Truth({"acceleration": (Series(ns, counts / 256.0 * G),)}, 1e-12)
        if inside:
            return Made(log, truth, edges, gt3x_archive)
        return Made(gt3x_archive(log), truth)

    return make


def _flight(
    write: Callable[..., bytes], magic: bytes
) -> Callable[[np.random.Generator, Path], Made]:
    """Two IMUs on stamps since boot."""

    def make(rng: np.random.Generator, folder: Path) -> Made:
        stamps = 5_000_000 + 4000 * np.arange(ROWS // 2)
        acc = np.float32([_poses(rng, ROWS // 2) * G for _ in range(2)])
        gyro = np.float32(rng.normal(scale=0.01, size=acc.shape))
        data = write(stamps, acc, gyro)
        ns = 1000 * stamps
        series = {
            "acceleration": tuple(Series(ns, a.astype(float)) for a in acc),
            "angular_rate": tuple(Series(ns, w.astype(float)) for w in gyro),
            "temperature": tuple(
                Series(ns, 30.0 + k + np.arange(ns.size)[:, None] / 1024) for k in range(2)
            ),
        }
        edges = [k for k in range(len(data)) if data.startswith(magic, k)]
        return Made(data, Truth(series), [*edges, len(data)])

    return make


def _bag(rng: np.random.Generator, folder: Path) -> Made:
    rows, truth = _readings(rng, 2)
    path = folder / "made.bag"
    path.unlink(missing_ok=True)  # its writer refuses to write over another
    ros1_bag(path, {f"/imu{k}/data": r for k, r in enumerate(rows)})
    return Made(path.read_bytes(), truth)


def kinds() -> dict[str, Kind]:
    """Every format by name."""
    lz4, none = CompressionType.LZ4, CompressionType.NONE
    whole = {"enable_data_crcs": True}
    return {
        "mcap cdr zstd": Kind(".mcap", _mcap(sensors=2), "samples", True),
        "mcap cdr lz4": Kind(".mcap", _mcap(compression=lz4), "samples", True),
        "mcap cdr plain": Kind(".mcap", _mcap(compression=none), "samples", True),
        "mcap ros1 zstd": Kind(".mcap", _mcap("ros1"), "samples", True),
        "mcap json lz4": Kind(".mcap", _mcap("json", lz4), "samples", True),
        "mcap protobuf zstd": Kind(".mcap", _mcap("protobuf"), "samples", True),
        "mcap, CRC over all": Kind(".mcap", _mcap(compression=none, **whole), "all", True),
        "mcap, no chunks": Kind(".mcap", _mcap(use_chunking=False), "nothing", True),
        "mcap, no CRC": Kind(".mcap", _mcap(compression=none, enable_crcs=False), "nothing", True),
        "hdf5 fletcher32": Kind(".h5", _hdf5(fletcher32=True), "samples", True),
        "hdf5 gzip fletcher32": Kind(
            ".h5", _hdf5(fletcher32=True, compression="gzip"), "samples", True
        ),
        "hdf5 plain": Kind(".h5", _hdf5(), "nothing", True),
        "csv": Kind(".csv", _euroc, "nothing", False),
        "csv, comma": Kind(".csv", _seconds, "nothing", False),
        **{f"csv, {n}": Kind(".csv", _text_clock(n), "nothing", False) for n in _TEXT_CLOCKS},
        "csv.gz": Kind(".csv.gz", _gzipped(_euroc), "all", True),
        "gt3x": Kind(".gt3x", _gt3x(False), "all", True),
        "gt3x, log.bin": Kind(".gt3x", _gt3x(True), "samples", False),
        "gt3x activity": Kind(".gt3x", _old_gt3x, "all", True),
        "cwa AX3": Kind(".cwa", _cwa(0x30), "samples", False),
        "cwa AX6": Kind(".cwa", _cwa(0x62), "samples", False),
        "cwa.gz": Kind(".cwa.gz", _gzipped(_cwa(0x30)), "all", True),
        "bin": Kind(".bin", _gene, "nothing", True),
        "bin.gz": Kind(".bin.gz", _gzipped(_gene), "all", True),
        "dataflash": Kind(".bin", _flight(dataflash, b"\xa3\x95"), "nothing", False),
        "ulog": Kind(".ulg", _flight(ulog, b"D"), "nothing", False),
        "ros1 bag": Kind(".bag", _bag, "nothing", True),
        "own mcap": Kind(".mcap", _own(".mcap"), "all", True),
        "own hdf5": Kind(".h5", _own(".h5"), "samples", True),
        "own csv": Kind(".csv", _own(".csv"), "all", True),
    }
