"""An array's calibration applied: every IMU reads the same force and rate, and the rest is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibration.apply import apply_to_recording
from imucalib.calibration.file import read, to_yaml, write_whole
from imucalib.calibration.triads import DRIFT, drift_block
from imucalib.calibrators.array.board.board import read_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.run import ArrayRun
from imucalib.calibrators.array.simulation import LogPlan, SimulatedLog, simulate_log
from imucalib.errors import Undetermined, UnreadableInput
from imucalib.recording.recording import Recording
from imucalib.units import DEG, STANDARD_GRAVITY

BOARD = read_board("mimu4444_corners")
QUADRATIC = 5e-4  # 1 per m/s²


@pytest.fixture(scope="module")
def log() -> SimulatedLog:
    planted = {"quadratic": QUADRATIC}  # no reading of this motion reaches its range
    plan = LogPlan(poses=14, pose_seconds=3.0, seconds=25.0, twist=450.0, planted=planted)
    return simulate_log(BOARD, plan, np.random.default_rng(3))


@pytest.fixture(scope="module")
def run(log: SimulatedLog) -> ArrayRun:
    asked = {"declare": ("gyro_scale", "gyro_misalignment", "quadratic"), "only": ("gyro_delay",)}
    request = ArrayRequest(board=BOARD, samples=150, loop=False, **asked)
    return calibrate_array(log.recording, request, lambda _: None)


def spread(recording: Recording, quantity: str, rows: slice) -> float:
    """rms over the IMUs of what one reads beside their mean; vectors in board axes."""
    values = np.array([recording.channels[f"{imu}/{quantity}"].values[rows] for imu in BOARD.imus])
    return float(np.sqrt(np.mean((values - values.mean(axis=0)) ** 2)))


@pytest.mark.slow
def test_all_imus_read_the_same_force_and_rate(log: SimulatedLog, run: ArrayRun) -> None:
    found = apply_to_recording(run.calibration, log.recording)
    rest, motion = slice(0, 14 * 300 - 50), slice(14 * 300 + 100, None)
    still = np.linalg.norm(found.channels["imu4/acceleration"].values[rest], axis=1)
    assert abs(still.mean() - STANDARD_GRAVITY) < 5e-3
    assert spread(found, "acceleration", rest) < 1.2 * 0.04
    # The planted gains are 1 % of about 450 deg/s, and the noise 0.2.
    assert spread(found, "angular_rate", motion) < 1.5 * 0.2 * DEG
    turned = {
        name: replace(c, values=c.values @ BOARD.rotations[BOARD.imus.index(c.triad)].T)
        for name, c in log.recording.channels.items()
    }
    before = replace(log.recording, channels=turned)
    assert spread(before, "angular_rate", motion) > 10 * spread(found, "angular_rate", motion)
    assert spread(before, "acceleration", rest) > 3 * spread(found, "acceleration", rest)


def _called(recording: Recording, names: dict[str, str]) -> Recording:
    channels = {
        f"{names[c.triad]}/{c.quantity}": replace(c, triad=names[c.triad])
        for c in recording.channels.values()
    }
    return replace(recording, channels=channels)


@pytest.mark.parametrize("one", range(8))
def test_readings_under_each_others_names_are_refused(
    log: SimulatedLog, run: ArrayRun, one: int
) -> None:
    """Gravity at rest tells any two sensors apart, even two that are mounted alike."""
    for two in range(one):
        names = {imu: imu for imu in BOARD.imus}
        names |= {f"imu{one}": f"imu{two}", f"imu{two}": f"imu{one}"}
        with pytest.raises(Undetermined) as error:
            apply_to_recording(run.calibration, _called(log.recording, names))
        assert f"imu{one} is imu{two}, not imu{one}" in error.value.remedy
        assert f"imu{two} is imu{one}, not imu{two}" in error.value.remedy


def test_a_sensor_of_other_axes_is_refused(log: SimulatedLog, run: ArrayRun) -> None:
    channels = dict(log.recording.channels)
    channels["imu3/acceleration"] = replace(
        channels["imu3/acceleration"], values=-channels["imu3/acceleration"].values
    )
    with pytest.raises(Undetermined, match="imu3 disagrees"):
        apply_to_recording(run.calibration, replace(log.recording, channels=channels))


def test_the_drift_of_the_rests_is_undone_in_the_recording_that_was_calibrated(
    log: SimulatedLog, run: ArrayRun, tmp_path: Path
) -> None:
    """In a later one it is not there any more, and is said to be not undone."""
    t = np.array([2.0, 20.0, 40.0])
    offset = 0.05 * np.random.default_rng(0).normal(size=(3, 8, 3))
    offset[-1] = 0.0
    facts = dict(run.calibration.facts)
    facts["rests"] = {**facts["rests"], "drift": drift_block(t, offset)}
    facts["not_undone"] = [{"effect": DRIFT, "rms": 0.05, "unit": "m/s²"}]
    write_whole(tmp_path / "c.yaml", to_yaml(replace(run.calibration, facts=facts)))
    found = read(tmp_path / "c.yaml")
    source = replace(log.recording, sha256=facts["provenance"]["sha256"])
    drifted = {
        name: replace(
            c,
            values=c.values
            + np.stack(
                [np.interp(c.t, t, offset[:, BOARD.imus.index(c.triad), k]) for k in range(3)], 1
            ),
        )
        if c.quantity == "acceleration"
        else c
        for name, c in source.channels.items()
    }
    same = apply_to_recording(found, replace(source, channels=drifted))
    want = apply_to_recording(run.calibration, log.recording)
    for name, channel in want.channels.items():
        assert np.allclose(same.channels[name].values, channel.values, atol=1e-6)
    assert not any("not undone: drift" in note for note in same.notes)
    later = apply_to_recording(found, replace(source, sha256="another"))
    assert np.array_equal(
        later.channels["imu0/acceleration"].values, want.channels["imu0/acceleration"].values
    )
    assert any("not undone: drift" in note for note in later.notes)


def test_one_imu_alone_and_other_names(log: SimulatedLog, run: ArrayRun) -> None:
    alone = apply_to_recording(run.calibration, log.recording, "imu2")
    whole = apply_to_recording(run.calibration, log.recording)
    for name, channel in log.recording.channels.items():
        want = whole.channels[name] if channel.triad == "imu2" else channel
        assert np.array_equal(alone.channels[name].values, want.values)
    renamed = {
        f"s{name}": replace(c, triad=f"s{c.triad}") for name, c in log.recording.channels.items()
    }
    by_order = apply_to_recording(run.calibration, replace(log.recording, channels=renamed))
    assert np.array_equal(
        by_order.channels["simu5/acceleration"].values, whole.channels["imu5/acceleration"].values
    )
    some = dict(list(renamed.items())[:6])
    with pytest.raises(UnreadableInput, match="no name fits"):
        apply_to_recording(run.calibration, replace(log.recording, channels=some))
