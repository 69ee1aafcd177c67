"""Angles with their sd: against draws of parameters and noise through the correction itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from imucalib import cli
from imucalib.calibration.angles import angles_at_rests, angles_of_samples
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import read as read_calibration
from imucalib.readers import read
from imucalib.rests.segments import still_segments
from imucalib.units import MG
from worlds.places import SAMPLES


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    out = tmp_path_factory.mktemp("lab")
    arguments = ["lab", str(SAMPLES / "positions.csv"), "--recording", str(SAMPLES / "rests.mcap"),
                 "-o", str(out), "--no-loop", "-q"]  # fmt: skip
    CliRunner().invoke(cli.cli, arguments, standalone_mode=False)
    return read_calibration(out / "calibration.yaml")


def drawn(calibration: Calibration, rng: np.random.Generator) -> Calibration:
    """The same with parameters drawn from its covariance."""
    theta = rng.multivariate_normal([p.value for p in calibration.parameters],
                                    calibration.covariance)  # fmt: skip
    named = zip(calibration.parameters, theta, strict=True)
    return replace(calibration, parameters=tuple(replace(p, value=float(v)) for p, v in named))


def angles(force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Paper 004's formulae (1) and (2), written a second time, deg."""
    x, y, z = force.T
    return np.degrees(np.arctan(z / np.sqrt(x**2 + y**2))), np.degrees(np.arctan2(x, y)) % 360


def test_sds_are_those_of_drawn_parameters_and_noise(calibration: Calibration) -> None:
    recording = read(SAMPLES / "rests.mcap")
    rests = still_segments(recording)
    raw = recording.channels["imu0/acceleration"].values
    found = angles_at_rests(calibration, calibration.apply(raw), rests, 0)
    reading = np.array([raw[a:b].mean(axis=0) for a, b in zip(rests.first[:, 0], rests.last[:, 0],
                                                              strict=True)])  # fmt: skip
    i, t = angles(calibration.apply(reading))
    np.testing.assert_allclose(np.degrees(found.inclination), i, atol=2e-4)
    flat = np.cos(found.inclination) > 0.1
    away = (np.degrees(found.tool_face) - t + 180.0) % 360.0 - 180.0
    assert np.abs(away[flat]).max() < 2e-4
    rng = np.random.default_rng(0)
    own, both = [], []
    size = calibration.facts["noise"]["reading_mg"] * MG
    for _ in range(400):
        other = drawn(calibration, rng)
        own.append(angles(other.apply(reading)))
        noise = rng.normal(0.0, size, reading.shape)
        noise += rng.standard_normal(reading.shape) * rests.noise[0] / np.sqrt(rests.samples)
        both.append(angles(other.apply(reading + noise)))
    for k, (part, whole) in enumerate((
        (found.inclination_calibration_sd, found.inclination_sd),
        (found.tool_face_calibration_sd, found.tool_face_sd),
    )):  # fmt: skip
        for made, stated in ((own, part), (both, whole)):
            values = np.array([m[k] for m in made])
            turned = (values - values[0] + 180.0) % 360.0 - 180.0
            np.testing.assert_allclose(turned.std(axis=0)[flat], stated[flat], rtol=0.2)


def test_every_sample_gets_a_row_and_rests_are_marked(
    calibration: Calibration, tmp_path: Path
) -> None:
    recording = read(SAMPLES / "rests.mcap")
    rests, channel = still_segments(recording), recording.channels["imu0/acceleration"]
    found = angles_of_samples(calibration, channel.values, channel.t, rests, 0)
    assert found.t.size == channel.t.size
    assert found.still.sum() == rests.samples.sum()
    assert np.isnan(found.tool_face[np.cos(found.inclination) < 0.04]).all()
    at_rest = angles_at_rests(calibration, channel.values, rests, 0)
    assert np.median(found.inclination_sd) > np.median(at_rest.inclination_sd)


def test_the_tables_angles_come_back_in_its_conventions(
    calibration: Calibration, tmp_path: Path
) -> None:
    """The dial's own scatter (0.1 and 0.2 deg) is what stays."""
    from imucalib.calibration.file import write as write_calibration

    saved, out = tmp_path / "calibration.yaml", tmp_path / "angles.csv"
    write_calibration(calibration, saved)
    arguments = ["apply", str(saved), str(SAMPLES / "rests.mcap"), "-o", str(tmp_path / "c.mcap"),
                 "--angles", str(out), "-q"]  # fmt: skip
    CliRunner().invoke(cli.cli, arguments, standalone_mode=False, catch_exceptions=False)
    table = np.genfromtxt(out, delimiter=",", names=True)
    dial = np.genfromtxt(SAMPLES / "positions.csv", delimiter=",", names=True)
    assert np.abs(table["inclination_deg"] - dial["inclination"]).max() < 0.6
    turn = (table["tool_face_deg"] - dial["tool_face"] + 180.0) % 360.0 - 180.0
    level = np.abs(dial["inclination"]) < 60
    assert np.abs(turn[level]).max() < 1.0
