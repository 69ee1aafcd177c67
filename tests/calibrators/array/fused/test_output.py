"""`imucal apply` with an array's calibration: files that others read, whatever the format."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

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
