"""ROS bags for the tests, written with the package rosbags."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from imucalib.recording.recording import Recording
from worlds.mcap_logs import Reading, cdr, ros1

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
IMU = "sensor_msgs/msg/Imu"


def ros1_bag(
    path: Path, topics: dict[str, list[Reading]], *, packed: bool = False, delay: int = 1000
) -> Path:
    """A ROS 1 bag of sensor_msgs/Imu topics."""
    bag = rosbag1.Writer(path)
    if packed:
        bag.set_compression(rosbag1.Writer.CompressionFormat.LZ4)
    return _filled(bag, path, topics, ROS1, ros1, delay)


def ros2_bag(
    path: Path, topics: dict[str, list[Reading]], *, delay: int = 1000, mode: str = ""
) -> Path:
    """The folder of a ROS 2 bag; its database is `path / f"{path.name}.db3"`."""
    bag = rosbag2.Writer(path, version=9)
    if mode:
        bag.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
    return _filled(bag, path, topics, ROS2, cdr, delay)


def _filled(
    bag: rosbag1.Writer | rosbag2.Writer, path: Path, topics: dict[str, list[Reading]],
    store: Typestore, pack: Callable[[Reading], bytes], delay: int,
) -> Path:  # fmt: skip
    with bag:
        joined = {t: bag.add_connection(t, IMU, typestore=store) for t in topics}
        rows = [(r.ns + delay, t, r) for t, readings in topics.items() for r in readings]
        for ns, topic, reading in sorted(rows, key=lambda row: row[:2]):
            bag.write(joined[topic], ns, pack(reading))
    return path


def _topics(recording: Recording) -> dict[str, list[Reading]]:
    """A recording's triads with their gyroscopes as readings."""
    topics = {}
    for name, channel in recording.channels.items():
        if channel.quantity != "acceleration":
            continue
        rate = recording.channels[name.replace("acceleration", "angular_rate")].values
        ns = (recording.start_ns or 0) + np.rint(channel.t * 1e9).astype(np.int64)
        columns = zip(ns.tolist(), channel.values.tolist(), rate.tolist(), strict=True)
        topics[f"/{channel.triad}/data"] = [Reading(t, tuple(a), tuple(w)) for t, a, w in columns]
    return topics


@dataclass(frozen=True)
class BagWriter:
    """Writes a recording's triads as a bag; for tests only, so that bags obey the laws too."""

    suffixes: tuple[str, ...]
    name: str = "rosbag"

    def write_blocks(self, blocks: Iterable[Recording], path: Path) -> None:
        """Write `path` anew."""
        (recording,) = blocks
        path.unlink(missing_ok=True)
        if self.suffixes == (".bag",):
            ros1_bag(path, _topics(recording))
            return
        folder = path.with_name(f"{path.stem}_folder")
        ros2_bag(folder, _topics(recording))
        (folder / f"{folder.name}.db3").rename(path)
        shutil.rmtree(folder)
