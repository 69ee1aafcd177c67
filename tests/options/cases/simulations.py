"""Cases of `imucal simulate` and `imucal design`: what is written is what was asked for."""

from __future__ import annotations

import csv
from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array
from imucalib.readers import read
from imucalib.recording.recording import Channel
from options.bench import Bench
from options.case import USUAL, Case, Check, Of
from options.outcome import Outcome

LAB, WORN, BOARD, TURNS, DESIGN = (
    Of("simulate lab"), Of("simulate actigraph"), Of("simulate array"), Of("simulate imu"),
    Of("design"),
)  # fmt: skip
MG = 9.80665e-3
QUIET_BENCH = (*USUAL["simulate lab"], "--noise", "0", "--setting-sd", "0,0")
QUIET_DAY = (*USUAL["simulate actigraph"], "--noise", "0")
QUIET_TURNS = (*USUAL["simulate imu"], "--noise", "0", "--gyro-noise", "0")
QUIET_LOG = (*USUAL["simulate array"], "--noise", "0", "--gyro-noise", "0")


def _table(outcome: Outcome) -> Array:
    """(n, 5) angles in deg and readings in mg."""
    with (outcome.folder / "bench.csv").open(newline="") as file:
        rows = [r for r in csv.reader(file) if r and not r[0].startswith("#")]
    return np.array([[float(v) for v in row] for row in rows[1:]])


def _channels(outcome: Outcome, name: str) -> dict[str, list[Channel]]:
    found: dict[str, list[Channel]] = {}
    for channel in read(outcome.folder / name).channels.values():
        found.setdefault(channel.quantity, []).append(channel)
    return found


def _acc(outcome: Outcome, name: str) -> Array:
    return _channels(outcome, name)["acceleration"][0].values


def _turning(outcome: Outcome) -> Array:
    return _channels(outcome, "turns.csv")["angular_rate"][0].values


def _t(outcome: Outcome, name: str) -> Array:
    return _channels(outcome, name)["acceleration"][0].t


def _that(holds: Callable[[Outcome, Outcome], object]) -> Check:
    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        assert done.code == without.code == 0, done.stderr
        assert holds(without, done)

    return check


def _planted_zero(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Inclination is 10 deg more than the dial says: norms as before, z higher at 0."""
    one, two = _table(without), _table(done)
    np.testing.assert_allclose(one[:, :2], two[:, :2])
    level = np.flatnonzero(one[:, 0] == 0.0)
    assert level.size
    np.testing.assert_allclose(two[level, 4] - one[level, 4], 1000.0 * np.sin(np.radians(10.0)),
                               rtol=0.05)  # fmt: skip


def _one_sign(without: Outcome, done: Outcome, bench: Bench) -> None:
    one, two = _table(without), _table(done)
    changed = np.argwhere(one != two)
    assert changed.tolist() == [[3, 3]]
    assert two[3, 3] == -one[3, 3]


def _planted_bias(without: Outcome, done: Outcome, bench: Bench) -> None:
    """temperature_bias is mg per degree from 25 °C."""
    found = _channels(done, "day.csv")
    warm = np.interp(found["acceleration"][0].t, found["temperature"][0].t,
                     found["temperature"][0].values[:, 0])  # fmt: skip
    away = (_acc(done, "day.csv") - _acc(without, "day.csv")) / MG
    np.testing.assert_allclose(away[:, 0], 3.0 * (warm - 25.0), atol=0.5)
    np.testing.assert_allclose(away[:, 1:], 0.0, atol=0.05)


def _gap(name: str, start: float, length: float) -> Check:
    def check(without: Outcome, done: Outcome, bench: Bench) -> None:
        t = _t(without, name)
        kept = _t(done, name)
        expected = t[(t < start) | (t >= start + length)]
        assert abs(len(kept) - len(expected)) <= 1
        inside = (kept > start + 1e-6) & (kept < start + length - 1e-6)
        assert not inside.any()

    return check


def _rests_in_order(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Readings move into the recording: the table holds angles alone."""
    assert {"bench.csv", "rests.csv"} == set(done.files)
    header = done.text("bench.csv").splitlines()[0]
    assert "x" not in header.replace("axis", "")
    means = _acc(done, "rests.csv")
    assert len(means) > 12 * 50


def _recommended(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert len(done.content["positions"]) == 9
    assert done.content["known_angles"]["open"] == []


def _drilling(without: Outcome, done: Outcome, bench: Bench) -> None:
    """90 deg minus the paper's inclination: the same plan, said otherwise."""
    one, two = (o.content["known_angles"]["efficiency"] for o in
                (bench.run(USUAL["design"]), done))  # fmt: skip
    assert np.isclose(one, two, rtol=1e-6)


def _saved(without: Outcome, done: Outcome, bench: Bench) -> None:
    lines = done.text("plan.csv").splitlines()
    assert lines[0] == "inclination,tool_face"
    rows = [tuple(float(v) for v in x.split(",")) for x in lines[1:]]
    plan = [(p["inclination"], p["tool_face"]) for p in done.content["positions"]]
    np.testing.assert_allclose(rows, plan, atol=0.05)


def _every_position(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The positions that were given stand in the whole alone."""
    assert "Not shown here" in without.stdout
    assert "Not shown here" not in done.stdout
    assert done.stdout.splitlines()[:20] == without.stdout.splitlines()[:20]
    assert "row  inclination  tool-face" in " ".join(done.stdout.splitlines())
    assert "row  inclination  tool-face" not in without.stdout


CASES: tuple[Case, ...] = (
    LAB("--recording <out>/rests.csv", _rests_in_order),
    LAB("--layout random", _that(
        lambda a, b: len(set(_table(b)[:, 1])) > len(set(_table(a)[:, 1])))),
    LAB("--layout rings", _that(
        lambda a, b: len(set(_table(b)[:, 0])) < len(set(_table(a)[:, 0])))),
    LAB("--positions 15", _that(lambda a, b: len(_table(b)) == 15)),
    LAB("--plant inclination_zero=10", _planted_zero, *QUIET_BENCH),
    LAB("--slip 4:y", _one_sign),
    LAB("--noise 50", _that(lambda a, b: np.isclose(
        np.std(_table(b)[:, 2:] - _table(a)[:, 2:]), 50.0, rtol=0.4))),
    LAB("--setting-sd 5,5", _that(lambda a, b: np.abs(
        np.linalg.norm(_table(b)[:, 2:], axis=1) - np.linalg.norm(_table(a)[:, 2:], axis=1)
    ).max() < 0.3 * np.abs(_table(b)[:, 2:] - _table(a)[:, 2:]).max()), *QUIET_BENCH),
    LAB("--temperature 10,40", _that(lambda a, b: np.isclose(
        _table(b)[[0, -1], 2], [10.0, 40.0], atol=0.01).all())),
    LAB("--gravity 9.78", _that(lambda a, b: np.allclose(
        (_table(b) - _table(a))[:, 2:].T @ _table(a)[:, 2:] / (_table(a)[:, 2:] ** 2).sum(),
        np.eye(3) * (9.78 / 9.80665 - 1.0), atol=0.4)), *QUIET_BENCH),
    LAB("--fault gap@3:2", _gap("rests.csv", 3.0, 2.0), *USUAL["simulate lab"], "--recording",
        "<out>/rests.csv"),
    LAB("--seed 3", _that(lambda a, b: (_table(a)[:, :2] == _table(b)[:, :2]).all())),
    WORN("--days 0.03", _that(lambda a, b: np.isclose(
        _t(b, "day.csv")[-1] / 86400.0, 0.03, rtol=0.01))),
    WORN("--rate 4", _that(lambda a, b: np.isclose(np.median(np.diff(_t(b, "day.csv"))), 0.25))),
    WORN("--rests 0.1", _that(lambda a, b: _still(b) < 0.8 * _still(a))),
    WORN("--noise 40", _that(lambda a, b: _jitter(b) > 1.8 * _jitter(a))),
    WORN("--no-temperature", _that(lambda a, b: "temperature" not in _channels(b, "day.csv"))),
    WORN("--plant temperature_bias=3,0,0", _planted_bias, *QUIET_DAY),
    WORN("--fault gap@300:200", _gap("day.csv", 300.0, 200.0)),
    WORN("--seed 3", _that(lambda a, b: len(_t(a, "day.csv")) == len(_t(b, "day.csv")))),
    BOARD("--board mimu4444_corners", _that(lambda a, b: [
        len(_channels(o, "log.csv")["acceleration"]) for o in (a, b)] == [4, 8])),
    BOARD("--rests 3", _that(lambda a, b: np.isclose(
        _t(b, "log.csv")[-1] - _t(a, "log.csv")[-1], 5.0, atol=0.2))),
    BOARD("--seconds 8", _that(lambda a, b: np.isclose(
        _t(b, "log.csv")[-1] - _t(a, "log.csv")[-1], 4.0, atol=0.2))),
    BOARD("--rate 40", _that(lambda a, b: np.isclose(np.median(np.diff(_t(b, "log.csv"))), 0.025))),
    BOARD("--twist 200", _that(lambda a, b: np.isclose(
        np.std(_rate(b)) / np.std(_rate(a)), 200.0 / 700.0, rtol=0.4)), *QUIET_LOG),
    BOARD("--noise 100", _that(lambda a, b: np.isclose(
        np.std(_acc(b, "log.csv") - _acc(a, "log.csv")) / MG, 100.0, rtol=0.1)), *QUIET_LOG),
    BOARD("--gyro-noise 5", _that(lambda a, b: np.isclose(
        np.degrees(np.std(_rate(b) - _rate(a))), 5.0, rtol=0.1)), *QUIET_LOG),
    BOARD("--scatter 3", _that(lambda a, b: _scatter(b) > 5.0 * _scatter(a)),
          *USUAL["simulate array"], "--json"),
    BOARD("--plant gyro_scale=0.1", _that(lambda a, b: np.std(_rate(b)) > 1.01 * np.std(_rate(a))),
          *QUIET_LOG),
    BOARD("--fault sign@imu1:y", _that(lambda a, b: _inverted(a, b) == [("imu1", 1)])),
    BOARD("--seed 3", _that(lambda a, b: len(_t(a, "log.csv")) == len(_t(b, "log.csv")))),
    TURNS("--rests 5", _that(lambda a, b: np.isclose(
        _t(b, "turns.csv")[-1] - _t(a, "turns.csv")[-1], 4.1, atol=0.1))),
    TURNS("--rate 50", _that(lambda a, b: np.isclose(
        np.median(np.diff(_t(b, "turns.csv"))), 0.02))),
    TURNS("--noise 100", _that(lambda a, b: np.isclose(
        np.std(_acc(b, "turns.csv") - _acc(a, "turns.csv")) / MG, 100.0, rtol=0.1)), *QUIET_TURNS),
    TURNS("--gyro-noise 5", _that(lambda a, b: np.isclose(
        np.degrees(np.std(_turning(b) - _turning(a))), 5.0, rtol=0.1)), *QUIET_TURNS),
    TURNS("--late 0.1", _that(lambda a, b: np.allclose(
        _turning(b)[10:], _turning(a)[:-10], atol=1e-5)), *QUIET_TURNS),
    TURNS("--plant gyro_g_sensitivity=1", _that(lambda a, b: np.allclose(
        np.degrees(_turning(b) - _turning(a))[:100], 1.0, atol=0.01)), *QUIET_TURNS),
    TURNS("--fault gap@3:2", _gap("turns.csv", 3.0, 2.0)),
    TURNS("--seed 3", _that(lambda a, b: len(_t(a, "turns.csv")) == len(_t(b, "turns.csv")))),
    DESIGN("--full", _every_position, "design", "<thrice.csv>"),
    DESIGN("--recommend 9", _recommended, "design", "--json"),
    DESIGN("--columns inclination=alpha,tool_face=beta", _drilling, "design", "<renamed.csv>",
           "--json"),
    DESIGN("--convention drilling-gravity", _drilling, "design", "<drilling.csv>", "--json"),
    DESIGN("--output <out>/plan.csv", _saved),
)  # fmt: skip


def _still(outcome: Outcome) -> float:
    """Share of the samples whose neighbours are within 30 mg."""
    a = _acc(outcome, "day.csv")
    return float(np.mean(np.abs(np.diff(a, axis=0)).max(axis=1) < 30.0 * MG))


def _jitter(outcome: Outcome) -> float:
    return float(np.median(np.abs(np.diff(_acc(outcome, "day.csv"), axis=0))))


def _rate(outcome: Outcome) -> Array:
    return _channels(outcome, "log.csv")["angular_rate"][0].values


def _scatter(outcome: Outcome) -> float:
    found = np.array(outcome.content["positions_mm"])
    drawn = np.array([[-9, 9, 1], [9, 9, -1], [-9, -9, -1], [9, -9, 1]], float)
    return float(np.std(found - found[0] - (drawn - drawn[0])))


def _inverted(without: Outcome, done: Outcome) -> list[tuple[str, int]]:
    one, two = (_channels(o, "log.csv")["acceleration"] for o in (without, done))
    return [
        (a.triad, k)
        for a, b in zip(one, two, strict=True)
        for k in range(3)
        if not np.allclose(a.values[:, k], b.values[:, k])
        and np.allclose(a.values[:, k], -b.values[:, k])
    ]
