"""ROS bags corrected into MCAP: topics, frames and all other topics stay, as of an MCAP file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from ruamel.yaml import YAML

from imucalib.calibration.apply import write_over
from imucalib.readers import read
from worlds.bag_logs import IMU, ROS1, ROS2
from worlds.mcap_logs import START, cdr, readings, ros1

NAME, TEXT = "std_msgs/msg/String", b"\x00\x01\x00\x00\x03\x00\x00\x00ab\x00"
TIME = QosTime(0, 0)
LATCHED = Qos(
    QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, TIME, TIME,
    QosLiveliness.AUTOMATIC, TIME, avoid_ros_namespace_conventions=False,
)  # fmt: skip


def old(folder: Path) -> Path:
    return filled(rosbag1.Writer(folder / "a.bag"), folder / "a.bag", ros1, TEXT[4:8] + b"ab\x00")


def new(folder: Path, storage: str = "SQLITE3", packing: str = "") -> Path:
    kind = rosbag2.StoragePlugin[storage]
    bag = rosbag2.Writer(folder / "bag", version=9, storage_plugin=kind)
    if packing:
        bag.set_compression(rosbag2.CompressionMode[packing], rosbag2.CompressionFormat.ZSTD)
    return filled(bag, folder / "bag", cdr, TEXT)


def database(folder: Path) -> Path:
    return next(new(folder).glob("*.db3"))


def filled(bag: Any, path: Path, pack: Callable[..., bytes], text: bytes) -> Path:
    with bag:
        store = ROS1 if path.suffix == ".bag" else ROS2
        imu = bag.add_connection("/front/imu", IMU, typestore=store)
        own = {"latching": 1} if path.suffix == ".bag" else {"offered_qos_profiles": [LATCHED]}
        name = bag.add_connection("/names", NAME, typestore=store, **own)
        for k, reading in enumerate(readings(400, frame="front_link")):
            bag.write(imu, reading.ns + 1000, pack(reading))
            if k % 50 == 0:
                bag.write(name, START + 1_000_000 * k + 2000, text)
    return path


BAGS: dict[str, Callable[[Path], Path]] = {
    "bag": old,
    "folder": new,
    "db3": database,
    "folder of mcap": lambda folder: new(folder, "MCAP"),
    "messages packed": lambda folder: new(folder, packing="MESSAGE"),
    "files packed": lambda folder: new(folder, packing="FILE"),
}


@pytest.mark.parametrize("kind", BAGS)
def test_all_but_the_vectors_stays(kind: str, tmp_path: Path) -> None:
    source = BAGS[kind](tmp_path)
    whole = read(source)
    channels = {n: replace(c, values=c.values * 1.5) for n, c in whole.channels.items()}
    write_over(replace(whole, channels=channels), source, tmp_path / "c.mcap")
    with (tmp_path / "c.mcap").open("rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages())
    pack, text = (ros1, TEXT[4:8] + b"ab\x00") if kind == "bag" else (cdr, TEXT)
    named = [(m.log_time, m.data) for _, c, m in found if c.topic == "/names"]
    assert named == [(START + 50_000_000 * k + 2000, text) for k in range(8)]
    imu = [(m.log_time, m.data) for _, c, m in found if c.topic == "/front/imu"]
    assert len(imu) + len(named) == len(found)
    for (time, data), reading in zip(imu, readings(400, frame="front_link"), strict=True):
        more = {
            "acc": tuple(1.5 * v for v in reading.acc),
            "gyro": tuple(1.5 * v for v in reading.gyro),
        }
        assert (time, data) == (reading.ns + 1000, pack(replace(reading, **more)))
    offered = next(c.metadata for _, c, _ in found if c.topic == "/names")
    if kind == "bag":
        assert offered == {"latching": "1"}
    else:
        (profile,) = YAML(typ="safe").load(offered["offered_qos_profiles"])
        assert profile["durability"] in (1, "transient_local")
    schemas = {s.name: s.encoding for s, _, _ in found if s}
    middle = "" if kind == "bag" else "msg/"
    encoding = "ros1msg" if kind == "bag" else "ros2msg"
    assert schemas == {f"sensor_msgs/{middle}Imu": encoding, f"std_msgs/{middle}String": encoding}
    assert read(tmp_path / "c.mcap").channels.keys() == whole.channels.keys()
