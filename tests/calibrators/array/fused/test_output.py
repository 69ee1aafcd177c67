"""`imucal apply` with an array's calibration: files that others read, whatever the format."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from click.testing import CliRunner, Result

from imucalib import cli
from imucalib.calibration.file import write
from imucalib.calibrators.array.fused.recording import determined
from imucalib.errors import ImucalError
from imucalib.readers import read
from imucalib.writers import write as write_recording
from worlds.rigid_board import Moves, board, calibration, moves, readings, recording


@dataclass(frozen=True)
class Files:
    folder: Path
    moves: Moves

    def apply(self, target: str, *options: object, source: str = "log.h5") -> Result:
        given = [self.folder / "c.yaml", self.folder / source, "-o", self.folder / target]
        arguments = ["apply", *map(str, given), "--force", *map(str, options)]
        result = CliRunner().invoke(cli.cli, arguments, standalone_mode=False)
        if isinstance(result.exception, ImucalError):
            result.return_value = result.exception.exit_code
        return result


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    rng = np.random.default_rng(8)
    made = board(rng, chips=4, late=1e-3)
    motion = moves(rng, still=8.0, moving=8.0, hz=100.0, twist=150.0, late=1e-3, fastest=2.0)
    folder = tmp_path_factory.mktemp("fused")
    log = recording(made, motion.t, *readings(made, motion, rng))
    write(calibration(made), folder / "c.yaml")
    for name in ("log.h5", "log.mcap", "log.csv"):
        write_recording(log, folder / name)
    return Files(folder, motion)


@pytest.mark.slow
def test_hdf5_holds_the_nine_and_their_covariances(files: Files) -> None:
    result = files.apply("fused.h5", "--fused", "--json")
    assert result.return_value == 0, result.exception
    notes = json.loads(result.stdout)["notes"]
    assert any("rest in this recording" in text for text in notes)
    assert any("mm of the board's frame" in text for text in notes)
    with h5py.File(files.folder / "fused.h5") as file:
        assert set(file) == {"fused"}
        rate = file["fused/angular_rate/values"][:]
        covariance = file["fused/angular_rate_covariance/values"][:].reshape(-1, 3, 3)
        assert file["fused/angular_acceleration/values"].attrs["units"] == b"rad/s2"
        assert np.array_equal(file["fused/acceleration/time"][:], files.moves.t)
    off = rate - files.moves.rate
    each = np.einsum("ti,tij,tj->t", off, np.linalg.inv(covariance), off)
    assert 0.9 < each.mean() / 3.0 < 1.1


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["h5", "csv", "mcap"])
def test_every_format_and_source_gives_the_same(files: Files, suffix: str) -> None:
    assert files.apply("one.h5", "--fused", "-q").return_value == 0
    assert files.apply(f"two.{suffix}", "-q", source=f"log.{suffix}").return_value == 0
    one, two = read(files.folder / "one.h5"), read(files.folder / f"two.{suffix}")
    assert set(one.channels) == {"fused/acceleration", "fused/angular_rate"}
    assert set(two.channels) == set(one.channels) | {
        f"imu{k}/{what}" for k in range(4) for what in ("acceleration", "angular_rate")
    }
    for name, channel in one.channels.items():
        assert np.allclose(two.channels[name].values, channel.values, atol=1e-6), name


@pytest.mark.slow
def test_ros_reads_the_covariances(files: Files) -> None:
    rosbags = pytest.importorskip("rosbags.highlevel")
    stores = pytest.importorskip("rosbags.typesys")
    assert files.apply("fused.mcap", "--fused", "-q").return_value == 0
    assert files.apply("fused.h5", "--fused", "-q").return_value == 0
    store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
    imu: list[Any] = []
    accel: list[Any] = []
    with rosbags.AnyReader([files.folder / "fused.mcap"], default_typestore=store) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            (imu if connection.topic == "/fused/imu" else accel).append(message)
    assert types == {
        "/fused/imu": "sensor_msgs/msg/Imu",
        "/fused/accel": "geometry_msgs/msg/AccelWithCovarianceStamped",
    }
    with h5py.File(files.folder / "fused.h5") as file:
        stored = {name: node["values"][:] for name, node in file["fused"].items()}
    assert len(imu) == len(accel) == len(files.moves.t)
    for row in (0, 700, 1500):
        one, two = imu[row], accel[row]
        v = one.angular_velocity
        assert [v.x, v.y, v.z] == pytest.approx(stored["angular_rate"][row], abs=1e-12)
        assert one.orientation_covariance[0] == -1.0
        for own, name in (
            (one.angular_velocity_covariance, "angular_rate_covariance"),
            (one.linear_acceleration_covariance, "acceleration_covariance"),
        ):
            assert own == pytest.approx(stored[name][row], rel=1e-9)
        spin, pull = two.accel.accel.angular, two.accel.accel.linear
        assert [spin.x, spin.y, spin.z] == pytest.approx(stored["angular_acceleration"][row])
        assert [pull.x, pull.y, pull.z] == pytest.approx(stored["acceleration"][row])
        whole = np.array(two.accel.covariance).reshape(6, 6)
        inner = stored["angular_acceleration_covariance"][row].reshape(3, 3)
        assert whole[3:, 3:] == pytest.approx(inner)
        stamp = one.header.stamp.sec + 1e-9 * one.header.stamp.nanosec
        assert stamp == pytest.approx(files.moves.t[row], abs=1e-8)


@pytest.mark.parametrize(
    "options", [("--at", "1,2"), ("--at", "x,y,z"), ("--no-fused", "--at", "0,0,0"),
                ("--fused", "--triad", "imu0")],
)  # fmt: skip
def test_options_that_make_no_sense_are_refused(files: Files, options: tuple[str, ...]) -> None:
    result = files.apply("none.h5", *options)
    assert getattr(result.exception, "exit_code", None) == 2
    assert not (files.folder / "none.h5").exists()


def test_a_log_without_gyros_is_corrected_and_says_why_not_fused(files: Files) -> None:
    log = read(files.folder / "log.h5")
    channels = {n: c for n, c in log.channels.items() if c.quantity == "acceleration"}
    write_recording(type(log)(channels, log.path, log.format, ""), files.folder / "acc.h5")
    result = files.apply("acc_only.h5", source="acc.h5")
    assert result.return_value == 0
    assert "not fused" in result.stderr
    assert files.apply("acc_only.h5", "--fused", source="acc.h5").return_value == 3


def test_a_sample_that_nothing_determines_is_left_out() -> None:
    covariance = np.tile(np.diag([0.01] * 3 + [1e6] * 3 + [1e-4] * 3), (4, 1, 1))
    covariance[1, 1, 1] = 700.0**2  # m/s²: most readings clip
    covariance[2, 8, 8] = 20.0**2  # rad/s
    assert determined(covariance).tolist() == [True, False, False, True]
