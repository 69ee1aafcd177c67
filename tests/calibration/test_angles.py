"""Angles with their sd: against draws of parameters and noise through the correction itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from imucalib import cli
from imucalib.calibration.angles import angles_at_rests, angles_of_samples
from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.calibration.file import read as read_calibration
from imucalib.core.effect import Context
from imucalib.rests.segments import Segments
from imucalib.units import MG, STANDARD_GRAVITY
from worlds.places import SAMPLES


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    out = tmp_path_factory.mktemp("lab")
    arguments = ["lab", str(SAMPLES / "positions.csv"), "--recording", str(SAMPLES / "rests.mcap"),
                 "-o", str(out), "--no-loop", "-q"]  # fmt: skip
    CliRunner().invoke(cli.cli, arguments, standalone_mode=False)
    return read_calibration(out / "calibration.yaml")


def angles(force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Paper 004's formulae (1) and (2), written a second time, deg."""
    x, y, z = force.T
    return np.degrees(np.arctan(z / np.sqrt(x**2 + y**2))), np.degrees(np.arctan2(x, y)) % 360


def by_hand() -> Calibration:
    """Nine parameters and a mounting, with a full covariance."""
    rng = np.random.default_rng(3)
    names = (
        ("bias", "sensor", 3, "mg", 20.0),
        ("scale", "sensor", 3, "1", 0.02),
        ("non_orthogonality", "sensor", 3, "1", 0.01),
        ("mounting", "mounting", 3, "deg", 1.0),  # last here, first in the model
    )
    stored = tuple(
        StoredParameter(f"{effect}_{k}", effect, stage, float(size * rng.normal()), size, unit)
        for effect, stage, count, unit, size in names
        for k in range(count)
    )
    root = np.diag([p.sd for p in stored]) @ rng.normal(size=(12, 12)) * 1e-3
    return Calibration(
        calibrator="lab", parameters=stored, covariance=root @ root.T, raw_unit="m/s2",
        raw_to_si=1.0, gravity=9.81, status="ok", reasons=(), valid={},
        facts={"noise": {"reading_mg": 0.4}},
    )  # fmt: skip


def rests_in(ways: np.ndarray, samples: int = 25) -> tuple[Segments, np.ndarray]:
    """Rests of equal length in some attitudes, every second sample half a mg off to either side."""
    n = len(ways)
    first = samples * np.arange(n)[:, None]
    force = np.repeat(9.81 * ways, samples, axis=0)
    nothing = np.zeros((n, 1, 3))
    return Segments(
        start=10.0 * np.arange(n), stop=10.0 * np.arange(n) + 4.0, triads=("imu0",), first=first,
        last=first + samples, samples=np.full((n, 1), samples), mean=nothing, variance=nothing,
        rate=nothing, temperature=np.zeros((n, 1)), noise=np.array([[1.0, 2.0, 3.0]]) * MG,
        rate_noise=np.zeros((1, 3)), step=np.zeros((1, 3)), rate_step=np.zeros((1, 3)), moving=0.0,
    ), force  # fmt: skip


def test_sds_are_the_derivatives_of_the_correction() -> None:
    """Of every parameter and of the reading, by small differences; noise falls with the root of the
    samples, what a position repeats to does not."""
    calibration, rng = by_hand(), np.random.default_rng(1)
    ways = rng.normal(size=(6, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    ways[5] = [0.03, 0.0, np.sqrt(1.0 - 9e-4)]
    segments, force = rests_in(ways)
    found = angles_at_rests(calibration, force, segments, 0)
    np.testing.assert_allclose(found.t, 10.0 * np.arange(6) + 2.0)
    np.testing.assert_allclose(found.norm_error, 0.0, atol=1e-9)
    reading = STANDARD_GRAVITY * ways
    model, theta = calibration.model()
    reading = model.predict(theta, reading[:, None], Context(6)).reading[:, 0]

    def seen(change: np.ndarray, read: np.ndarray) -> np.ndarray:
        named = zip(calibration.parameters, change, strict=True)
        moved = tuple(replace(p, value=p.value + float(d)) for p, d in named)
        i, t = angles(replace(calibration, parameters=moved).apply(read))
        return np.array([i, t])

    slope = []
    for k in range(12):
        step = 1e-5 * calibration.parameters[k].sd * np.eye(12)[k]
        both = seen(step, reading) - seen(-step, reading)
        slope.append(((both + 180.0) % 360.0 - 180.0) / (2.0 * step[k]))
    own = np.sqrt(np.einsum("pan,pq,qan->an", np.array(slope), calibration.covariance,
                            np.array(slope)))  # fmt: skip
    noise = np.hypot(0.4, np.array([1.0, 2.0, 3.0]) / 5.0) * MG
    square = own**2
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        both = seen(np.zeros(12), reading + step) - seen(np.zeros(12), reading - step)
        square = square + (((both + 180.0) % 360.0 - 180.0) / 2e-6 * noise[axis]) ** 2
    np.testing.assert_allclose(found.inclination_calibration_sd, own[0], rtol=1e-4)
    np.testing.assert_allclose(found.inclination_sd, np.sqrt(square[0]), rtol=1e-4)
    np.testing.assert_allclose(found.tool_face_calibration_sd[:5], own[1, :5], rtol=1e-4)
    np.testing.assert_allclose(found.tool_face_sd[:5], np.sqrt(square[1, :5]), rtol=1e-4)
    # Within 2.9 deg of the vertical a tool-face means nothing.
    assert np.isnan(found.tool_face).tolist() == [False] * 5 + [True]
    assert np.isnan(found.tool_face_sd[5])
    every = angles_of_samples(calibration, 1.002 * force, np.arange(150.0), segments, 0)
    assert every.still.all()
    np.testing.assert_allclose(every.norm_error, 2.0 * 9.81 / STANDARD_GRAVITY, rtol=1e-9)
    assert (every.inclination_sd[:25] > found.inclination_sd[0]).all()
