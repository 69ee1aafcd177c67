"""The fused IMU: its noise, its output in every format, what it must not do, its lags by hand."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from click.testing import Result

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import to_yaml, write_whole
from imucalib.calibrators.array.fusion.fuse import Fused
from imucalib.calibrators.array.fusion.instrument import (
    NonlinearTerms,
    Stretch,
    instrument_of,
    read_nonlinear,
)
from imucalib.calibrators.array.fusion.recording import fuse_stretch
from imucalib.calibrators.array.fusion.survey import NotFusable, Survey, side_by_side, survey
from imucalib.calibrators.array.motion.terms import board_motion
from imucalib.errors import UsageError
from imucalib.readers import read
from imucalib.recording.recording import Recording
from imucalib.writers import write as write_recording
from worlds.command import run
from worlds.rigid_board import (
    DEG,
    Board,
    Moves,
    board,
    calibration,
    moves,
    readings,
    recording,
    turned_by,
)

HZ = 100.0


@dataclass(frozen=True)
class World:
    """What a board did, what it read, and what was made of that."""

    board: Board
    moves: Moves
    readings: tuple[Array, Array]
    survey: Survey
    fused: Fused

    @property
    def error(self) -> Array:
        """(T, 9) of force at the instrument's point, dω/dt and ω."""
        at, true, found = self.survey.instrument.at[None], self.moves, self.fused.motion
        force = true.force + np.cross(true.rate, np.cross(true.rate, at)) + np.cross(true.spin, at)
        parts = (found.force - force, found.spin - true.spin, found.rate - true.rate)
        return np.concatenate(parts, axis=1)

    @property
    def z(self) -> Array:
        return np.asarray(self.error / np.sqrt(np.einsum("tii->ti", self.fused.motion.covariance)))


def fused_by(
    made: Board, motion: Moves, read: tuple[Array, Array], file: Calibration | None = None
) -> World:
    log = recording(made, motion.t, *read)
    found = survey([log], instrument_of(file or calibration(made)))
    return World(made, motion, read, found, fuse_stretch(found, Stretch(motion.t, *read)))


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def plain() -> World:
    rng = np.random.default_rng(0)
    made = board(rng)
    motion = moves(rng, still=12.0, moving=25.0, hz=HZ, twist=250.0)
    return fused_by(made, motion, readings(made, motion, rng))


@pytest.mark.slow
@pytest.mark.parametrize("part", [slice(1150), slice(1450, None)], ids=["still", "moving"])
def test_noise_falls_as_the_root_of_the_chips_and_is_stated(plain: World, part: slice) -> None:
    assert rms(plain.error[part, 6:]) < 1.05 * 0.2 * DEG / np.sqrt(8)
    assert rms(plain.error[part, :3]) < 1.05 * 0.04 / np.sqrt(8)
    assert 0.95 < rms(plain.z[part, :3]) < 1.05
    assert 0.95 < rms(plain.z[part, 6:]) < 1.05
    # dω/dt leans on how smooth the motion is, which is judged with care.
    assert 0.7 < rms(plain.z[part, 3:6]) < 1.05


@pytest.mark.slow
def test_missing_wild_and_clipped_readings_are_left_out() -> None:
    rng = np.random.default_rng(4)
    made = board(rng, ranges=(16.0, 1e9))
    motion = moves(rng, still=12.0, moving=20.0, hz=HZ, twist=250.0)
    acceleration, rate = readings(made, motion, rng)
    rows = slice(2000, 2600)
    rate[rows, 2] = np.nan
    acceleration[rows, 5, 1] += 20.0  # one axis goes wild
    acceleration[2100:2300, 0] = np.nan
    assert (np.abs(acceleration) >= 15.99).any(axis=(1, 2)).mean() > 0.02
    found = fused_by(made, motion, (acceleration, rate))
    assert rms(found.error[2020:2600, 6:]) < 1.2 * 0.2 * DEG / np.sqrt(7)
    assert rms(found.error[rows, :3]) < 1.3 * 0.04 / np.sqrt(6)
    assert not found.fused.live[2100:2300, 0].any()


def test_a_frozen_chip_is_as_good_as_one_that_is_not_there() -> None:
    """From the middle of the motion on, over the border of two blocks."""
    rng = np.random.default_rng(6)
    made = board(rng)
    motion = moves(rng, still=12.0, moving=12.0, hz=HZ, twist=250.0)
    read = readings(made, motion, rng)
    rows, errors = slice(1900, None), []
    for gone in (False, True):
        own = [v.copy() for v in read]
        for v in own:
            v[rows, 3] = np.nan if gone else v[1900, 3]
        log = recording(made, motion.t, *own)
        instrument = instrument_of(calibration(made))
        found = survey([log], instrument)
        parts = list(side_by_side(_in_blocks(log, 2100), found.instrument))
        stretch = Stretch(
            motion.t,
            np.concatenate([part.acceleration for part in parts]),
            np.concatenate([part.rate for part in parts]),
        )
        assert np.isnan(stretch.rate[1901:, 3]).all()
        assert np.isfinite(stretch.rate[:1900]).all()
        errors.append(fuse_stretch(found, stretch).motion.rate - motion.rate)
    frozen, absent = (rms(e[rows]) for e in errors)
    assert frozen < 1.2 * absent


def late(read: Array, own: Array) -> Array:
    return np.concatenate([own[:1], own[:-1]])


def clipped(read: Array, own: Array) -> Array:
    """At the third quarter of all of its readings, a limit that no file states."""
    return np.clip(own, *np.quantile(read, [0.25, 0.75]))


@pytest.mark.parametrize("start", [1200, 1800], ids=["all along", "from the middle on"])
@pytest.mark.parametrize("spoil", [late, clipped])
@pytest.mark.parametrize("chips", [4, 8])
def test_a_chip_that_is_wrong_costs_little_more_than_one_that_is_not_there(
    chips: int, spoil: Callable[[Array, Array], Array], start: int
) -> None:
    rng = np.random.default_rng(6)
    made = board(rng, chips=chips)
    motion = moves(rng, still=12.0, moving=12.0, hz=HZ, twist=250.0)
    read, errors = readings(made, motion, rng), []
    for gone in (False, True):
        own = [v.copy() for v in read]
        for v in own:
            v[start:, 2] = np.nan if gone else spoil(v[1200:, 2], v[start:, 2])
        errors.append(fused_by(made, motion, (own[0], own[1])).error[1900:])
    for part in (slice(3), slice(6, None)):
        assert rms(errors[0][:, part]) < 1.2 * rms(errors[1][:, part])


@pytest.mark.slow
def test_biases_are_taken_anew_at_rest(plain: World) -> None:
    made, motion, old = plain.board, plain.moves, calibration(plain.board)
    moved = replace(
        made,
        gyro_biases=made.gyro_biases + 0.5 * DEG,
        biases=made.biases + 0.02 * np.random.default_rng(0).normal(size=(8, 3)),
    )
    read = readings(moved, motion, np.random.default_rng(6))
    found = fused_by(moved, motion, read, old)
    assert found.survey.rests > 6.0
    assert rms(found.error[:, 6:]) < 1.1 * 0.2 * DEG / np.sqrt(8)
    # Without a rest they are the calibration's.
    late = motion.t > 15.0
    cut = recording(moved, motion.t[late], read[0][late], read[1][late])
    assert survey([cut], instrument_of(old)).rests == 0.0


def _in_blocks(log: Recording, size: int) -> list[Recording]:
    """Every channel cut at its own rows, as readers cut logs of messages."""
    count = max(len(c.t) for c in log.channels.values())
    made = []
    for start in range(0, count, size):
        channels = {}
        for k, (name, c) in enumerate(log.channels.items()):
            stop = None if start + size >= count else start + size - 5 * k
            rows = slice(max(0, start - 5 * k) if start else 0, stop)
            channels[name] = replace(c, t=c.t[rows], values=c.values[rows])
        made.append(replace(log, channels=channels))
    return made


@pytest.mark.slow
def test_a_log_in_uneven_blocks_is_the_same(plain: World) -> None:
    log = recording(plain.board, plain.moves.t, *plain.readings)
    parts = list(side_by_side(_in_blocks(log, 777), plain.survey.instrument))
    assert len(parts) > 3
    assert np.concatenate([p.t for p in parts]) == pytest.approx(plain.moves.t)
    assert np.array_equal(np.concatenate([p.rate for p in parts]), plain.readings[1])
    first = Stretch(plain.moves.t[:900], *(r[:900] for r in plain.readings))
    joined = fuse_stretch(plain.survey, first).motion
    assert joined.rate[:850] == pytest.approx(plain.fused.motion.rate[:850], abs=1e-6)


def test_samples_without_a_partner_stay_in(plain: World) -> None:
    """A chip that loses samples or comes a little late takes part where it can."""
    log = recording(plain.board, plain.moves.t, *plain.readings)
    some = log.channels["imu3/angular_rate"]
    keep = np.arange(len(some.t)) % 5 > 0
    part = replace(some, t=some.t[keep] + 0.1 / HZ, values=some.values[keep])
    channels = {**log.channels, "imu3/angular_rate": part}
    (stretch,) = side_by_side([replace(log, channels=channels)], plain.survey.instrument)
    assert len(stretch.t) == len(plain.moves.t)
    assert np.isnan(stretch.rate[:, 3, 0]).mean() == pytest.approx(0.2, abs=0.01)
    assert np.isfinite(stretch.rate[:, 2]).all()


def test_what_cannot_be_fused_is_refused(plain: World) -> None:
    log = recording(plain.board, plain.moves.t, *plain.readings)
    one = {n: c for n, c in log.channels.items() if c.triad == "imu0"}
    none = {n: c for n, c in log.channels.items() if c.quantity == "acceleration"}
    raw = {n: replace(c, unit="counts") for n, c in log.channels.items()}
    for channels in (one, none, raw):
        with pytest.raises(NotFusable):
            survey([replace(log, channels=channels)], instrument_of(calibration(plain.board)))
    single = replace(calibration(plain.board), triads=(), calibrator="lab")
    with pytest.raises(UsageError, match="nothing to fuse"):
        instrument_of(single)


@dataclass(frozen=True)
class Files:
    folder: Path
    moves: Moves

    def apply(self, target: str, *options: object, source: str = "log.h5") -> Result:
        given = (self.folder / "c.yaml", self.folder / source, "-o", self.folder / target)
        return run("apply", *given, "--force", *options)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    rng = np.random.default_rng(8)
    made = board(rng, chips=4, late=1e-3)
    motion = moves(rng, still=8.0, moving=8.0, hz=100.0, twist=150.0, late=1e-3, fastest=2.0)
    folder = tmp_path_factory.mktemp("fused")
    log = recording(made, motion.t, *readings(made, motion, rng))
    write_whole(folder / "c.yaml", to_yaml(calibration(made)))
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


def test_csv_names_every_column(files: Files) -> None:
    assert files.apply("fused.csv", "--fused", "-q").return_value == 0
    lines = (files.folder / "fused.csv").read_text().splitlines()
    names = next(line for line in lines if line.startswith("time")).split(",")
    assert len(names) == 1 + 3 * (3 + 9)
    assert "fused/angular_rate_covariance/xy [rad2/s2]" in names


@pytest.mark.parametrize(
    "options", ["--at 1,2", "--at x,y,z", "--no-fused --at 0,0,0", "--fused --triad imu0"]
)
def test_options_that_make_no_sense_are_refused(files: Files, options: str) -> None:
    result = files.apply("none.h5", *options.split())
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


#: m of a coordinate, gain, m/s² of a bias, and of all: gravity, gyros' scale, rad of the frame.
PLACE, GAIN, BIAS, GRAVITY, SCALE, FRAME = 3e-5, 1e-3, 0.02, 1e-3, 2e-3, 1e-3


def wrong(truth: Calibration, rng: np.random.Generator) -> Calibration:
    """The file of a calibration that is off by draws of what it states."""
    facts, count = truth.facts, len(truth.triads)
    places = 1e-3 * np.array([row["mean"] for row in facts["positions_mm"]])
    k, gravity, turn = SCALE * rng.normal(), GRAVITY * rng.normal(), FRAME * rng.normal(size=3)
    places[1:] += PLACE * rng.normal(size=(count - 1, 3))
    # Readings (1 + k) ω and forces (1 + g) f give positions (1 + g) / (1 + k)² as large.
    found = turned_by(turn, places * (1.0 + gravity) / (1.0 + k) ** 2)
    own = found[1:].ravel()
    about = np.stack([np.cross(axis, found[1:]).ravel() for axis in np.eye(3)], axis=1)
    size = np.hypot(2.0 * SCALE, GRAVITY)
    covariance = PLACE**2 * np.eye(len(own)) + size**2 * np.outer(own, own)
    covariance += FRAME**2 * about @ about.T
    stated = np.diag([GAIN**2] * 9 + [BIAS**2] * 3)
    triads = []
    for triad in truth.triads:
        gain = triad.gain @ (np.eye(3) + GAIN * rng.normal(size=(3, 3))) / (1.0 + gravity)
        # What is corrected comes out in a frame that is turned.
        triads.append(replace(
            triad, gain=turned_by(turn, gain), gyro_gain=turned_by(turn, triad.gyro_gain)
            / (1.0 + k), bias=triad.bias + BIAS * rng.normal(size=3), covariance=stated,
        ))  # fmt: skip
    rows = [{"imu": t.name, "mean": (1e3 * found[i]).tolist()} for i, t in enumerate(triads)]
    told = {
        "positions_mm": rows,
        "size": {"sd_beyond_motion": size, "sd_of_gravity": GRAVITY},
        "gyro_scale": {"sd": SCALE},
        "frame": {"sd_deg": [FRAME / DEG] * 3},
    }
    return replace(
        truth, triads=tuple(triads), covariance=1e6 * covariance, facts={**facts, **told}
    )


def z_of(seed: int) -> Array:
    """(T, 9) errors of force, dω/dt and ω in motion, over what is stated."""
    rng = np.random.default_rng(seed)
    made = board(rng)
    motion = moves(rng, still=6.0, moving=6.0, hz=HZ, twist=400.0)
    read = readings(made, motion, rng)
    return fused_by(made, motion, read, wrong(calibration(made), rng)).z[motion.t > 8.0]


@pytest.mark.slow
def test_what_the_calibration_leaves_open_is_in_the_covariance() -> None:
    z = np.stack([z_of(seed) for seed in range(12)])
    for k in (0, 3, 6):  # one draw a board: twelve of them know an rms to a tenth or two
        assert 0.75 < rms(z[..., k : k + 3]) < 1.3


QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TURN = np.array([np.eye(3), QUARTER])


def block(effect: str, *values: float) -> dict[str, Any]:
    return {"effect": effect, "parameters": [{"value": v} for v in values]}


def beyond(*blocks: dict[str, Any]) -> NonlinearTerms:
    triads = [SimpleNamespace(name=n, rotation=r) for n, r in zip("ab", TURN, strict=True)]
    return read_nonlinear(SimpleNamespace(triads=triads, facts={"effects": blocks}))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "answer"),
    [("gyro_low_pass", lambda x: 1.0 / (1.0 + x)), ("gyro_delay", lambda x: np.exp(-x))],
)
def test_lags_over_time_are_not_those_of_the_first_order(
    name: str, answer: Callable[[complex], complex]
) -> None:
    """A tone of 4 Hz, 4 ms: the second order is 1 % of it, and half of that for a delay."""
    t, pace = 0.01 * np.arange(400), 2.0j * np.pi * 4.0
    tone = np.exp(pace * t)[:, None] * np.array([12.0, 0.0, 5.0])
    beside = np.stack([np.arange(400) > 0, np.arange(400) < 399], axis=1)
    motion = board_motion(
        beyond(block(name, 4.0)), t, rate=tone.imag, spin=(pace * tone).imag
    ).set_courses(beside)
    made = beyond(block(name, 4.0))
    late = made.late(t, None)
    assert late is not None
    read = (answer(4e-3 * pace) * tone).imag[:, None]
    first = tone.imag[:, None] + np.matmul(late, (pace * tone).imag[:, None, :, None])[..., 0]
    inner = slice(20, -20)
    assert np.abs(first - read)[inner].max() > 0.05
    assert np.abs(first + made.evaluate_lags(motion)[1] - read)[inner].max() < 0.004
