"""A calibration applied to recordings: by the clock, the thermometer, tables, in any blocks."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucalib.arrays import Array
from imucalib.calibration import apply as application
from imucalib.calibration.apply import apply_to_recording
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import read as read_calibration
from imucalib.calibration.file import to_yaml, write_whole
from imucalib.calibration.undo import Undo
from imucalib.calibrators.actigraph.observations import NINE
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.run import run_of
from imucalib.calibrators.actigraph.simulation import SENSOR
from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from imucalib.core.effect import Context
from imucalib.core.fit import StoredParameter
from imucalib.core.model import Model
from imucalib.effects import catalogue, known, named
from imucalib.errors import UnreadableInput
from imucalib.exports.nearest import nearest_linear
from imucalib.readers import blocks, read
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording
from imucalib.rests.thermal import (
    ThermalHistory,
    pair_thermometer,
    temperature_at,
    thermometer_of,
)
from imucalib.units import MG, STANDARD_GRAVITY
from worlds.command import run
from worlds.recordings import recording_of
from worlds.sheets import Sheet, direction
from worlds.week import WeekPlan, simulated_week

G = STANDARD_GRAVITY
MODEL = Model(tuple(named(name) for name in NINE))
SECONDS = FieldMapping(time_unit="s")
THETA = np.concatenate([SENSOR[name] for name in NINE])


def calibrated(plan: WeekPlan, request: ActigraphRequest, folder: Path) -> Calibration:
    week = simulated_week(plan, 8)
    run = run_of(week.runs, week.scanned, request, lambda text: None)
    write_whole(folder / "calibration.yaml", to_yaml(run.calibration))
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

    for size in (777, 5000):
        monkeypatch.setattr(
            application, "blocks", lambda *a, s=size, **k: blocks(*a, block_samples=s, **k)
        )
        target = tmp_path / f"out{size}.csv"
        done = run("apply", folder / "calibration.yaml", path, "-o", target, "--time-unit", "s")
        assert done.exception is None
        got = read(target, SECONDS).channels["imu0/acceleration"].values
        assert np.allclose(got, whole, rtol=0.0, atol=1e-6)


def _blocks_of(
    t: Array, thermometer: tuple[Array, Array], cuts: Array
) -> tuple[Recording, list[Recording]]:
    """A recording, and the same in blocks; a block has the readings up to its last sample."""
    read, values = thermometer
    parts, until = [], -np.inf
    for a, b in [(0, t.size), *pairwise([0, *cuts.tolist(), t.size])]:
        end = np.inf if b == t.size else float(t[b - 1])
        here = (read > (-np.inf if a == 0 else until)) & (read <= end)
        warm = (read[here], values[here]) if here.any() else None
        parts.append(recording_of(t[a:b], np.zeros((b - a, 3)), warm=warm, hz=1.0))
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
        temperature_at(warm, block.channels["imu0/acceleration"].t)
        for block, warm in pair_thermometer(iter(parts), "imu0")
        if warm is not None
    ]
    assert np.allclose(np.concatenate(found), expected, rtol=0.0, atol=1e-12)


def test_a_lag_without_a_thermometer_is_left_out_and_told(
    lagging: tuple[Path, Calibration],
) -> None:
    calibration = lagging[1]
    bare = recording_of(np.arange(5.0), np.full((5, 3), 5.0), start_ns=0)
    found = apply_to_recording(calibration, bare)
    (note,) = [n for n in found.notes if "left out" in n]
    assert "thermal_lag@1h" in note
    low, high = calibration.valid["temperature_lag_1h"]
    middle = calibration.apply(
        np.full((5, 3), 5.0), Context(5, {"temperature_lag_1h": np.full(5, 0.5 * (low + high))})
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
    recording = recording_of(t, reading, hz=1.0, start_ns=0)
    out = apply_to_recording(calibration, recording).channels["imu0/acceleration"].values
    assert np.allclose(out, force, atol=0.6 * MG)
    one = apply_to_recording(calibration, recording, use="whole")
    assert not np.allclose(one.channels["imu0/acceleration"].values, force, atol=3.0 * MG)
    for k in range(5):
        block = recording_of(t[k : k + 1], reading[k : k + 1], hz=1.0, start_ns=0)
        alone = apply_to_recording(calibration, block).channels["imu0/acceleration"].values
        assert np.allclose(alone[0], out[k], rtol=0.0, atol=1e-12)
    later = replace(recording, start_ns=86_400_000_000_000)
    moved = apply_to_recording(calibration, later).channels["imu0/acceleration"].values
    assert np.allclose(moved[2:], force[2:], atol=0.6 * MG)
    assert not np.allclose(moved[0], force[0], atol=3.0 * MG)


T = np.arange(6000.0)
WARM = 30.0 + 2.0 * np.sin(T / 1500.0)
PER_DEGREE = np.array([1.5, -2.0, 1.0])


def calibration(effect: str = "temperature_bias", covariate: str = "temperature") -> Calibration:
    context = Context(2, {covariate: np.array([20.0, 30.0])})
    values = [(name, SENSOR[name]) for name in NINE] + [(effect, PER_DEGREE)]
    stored = tuple(
        StoredParameter(p.name, name, "sensor", float(v), 0.1, p.unit)
        for name, size in values
        for p, v in zip(named(name).parameters(context), size, strict=True)
    )
    return Calibration(
        calibrator="actigraph", raw_unit="m/s2", raw_to_si=1.0, gravity=G, status="ok", reasons=(),
        parameters=stored, covariance=1e-6 * np.eye(len(stored)), facts={},
        valid={covariate: (26.9, 33.3)},
    )  # fmt: skip


def recording(warm: Array, t: Array = T) -> Recording:
    force = G * np.tile([0.0, 0.6, 0.8], (T.size, 1))
    return recording_of(T, force, warm=(t, warm), start_ns=0)


def corrected(found: Recording) -> Array:
    return np.asarray(found.channels["imu0/acceleration"].values)


@pytest.mark.parametrize("value", [85.0, -127.0])
def test_a_jump_is_no_temperature(value: float) -> None:
    """Its samples are corrected as without a thermometer, and counted; all others are not touched
    by it."""
    at = np.array([0, 700, 701, 3000, 5999])
    wild = WARM.copy()
    wild[at] = value
    known = calibration()
    sound = apply_to_recording(known, recording(WARM))
    found = apply_to_recording(known, recording(wild))
    without = recording(WARM)
    del without.channels["imu0/temperature"]  # type: ignore[attr-defined]
    bare = corrected(apply_to_recording(known, without))
    gone = np.any(corrected(found) != corrected(sound), axis=1)
    assert gone[at].all()
    assert gone.sum() <= 10 * (at.size - 1)
    assert np.allclose(corrected(found)[gone], bare[gone], rtol=0.0, atol=1e-9)
    (note,) = [n for n in found.notes if "jumps" in n]
    assert note.startswith(f"{int(gone.sum())} of 6000 samples have no temperature")
    assert not any("outside" in n or "jumps" in n for n in sound.notes)
    assert not any("outside" in n for n in found.notes)


UNDO_NINE = ("bias", "scale", "non_orthogonality")
TEMPERATURE = ("temperature_bias", "temperature_scale")
SETS = [
    UNDO_NINE,
    (*UNDO_NINE, "curve@response:y:-1:1:32"),
    (*UNDO_NINE, "curve@response:xyz:-1:1:32", *TEMPERATURE),
    (*UNDO_NINE, "quadratic", "cubic"),
    (*UNDO_NINE, "asymmetry", "cross_axis"),
    (*UNDO_NINE, "hysteresis"),
    (*UNDO_NINE, "temperature_bias", "bias_drift", "curve@response:x:-1:1:8"),
]


def sensor(names: tuple[str, ...], seed: int = 0) -> tuple[Model, Array]:
    """The effects at random sizes of a few milli-g at 1 g."""
    rng = np.random.default_rng(seed)
    effects = [effect for n in names if (effect := known(n)) is not None]
    assert len(effects) == len(names)
    model = Model(tuple(effects))
    theta = np.array([rng.normal() * p.typical for p in model.parameters(Context(1))])
    return model, theta


def around(n: int, seed: int, size: float = 1.0) -> tuple[Array, Context]:
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(n, 3))
    reading = size * STANDARD_GRAVITY * u / np.linalg.norm(u, axis=1, keepdims=True)
    covariates = {
        "temperature": rng.uniform(15.0, 35.0, n),
        "order": np.linspace(0.0, 1.0, n),
        **{f"previous_{a}": rng.uniform(-9.0, 9.0, n) for a in "xyz"},
    }
    return reading, Context(n, covariates)


@pytest.mark.parametrize("names", SETS, ids=lambda names: "+".join(names[3:]) or "nine")
@pytest.mark.parametrize("size", [0.7, 2.5])
def test_it_is_what_newton_finds(names: tuple[str, ...], size: float) -> None:
    model, theta = sensor(names)
    reading, context = around(9000, 3, size)
    force, settled = Undo(model, theta)(reading, context)
    exact = model.correct(theta, reading[:, None], context)[:, 0]
    assert settled.all()
    # A micro-g; the sharpest curve bends between two entries of a table.
    assert np.abs(force - exact).max() < 1e-3 * MG


def undo_calibration(names: tuple[str, ...], valid: dict[str, tuple[float, float]]) -> Calibration:
    model, theta = sensor(names)
    stored = tuple(
        StoredParameter(p.name, e.name, e.stage, 0.0, 0.1, p.unit)
        for e in model.effects
        for p in e.parameters(Context(1))
    )
    every = tuple(replace(p, value=float(v)) for p, v in zip(stored, theta, strict=True))
    return Calibration(
        calibrator="lab", parameters=every, covariance=np.eye(len(every)), raw_unit="m/s2",
        raw_to_si=1.0, gravity=STANDARD_GRAVITY, status="ok", reasons=(), valid=valid,
    )  # fmt: skip


def recorded(n: int, warm: Array | None = None, size: float = 1.0) -> Recording:
    return recording_of(np.arange(float(n)), around(n, 8, size)[0], warm=warm, start_ns=0)


def test_samples_beyond_the_calibrated_range_are_counted_and_kept() -> None:
    names = (*UNDO_NINE, "temperature_bias", "quadratic")
    made = undo_calibration(names, {"temperature": (20.0, 30.0)})
    warm = np.where(np.arange(200) < 40, 41.0, 25.0)  # no jump that comes back
    found = apply_to_recording(made, recorded(200, warm, size=3.0))
    notes = " ".join(found.notes)
    assert "40 of 200 samples lie outside the calibrated temperature, 20 to 30 °C" in notes
    values = recorded(200, warm, 3.0).channels["imu0/acceleration"].values
    far = int((np.abs(values) > 1.1 * STANDARD_GRAVITY).any(axis=1).sum())
    assert f"{far} of 200 samples read more than 1.1 g" in notes
    model, theta = sensor(names)
    exact = model.correct(theta, values[:, None], Context(200, {"temperature": warm}))[:, 0]
    assert np.allclose(found.channels["imu0/acceleration"].values, exact, atol=1e-5)
    inside = apply_to_recording(made, recorded(200, np.full(200, 25.0)))
    assert not any("outside" in n or "1.1 g" in n for n in inside.notes)


def test_every_steady_effect_of_the_catalogue_is_undone() -> None:
    for name, effect in catalogue().items():
        if effect.stage != "sensor" or effect.needs or effect.channel != "acceleration":
            continue
        own = tuple(dict.fromkeys((*UNDO_NINE, name)))
        model, theta = sensor(own)
        reading, context = around(300, 9)
        exact = model.correct(theta, reading[:, None], context)[:, 0]
        assert np.allclose(Undo(model, theta)(reading, context)[0], exact, atol=1e-3 * MG), name
    assert named("bias") is not None


@pytest.mark.parametrize("later", [0.0, 7200.0, -3600.0])
def test_the_time_of_day_and_of_the_calibration_go_by_the_clock(later: float) -> None:
    """A bias of one day's period and a drift, as numbers by hand."""
    start = 1_700_000_000  # s; 22:13:20 UTC
    names = ("bias", "bias_drift", "time_of_day")
    made = undo_calibration(names, {"order": (0.0, 1.0)})
    clock = {"start_ns": str(start * 10**9), "span_s": 600.0}
    made = replace(made, facts={"clock": clock})
    values = np.array([p.value for p in made.parameters]) * MG
    bias, drift, cosine, sine = values.reshape(4, 3)
    log = replace(recorded(50), start_ns=int((start + later) * 10**9))
    t = np.arange(50.0) + later
    angle = 2.0 * np.pi * (22.0 * 3600.0 + 800.0 + t) / 86400.0
    by_day = np.cos(angle)[:, None] * cosine + np.sin(angle)[:, None] * sine
    expected = corrected(log) - bias - by_day - (t / 600.0 - 0.5)[:, None] * drift
    found = corrected(apply_to_recording(made, log))
    np.testing.assert_allclose(found, expected, atol=1e-9)


BIAS, CHANGE = np.array([12.0, -7.0, 5.0]), np.array([4.0, -3.0, 6.0])


def later_readings_calibrated(declared: str, course: Array, folder: Path) -> Calibration:
    """A sheet of 36 rows whose bias changes along a course (36,) from 0 to 1."""
    rng = np.random.default_rng(3)
    i, t = np.repeat([-60.0, -20.0, 20.0, 60.0], 9), np.tile(np.arange(0.0, 360.0, 40.0), 4)
    shuffled = rng.permutation(36)
    i, t = i[shuffled], t[shuffled]
    reading = 1000.0 * direction(i, t) + BIAS + course[:, None] * CHANGE
    reading = reading + 0.05 * rng.standard_normal((36, 3))
    path = Sheet(i, t, reading).write(folder / "sheet.csv")
    request = LabRequest(unit="mg", loop=False, declare=(declared,))
    return run_lab(read_position_table(path), request).calibration


@pytest.mark.parametrize(
    ("declared", "course"),
    [
        ("bias_step@record25", (np.arange(36) >= 24).astype(float)),
        ("bias_step@record8", (np.arange(36) >= 7).astype(float)),
        ("bias_drift", np.linspace(0.0, 1.0, 36)),
    ],
)
def test_a_later_recording_finds_the_sensor_as_it_was_left(
    declared: str, course: Array, tmp_path: Path
) -> None:
    found = later_readings_calibrated(declared, course, tmp_path)
    true = 1000.0 * direction(np.array([10.0, -35.0]), np.array([75.0, 200.0]))
    raw = MG * (true + BIAS + CHANGE)
    done = apply_to_recording(found, recording_of(np.arange(2.0), raw))
    off = np.linalg.norm(done.channels["imu0/acceleration"].values / MG - true, axis=1)
    assert off.max() < 0.3
    (note,) = [n for n in done.notes if "left out" in n]
    assert "at the end of what was calibrated" in note
    linear = nearest_linear(found)
    assert np.linalg.norm((raw @ linear.M.T + linear.b) / MG - true, axis=1).max() < 0.3
