"""CPU seconds and peak memory of reading IMU logs from MCAP, beside other readers.

    python benchmarks/readers/logs.py [--folder DIR] [--single SECONDS] [--array SECONDS]
                                   [--long SECONDS]

Two logs are generated (one IMU, and 32 IMUs, 1 kHz, sensor_msgs/Imu, zstd, values quantised like
a sensor's). Every reader turns them into arrays of stamps, acceleration and angular rate, each in
a process of its own; readers that are not installed are left out.
"""

from __future__ import annotations

import argparse
import resource
import struct
import subprocess
import sys
import time
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

BARS = {
    "single": (600.0, 0.5, None),
    "array": (600.0, 15.0, 1.5e9),
    "long array": (600.0, 15.0, 1.5e9),
}
MODULES = {
    "imucal": "zstandard",
    "imucal-blocks": "zstandard",
    "mcap-ros2-support": "mcap_ros2.decoder",
    "rosbags": "rosbags.highlevel",
    "pybag-sdk": "pybag.mcap_reader",
}
READERS = {
    "imucal": "imucalib",
    "imucal-blocks": "imucalib",
    "mcap-ros2-support": "mcap-ros2-support",
    "rosbags": "rosbags",
    "pybag-sdk": "pybag-sdk",
}


def generate(path: Path, imus: int, seconds: float) -> int:
    """Write a log with the official writer, so that no reader gets a layout made for it."""
    from mcap.writer import Writer

    from imucalib.readers.messages.layout import IMU_ROS2

    rng = np.random.default_rng(1)
    count, start = round(seconds * 1000), 1_700_000_000_000_000_000
    text = IMU_ROS2.replace("===\n", "=" * 80 + "\n")
    text += "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", text.encode())
        heads, channels = [], []
        for i in range(imus):
            channels.append(writer.register_channel(f"/imu{i}/data", "cdr", schema))
            head = struct.pack("<I", len(f"imu{i}") + 1) + f"imu{i}\0".encode()
            heads.append(head + b"\0" * (-(8 + len(head)) % 8))
        body = np.zeros(37)
        for k in range(count):
            at = start + k * 1_000_000
            signal = rng.normal((0, 0, 0, 0, 0, 9.81), 0.02, (imus, 6))
            signal = np.round(signal / 0.0012) * 0.0012
            for i, channel in enumerate(channels):
                body[13:16], body[25:28] = signal[i, :3], signal[i, 3:]
                stamp = struct.pack("<4BiI", 0, 1, 0, 0, at // 10**9, at % 10**9)
                data = stamp + heads[i] + body.tobytes()
                writer.add_message(channel, at + 50_000, data, at + 50_000, k)
        writer.finish()
    return count * imus


def read_with(reader: str, path: Path) -> int:
    """Read all IMU messages into arrays; returns how many there were."""
    if reader.startswith("imucal"):
        return _imucal(path, reader.endswith("blocks"))
    rows: dict[str, list[tuple[float, ...]]] = {}
    for topic, message in _messages(reader, path):
        stamp, a, w = message.header.stamp, message.linear_acceleration, message.angular_velocity
        row = (stamp.sec, stamp.nanosec, a.x, a.y, a.z, w.x, w.y, w.z)
        rows.setdefault(topic, []).append(row)
    arrays = {topic: np.array(part) for topic, part in rows.items()}
    return sum(len(array) for array in arrays.values())


def _imucal(path: Path, piecewise: bool) -> int:
    from imucalib.readers import blocks, read

    found = blocks(path) if piecewise else [read(path)]
    return sum(
        channel.t.size
        for recording in found
        for channel in recording.channels.values()
        if channel.quantity == "acceleration"
    )


def _messages(reader: str, path: Path):  # type: ignore[no-untyped-def]
    if reader == "mcap-ros2-support":
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory

        with path.open("rb") as file:
            source = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, channel, _, message in source.iter_decoded_messages(log_time_order=False):
                yield channel.topic, message
    elif reader == "rosbags":
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as source:
            for connection, _, data in source.messages():
                yield connection.topic, source.deserialize(data, connection.msgtype)
    else:
        from pybag.mcap_reader import McapFileReader

        with McapFileReader.from_file(path) as source:
            for topic in source.get_topics():
                for message in source.messages(topic):
                    yield topic, message.data


class Cost(NamedTuple):
    """What one reader took; CPU seconds of reading and of importing, peak in bytes."""

    messages: int
    cpu: float
    imports: float
    idle: float
    peak: float


def measure(reader: str, path: Path) -> Cost | None:
    """The cost of one reader in its own process, None when it is not installed or fails."""
    try:
        version(READERS[reader])
    except PackageNotFoundError:
        return None
    command = [sys.executable, __file__, "--reader", reader, str(path)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        print(f"  {reader}: failed: {done.stderr.strip().splitlines()[-1][:120]}")
        return None
    count, *costs = done.stdout.split()
    return Cost(int(count), *map(float, costs))


def one(reader: str, path: Path) -> None:
    """The measured process: prints the fields of `Cost`."""
    import_module(MODULES[reader])
    if reader.startswith("imucal"):
        import_module("imucalib.readers").readers()
    before, idle = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    count = read_with(reader, path)
    cpu, peak = time.process_time() - before, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(count, cpu, before, idle * 1024, peak * 1024)


def compare(
    name: str, imus: int, seconds: float, folder: Path, readers: tuple[str, ...] = tuple(READERS)
) -> None:
    """Measure readers on one log, and hold imucal against its bar."""
    path = folder / f"{name.replace(' ', '_')}.mcap"
    count = generate(path, imus, seconds)
    size = path.stat().st_size
    print(f"{name}: {imus} IMU, {seconds:g} s at 1 kHz, {count} messages, {size / 1e6:.0f} MB")
    for reader in readers:
        package = READERS[reader]
        cost = measure(reader, path)
        if cost is None:
            continue
        assert cost.messages == count, f"{reader} read {cost.messages} of {count} messages"
        line = (
            f"  {reader:18} {version(package):8} {cost.cpu:7.2f} CPU s (imports {cost.imports:.2f})"
        )
        print(f"{line} {cost.peak / 1e6:6.0f} MB {count / cost.cpu / 1e3:7.0f} k messages / CPU s")
        if reader == "imucal":
            print(_bar(name, seconds, cost))


def _bar(name: str, seconds: float, cost: Cost) -> str:
    """The figures for the length of recording that the bar is set for."""
    full, most_cpu, most_peak = BARS[name]
    scale = full / seconds
    text = f"    {full:g} s" + ("" if scale == 1.0 else ", extrapolated")
    text += f": {cost.cpu * scale:.2f} of at most {most_cpu:g} CPU s"
    if most_peak:
        whole = cost.idle + (cost.peak - cost.idle) * scale
        text += f", {whole / 1e9:.2f} of at most {most_peak / 1e9:g} GB"
    return text


def main() -> None:
    """Parse the options and run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, help="keep the logs here (a temporary one if unset)")
    parser.add_argument("--single", type=float, default=600.0, help="seconds of the 1-IMU log")
    parser.add_argument("--array", type=float, default=60.0, help="seconds of the 32-IMU log")
    parser.add_argument(
        "--long", type=float, default=0.0, help="seconds of a 32-IMU log that only imucal reads"
    )
    parser.add_argument("--reader", choices=READERS, help=argparse.SUPPRESS)
    parser.add_argument("path", nargs="?", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.reader:
        one(options.reader, options.path)
        return
    with TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        compare("single", 1, options.single, folder)
        compare("array", 32, options.array, folder)
        if options.long:
            compare("long array", 32, options.long, folder, ("imucal", "imucal-blocks"))


if __name__ == "__main__":
    main()
