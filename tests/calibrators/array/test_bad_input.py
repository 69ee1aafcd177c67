"""What `imucal array` says of recordings that cannot give positions; never a wrong answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.array.board import read_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.run import ArrayRun
from imucalib.calibrators.array.simulation import LogPlan, simulated_log
from imucalib.errors import ImucalError, Undetermined, UnreadableInput
from imucalib.recording.recording import Channel, Recording
from imucalib.units import DEG

BOARD = read_board("mimu4444_corners")
PLAN = LogPlan(poses=14, pose_seconds=3.0, seconds=20.0, gyro_gain=0.0)
Change = Callable[[str, Channel], Channel]


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulated_log(BOARD, PLAN, np.random.default_rng(0)).recording


def calibrate(recording: Recording) -> ArrayRun:
    request = ArrayRequest(BOARD, samples=100, loop=False)
    return calibrate_array(recording, request, lambda _: None)


def changed(recording: Recording, change: Change) -> Recording:
    channels = {name: change(name, c) for name, c in recording.channels.items()}
    return replace(recording, channels=channels)


def scaled(part: str, factor: float) -> Change:
    """Channels whose name ends with `part` in a unit that nobody said."""
    return lambda name, c: replace(c, values=c.values * factor) if name.endswith(part) else c


def slower(part: str) -> Change:
    def change(name: str, c: Channel) -> Channel:
        if not name.endswith(part):
            return c
        return Channel(c.t[::2], c.values[::2], c.unit, c.quantity, c.triad, 50.0)

    return change


def later(part: str, seconds: float) -> Change:
    return lambda name, c: replace(c, t=c.t + seconds) if name.endswith(part) else c


def held(part: str, axis: int, value: float) -> Change:
    def change(name: str, c: Channel) -> Channel:
        return replace(c, values=np.where(np.arange(3) == axis, value, c.values)) if (
            name.endswith(part)
        ) else c  # fmt: skip

    return change


@pytest.mark.parametrize(
    ("change", "kind", "message", "remedy"),
    [
        (scaled("/acceleration", 1 / 9.80665), Undetermined, "0.1 times gravity", "unit"),
        (scaled("imu3/acceleration", 0.1), Undetermined, "imu3 reads 0.098 times", "unit"),
        (scaled("/acceleration", 1e3), Undetermined, r"1e\+03 times gravity", "unit"),
        (scaled("/angular_rate", 1 / DEG), Undetermined, "too little rotation", "gyros' unit"),
        (scaled("/angular_rate", DEG), Undetermined, "too little rotation", "gyros' unit"),
        (scaled("imu3/angular_rate", 1 / DEG), Undetermined, "gyro of imu3 reads 57 times", "unit"),
        (scaled("imu3/angular_rate", DEG), Undetermined, "gyro of imu3 reads 0.017", "57.3"),
        (slower("imu2/acceleration"), UnreadableInput, "different rates, 50 to 100 Hz", "one rate"),
        (slower("imu0/angular_rate"), UnreadableInput, "different rates, 50 to 100 Hz", "one rate"),
        (later("imu2/acceleration", 0.005), UnreadableInput, "within 3 ms", "common clock"),
        (later("imu2/angular_rate", 1e3), UnreadableInput, "only 0 % of the samples", "clock"),
        (held("imu5/acceleration", 2, 0.0), UnreadableInput, "axis z never changes", "dead"),
        (held("imu5/angular_rate", 0, 0.3), UnreadableInput, "axis x never changes", "dead"),
    ],
)
def test_a_fault_is_named(
    recording: Recording, change: Change, kind: type[ImucalError], message: str, remedy: str
) -> None:
    with pytest.raises(kind, match=message) as caught:
        calibrate(changed(recording, change))
    assert remedy in (caught.value.remedy or "")


@pytest.mark.parametrize("gone", ["imu4/acceleration", "imu4/angular_rate"])
def test_a_missing_sensor_is_named(recording: Recording, gone: str) -> None:
    left = {name: c for name, c in recording.channels.items() if name != gone}
    with pytest.raises(UnreadableInput, match="imu4") as caught:
        calibrate(replace(recording, channels=left))
    assert "--gyro" in (caught.value.remedy or "")


def test_exchanged_topics_are_noticed(recording: Recording) -> None:
    """Two IMUs of opposite sides under each other's name."""
    other = {"imu2": "imu5", "imu5": "imu2"}

    def change(name: str, c: Channel) -> Channel:
        if c.triad not in other:
            return c
        return replace(recording.channels[f"{other[c.triad]}/{c.quantity}"], triad=c.triad)

    with pytest.raises(Undetermined, match=r"imu2 and imu5 are exchanged"):
        calibrate(changed(recording, change))


def test_a_board_of_a_hostile_name_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "board.yaml"
    lines = ['imus:', '  - {name: "a */ int x;", position: [0, 0, 0], axes: "x,y,z"}',
             '  - {name: b, position: [9, 0, 0], axes: "x,y,z"}']  # fmt: skip
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(UnreadableInput, match="';'"):
        read_board(path)
