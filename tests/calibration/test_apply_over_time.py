"""Corrections that depend on when: lagged temperature and parts, the same in blocks of any size."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from imucalib import cli
from imucalib.calibration.apply import apply_to_recording
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import read as read_calibration
from imucalib.calibration.file import write as write_calibration
from imucalib.calibrators.actigraph.observations import NINE
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.run import run_of
from imucalib.calibrators.actigraph.simulation import SENSOR, WeekPlan, simulated_week
from imucalib.core.effect import Context
from imucalib.core.model import Model
from imucalib.effects import named
from imucalib.errors import UnreadableInput
from imucalib.readers import read
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.thermal import (
    ThermalHistory,
    temperature_at,
    thermometer_of,
    with_thermometer,
)
from imucalib.units import MG, STANDARD_GRAVITY

Array = NDArray[np.float64]
G = STANDARD_GRAVITY
MODEL = Model(tuple(named(name) for name in NINE))
SECONDS = FieldMapping(time_unit="s")
THETA = np.concatenate([SENSOR[name] for name in NINE])


def calibrated(plan: WeekPlan, request: ActigraphRequest, folder: Path) -> Calibration:
    week = simulated_week(plan, 8)
    run = run_of(week.runs, week.scanned, request, lambda text: None)
    write_calibration(run.calibration, folder / "calibration.yaml")
    return read_calibration(folder / "calibration.yaml")


@pytest.fixture(scope="module")
def lagging(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Calibration]:
    folder = tmp_path_factory.mktemp("lag")
    plan = WeekPlan(days=3.0, plant={"thermal_lag@1h": (1.5, -2.0, 1.0)})
    found = calibrated(plan, ActigraphRequest(only=("thermal_lag",)), folder)
    assert {p.effect for p in found.parameters} >= {"thermal_lag@1h"}
    return folder, found


def warming(n: int = 20_000, step: float = 1.0) -> tuple[Array, Array]:
    t = step * np.arange(n)
    return t, 29.0 + 3.0 * np.sin(t / 4000.0) + 2.0 * (t > 9000.0)


def test_a_lag_is_undone_in_blocks_as_in_memory(
    lagging: tuple[Path, Calibration], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, calibration = lagging
    t, warm = warming()
    late = ThermalHistory(t, warm).lagged(1.0, t)
    rng = np.random.default_rng(0)
    force = rng.standard_normal((t.size, 3))
    force *= G / np.linalg.norm(force, axis=1, keepdims=True)
    reading = MODEL.predict(THETA, force[:, None], Context(t.size)).reading[:, 0]
    reading += MG * np.array([1.5, -2.0, 1.0]) * (late - 25.0)[:, None]
    path = tmp_path / "raw.csv"
    rows = np.column_stack([t, reading / G, warm])
    header = "time_s,acc_x_g,acc_y_g,acc_z_g,temperature (degC)"
    np.savetxt(path, rows, "%.7f", ",", header=header, comments="")
    whole = (
        apply_to_recording(calibration, read(path, SECONDS)).channels["imu0/acceleration"].values
    )
    assert np.abs(np.linalg.norm(whole, axis=1) - G).mean() < 0.2 * MG
    plain = calibration.parameters[:9]
    without = replace(calibration, parameters=plain, covariance=calibration.covariance[:9, :9])
    early = apply_to_recording(without, read(path, SECONDS)).channels["imu0/acceleration"].values
    assert np.abs(np.linalg.norm(early, axis=1) - G).mean() > 2.0 * MG

    from imucalib.calibration import apply as application

    for size in (777, 5000):
        from imucalib.readers import blocks

        monkeypatch.setattr(
            application, "blocks", lambda *a, s=size, **k: blocks(*a, block_samples=s, **k)
        )
        target = tmp_path / f"out{size}.csv"
        arguments = [
            "apply",
            str(folder / "calibration.yaml"),
            str(path),
            "-o",
            str(target),
            "-q",
            "--time-unit",
            "s",
        ]
        result = CliRunner().invoke(cli.cli, arguments, standalone_mode=False)
        assert result.exception is None
        got = read(target, SECONDS).channels["imu0/acceleration"].values
        assert np.allclose(got, whole, rtol=0.0, atol=1e-6)


def _blocks_of(
    t: Array, thermometer: tuple[Array, Array], cuts: Array
) -> tuple[Recording, list[Recording]]:
    """A recording, and the same in blocks; a block has the readings up to its last sample."""
    values = np.zeros((t.size, 3))
    edges = [0, *cuts.tolist(), t.size]
    whole, parts, until = Recording({}, "made", "made", ""), [], -np.inf
    for a, b in [(0, t.size), *pairwise(edges)]:
        end = np.inf if b == t.size else float(t[b - 1])
        here = (thermometer[0] > (-np.inf if a == 0 else until)) & (thermometer[0] <= end)
        channels = {"acc": Channel(t[a:b], values[a:b], "m/s2", "acceleration", "imu0", 1.0)}
        if here.any():
            warm = thermometer[1][here, None]
            channels["temp"] = Channel(
                thermometer[0][here], warm, "degC", "temperature", "imu0", 0.1
            )
        parts.append(replace(whole, channels=channels))
        until = end
    return parts[0], parts[1:]


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.5, 5000.0),
    st.floats(0.0, 900.0),
    st.integers(1, 30),
    st.booleans(),
    st.integers(0, 2**32),
)
def test_a_slow_thermometer_reads_the_same_in_blocks_of_any_size(
    period: float, first: float, blocks: int, hole: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    t = 10.0 * np.arange(3000)
    read = np.arange(first, t[-1], period)
    read = read[(read < 9000.0) | (read > 17_000.0)] if hole else read
    cuts = np.unique(rng.integers(1, t.size, blocks))
    thermometer = read, 20.0 + rng.standard_normal(read.size).cumsum()
    whole, parts = _blocks_of(t, thermometer, cuts)
    channel = thermometer_of(whole, "imu0")
    assert channel is not None
    expected = temperature_at(channel, t)
    found = [
        temperature_at(warm, block.channels["acc"].t)
        for block, warm in with_thermometer(iter(parts), "imu0")
        if warm is not None
    ]
    assert np.allclose(np.concatenate(found), expected, rtol=0.0, atol=1e-12)


def test_a_lag_without_a_thermometer_is_left_out_and_told(
    lagging: tuple[Path, Calibration],
) -> None:
    calibration = lagging[1]
    channel = Channel(np.arange(5.0), np.full((5, 3), 5.0), "m/s2", "acceleration", "imu0", 1.0)
    bare = Recording({"imu0/acceleration": channel}, "made", "made", "", start_ns=0)
    found = apply_to_recording(calibration, bare)
    (note,) = [n for n in found.notes if "left out" in n]
    assert "thermal_lag@1h" in note
    low, high = calibration.valid["temperature_lag_1h"]
    middle = calibration.apply(
        channel.values, Context(5, {"temperature_lag_1h": np.full(5, 0.5 * (low + high))})
    )
    assert np.allclose(found.channels["imu0/acceleration"].values, middle, atol=1e-6)
    # Planted: 1.5, -2.0 and 1.0 mg/°C.
    size = float(note.partition("up to ")[2].partition(" mg")[0])
    assert size == pytest.approx(0.5 * (high - low) * np.sqrt(1.5**2 + 2.0**2 + 1.0), rel=0.15)
    unknown = replace(calibration, valid={})
    with pytest.raises(UnreadableInput, match="temperature_lag_1h"):
        apply_to_recording(unknown, bare)


@pytest.fixture(scope="module")
def stepped(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Calibration]:
    folder = tmp_path_factory.mktemp("parts")
    plan = WeekPlan(days=2.0, plant={"bias_step@86400s": (12.0, 0.0, -9.0)})
    request = ActigraphRequest(every=86400.0, loop=False)
    return folder, calibrated(plan, request, folder)


def test_each_sample_gets_the_part_valid_at_its_time(stepped: tuple[Path, Calibration]) -> None:
    _, calibration = stepped
    t = np.array([10.0, 86399.0, 86400.0, 170000.0, 400000.0])
    force = G * np.tile([0.6, 0.0, 0.8], (5, 1))
    reading = MODEL.predict(THETA, force[:, None], Context(5)).reading[:, 0]
    reading[2:] += MG * np.array([12.0, 0.0, -9.0])
    channel = Channel(t, reading, "m/s2", "acceleration", "imu0", 1.0)
    recording = Recording({"imu0/acceleration": channel}, "made", "made", "", start_ns=0)
    out = apply_to_recording(calibration, recording).channels["imu0/acceleration"].values
    assert np.allclose(out, force, atol=0.6 * MG)
    one = apply_to_recording(calibration, recording, use="whole")
    assert not np.allclose(one.channels["imu0/acceleration"].values, force, atol=3.0 * MG)
    for k in range(5):
        single = replace(channel, t=t[k : k + 1], values=reading[k : k + 1])
        block = replace(recording, channels={"imu0/acceleration": single})
        alone = apply_to_recording(calibration, block).channels["imu0/acceleration"].values
        assert np.allclose(alone[0], out[k], rtol=0.0, atol=1e-12)
    later = replace(recording, start_ns=86_400_000_000_000)
    moved = apply_to_recording(calibration, later).channels["imu0/acceleration"].values
    assert np.allclose(moved[2:], force[2:], atol=0.6 * MG)
    assert not np.allclose(moved[0], force[0], atol=3.0 * MG)
