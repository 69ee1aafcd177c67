"""header.frame_id is a second name of a topic's sensor, whatever holds the messages."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from imucalib import readers
from imucalib.readers.joining import join
from imucalib.recording.pairing import channel_names, paired
from worlds.bag_logs import ros1_bag, ros2_bag
from worlds.mcap_logs import IMU_ROS1, Reading, cdr, packed, readings, ros1, write_log

#: Topics whose words do not tell one from another.
TOPICS = ("/imu/1/data", "/imu/2/data")
Topics = dict[str, list[Reading]]


def _cdr(path: Path, topics: Topics) -> Path:
    return write_log(path / "a.mcap", {t: packed(rows, cdr) for t, rows in topics.items()})


def _ros1(path: Path, topics: Topics) -> Path:
    schema = ("sensor_msgs/Imu", "ros1msg", IMU_ROS1.encode())
    rows = {t: packed(rows, ros1) for t, rows in topics.items()}
    return write_log(path / "a.mcap", rows, schema=schema, encoding="ros1")


def _json(path: Path, topics: Topics) -> Path:
    def pack(r: Reading) -> bytes:
        stamp = {"sec": r.ns // 10**9, "nanosec": r.ns % 10**9}
        header = {"stamp": stamp, "frame_id": r.frame}
        return json.dumps({"header": header, "acc": list(r.acc), "gyro": list(r.gyro)}).encode()

    rows = {t: packed(rows, pack) for t, rows in topics.items()}
    schema = ("Imu", "jsonschema", b"{}")
    return write_log(path / "a.mcap", rows, schema=schema, encoding="json")


WRITE: dict[str, Callable[[Path, Topics], Path]] = {
    "mcap cdr": _cdr,
    "mcap ros1": _ros1,
    "mcap json": _json,
    "ros1 bag": lambda path, topics: ros1_bag(path / "a.bag", topics),
    "ros2 bag": lambda path, topics: ros2_bag(path / "a", topics),
}


def _logged(frames: tuple[str, str]) -> Topics:
    return {t: readings(400, k, 200.0, frames[k]) for k, t in enumerate(TOPICS)}


@pytest.mark.parametrize("name", WRITE)
def test_a_frame_is_paired_as_a_topic_is(name: str, tmp_path: Path) -> None:
    """Names in another order than the topics', so that pairing in order would be wrong."""
    path = WRITE[name](tmp_path, _logged(("body/right_link", "body/left_link")))
    for recording in (readers.read(path), join(readers.blocks(path, block_samples=100), "")):
        for wanted in ([("left_link",), ("right_link",)], [("body/left_link",), ("right_link",)]):
            assert paired(wanted, recording, "the board").partner == {"imu0": 1, "imu1": 0}
        # What a calibration keeps is the topic: only that is one in every file.
        assert channel_names(recording) == dict(zip(("imu0", "imu1"), TOPICS, strict=True))
