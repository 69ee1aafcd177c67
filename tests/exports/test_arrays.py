"""An array's calibration in the forms of other programs, each read back by somebody else's reader.

The board is in plain numpy; what it reads without noise must be what the form's own equation says.
"""

from __future__ import annotations

import re
import shutil
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.errors import LimitBroken, UnreadableInput, UsageError
from imucalib.exports import demand_carried, export
from imucalib.exports.imus import state_noise, state_walks
from worlds.rigid_board import DEG, Board, G, Moves, board, calibration, readings
from worlds.targets import by_kalibr, by_octave, by_opencv

FORMS = ("kalibr", "openvins", "ros2-static", "urdf", "matlab", "c-header")


@pytest.fixture(scope="module")
def made() -> Board:
    rng = np.random.default_rng(2)
    return replace(
        board(rng, chips=5),
        sigma=np.full(5, 1e-12),
        gyro_sigma=np.full(5, 1e-12),
        element=3e-4 * rng.normal(size=(3, 3)),
        by_force=0.2 * DEG / G * rng.normal(size=(5, 3, 3)),
    )


@pytest.fixture(scope="module")
def moves() -> Moves:
    rng = np.random.default_rng(3)
    force, rate, spin = (rng.normal(size=(40, 3)) * size for size in (10.0, 8.0, 100.0))
    return Moves(np.arange(40.0), force, rate, spin, rate)


def plain(made: Board) -> Calibration:
    """A file whose interval and noise are stated."""
    whole = calibration(made)
    triads = tuple(replace(t, noise=0.05, gyro_noise=2e-3) for t in whole.triads)
    facts = {**whole.facts, "sample_interval_s": 0.01, "not_undone": [
        {"effect": "gyro_cubic", "rms": 0.25, "unit": "deg/s"},
        {"effect": "gyro_g_sensitivity", "rms": 0.5, "unit": "deg/s"},
    ]}  # fmt: skip
    return replace(whole, triads=triads, facts=facts)


def loaded(made: Board, form: str) -> dict[str, Any]:
    """By IMU what its target reads of its file."""
    files = export(state_walks(plain(made), 1e-3, 2e-5), "log.mcap", form).files
    assert list(files) == [t.name for t in plain(made).triads]
    for text in files.values():
        assert "log.mcap" in text
        assert "gyro cubic" in text
    read = by_kalibr if form == "kalibr" else by_opencv
    return {name: read(text) for name, text in files.items()}


def felt(motion: Moves, r: Array) -> Array:
    """(T, 3) m/s² at r, in board axes."""
    w, a = motion.rate, motion.spin
    return np.asarray(motion.force + np.cross(w, np.cross(w, r)) + np.cross(a, r))


def test_kalibr_says_what_every_imu_reads(made: Board, moves: Moves) -> None:
    acceleration, rate = readings(made, moves, np.random.default_rng(0))
    for k, block in enumerate(loaded(made, "kalibr").values()):
        own = {n: np.array(v) for n, v in (*block["accelerometers"].items(),
                                           *block["gyroscopes"].items()) if n != "M"}  # fmt: skip
        M, M_gyro = (np.array(block[p]["M"]) for p in ("accelerometers", "gyroscopes"))
        T = np.array(block["T_i_b"])
        C, r = T[:3, :3], -T[:3, :3].T @ T[:3, 3]
        assert r == pytest.approx(made.places[k], abs=1e-9)
        for triangle in (M, M_gyro):
            assert np.triu(triangle, 1) == pytest.approx(np.zeros((3, 3)), abs=1e-12)
            assert (np.diag(triangle) > 0.9).all()
        for turn in (C, own["C_gyro_i"]):
            assert turn @ turn.T == pytest.approx(np.eye(3))
            assert np.linalg.det(turn) == pytest.approx(1.0)
        force = np.zeros((40, 3))
        for axis, name in enumerate("xyz"):
            force[:, axis] = (felt(moves, r + C.T @ own[f"r{name}_i"]) @ C.T)[:, axis]
        bias = made.biases[k] @ made.turns[k]
        assert force @ M.T + bias == pytest.approx(acceleration[:, k], abs=2e-2)
        gyro = own["C_gyro_i"] @ C
        turned = moves.rate @ gyro.T @ M_gyro.T + felt(moves, r) @ gyro.T @ own["A"].T
        turned = turned + made.gyro_biases[k] @ made.turns[k]
        assert turned == pytest.approx(rate[:, k], abs=2e-3)
        assert block["accelerometer_noise_density"] == pytest.approx(0.05 * 0.1)
        assert block["gyroscope_noise_density"] == pytest.approx(2e-3 * 0.1)
        assert block["update_rate"] == pytest.approx(100.0)
        assert block["gyroscope_random_walk"] == 2e-5


def test_openvins_says_what_every_imu_reads(made: Board, moves: Moves) -> None:
    straight = replace(made, element=np.zeros((3, 3)))
    acceleration, rate = readings(straight, moves, np.random.default_rng(0))
    for k, block in enumerate(loaded(straight, "openvins").values()):
        Tw, Ta, Tg, to_gyro, to_acc, T = (
            np.array(block[n]) for n in ("Tw", "Ta", "Tg", "R_IMUtoGYRO", "R_IMUtoACC", "T_i_b")
        )
        turn = T[:3, :3]
        force = felt(moves, -turn.T @ T[:3, 3]) @ turn.T
        bias = made.biases[k] @ made.turns[k]
        assert force @ to_acc.T @ Ta.T + bias == pytest.approx(acceleration[:, k], abs=1e-6)
        turned = moves.rate @ turn.T @ to_gyro.T @ Tw.T + force @ Tg.T
        turned = turned + made.gyro_biases[k] @ made.turns[k]
        assert turned == pytest.approx(rate[:, k], abs=2e-3)
        assert np.array_equal(to_acc, np.eye(3))
        assert block["model"] == "kalibr"


def test_noise_is_what_was_measured(made: Board, tmp_path: Path) -> None:
    path = tmp_path / "imu.yaml"
    path.write_text("accelerometer_random_walk: 1.5e-4\nupdate_rate: 200.0\n")
    with pytest.raises(UsageError, match="needs gyroscope_random_walk of"):
        export(state_noise(plain(made), path), "log.mcap", "kalibr")
    path.write_text(
        path.read_text() + "gyroscope_random_walk: 2.0e-5\nupper_limits: [gyroscope_random_walk]\n"
    )
    for text in export(state_noise(plain(made), path), "log.mcap", "kalibr").files.values():
        block = by_kalibr(text)
        assert block["accelerometer_random_walk"] == 1.5e-4
        assert block["update_rate"] == 200.0
        assert block["gyroscope_random_walk"] == 2e-5
        assert "# gyroscope_random_walk: an upper limit (95 %), rad/s2/sqrt(Hz)" in text
    path.write_text("imu9:\n  update_rate: 200.0\n")
    with pytest.raises(UnreadableInput, match="imu9"):
        state_noise(plain(made), path)
    path.write_text("a: 1\n")
    with pytest.raises(UnreadableInput, match="no noise"):
        state_noise(plain(made), path)


def quaternion(q: Array) -> Array:
    """(3, 3) of x, y, z, w."""
    x, y, z, w = q
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross)


def angles(rpy: Array) -> Array:
    """(3, 3) about fixed x, then y, then z."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(z @ y @ x)


def check_frames(made: Board, found: dict[str, tuple[Array, Array]]) -> None:
    assert set(found) == {
        *made.names, *(f"{n}_package" for n in made.names), "fused"
    }  # fmt: skip
    for k, name in enumerate(made.names):
        place, turn = found[name]
        assert place == pytest.approx(made.places[k], abs=1e-9)
        assert turn == pytest.approx(np.eye(3))
        _, turn = found[f"{name}_package"]
        # A package's axes within what its gain's skew leaves open.
        assert turn == pytest.approx(made.turns[k], abs=0.1)
        block = np.array(loaded(made, "kalibr")[name]["T_i_b"])
        assert turn == pytest.approx(block[:3, :3].T, abs=1e-7)
    place, turn = found["fused"]
    assert place == pytest.approx(made.places.mean(axis=0), abs=1e-9)
    assert turn == pytest.approx(np.eye(3))


def test_ros_2_launches_the_transforms(made: Board) -> None:
    root = ET.fromstring(export(plain(made), "log.mcap", "ros2-static").text)
    assert root.tag == "launch"
    found = {}
    for node in root.iter("node"):
        assert (node.get("pkg"), node.get("exec")) == ("tf2_ros", "static_transform_publisher")
        words = str(node.get("args")).split()
        given = dict(zip(words[::2], words[1::2], strict=True))
        assert given["--frame-id"] == "board"
        place = np.array([float(given[f"--{a}"]) for a in "xyz"])
        turn = quaternion(np.array([float(given[f"--q{a}"]) for a in "xyzw"]))
        found[given["--child-frame-id"]] = (place, turn)
    check_frames(made, found)


def test_urdf_joins_the_links(made: Board) -> None:
    root = ET.fromstring(export(plain(made), "log.mcap", "urdf").text)
    links = {link.get("name") for link in root.iter("link")}
    found = {}
    for joint in root.iter("joint"):
        child, parent, origin = (joint.find(tag) for tag in ("child", "parent", "origin"))
        assert child is not None
        assert parent is not None
        assert origin is not None
        assert joint.get("type") == "fixed"
        assert {child.get("link"), parent.get("link")} <= links
        place, rpy = (np.array(str(origin.get(n)).split(), dtype=float) for n in ("xyz", "rpy"))
        found[str(child.get("link"))] = (place, angles(rpy))
    check_frames(made, found)


def test_matlab_corrects_what_was_read(made: Board, moves: Moves) -> None:
    straight = replace(made, element=np.zeros((3, 3)), by_force=None)
    acceleration, rate = readings(straight, moves, np.random.default_rng(0))
    text = export(plain(straight), "log.mcap", "matlab").text
    assigned = re.findall(r"^(\w+)(\([^)]*\))? = \[(.*)\];$", text, flags=re.M)
    value = {n + index: np.array([r.split() for r in body.split("; ")], dtype=float)
             for n, index, body in assigned}  # fmt: skip
    assert pytest.approx(made.places) == value["r"].T
    for k in range(5):
        force = acceleration[:, k] @ value[f"M(:,:,{k + 1})"].T + value[f"b(:,{k + 1})"].T
        assert force == pytest.approx(felt(moves, made.places[k]), abs=1e-6)
        turned = rate[:, k] @ value[f"gyro_M(:,:,{k + 1})"].T + value[f"gyro_b(:,{k + 1})"].T
        assert turned == pytest.approx(moves.rate, abs=1e-6)


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="no Octave")
def test_octave_corrects_what_was_read(made: Board, moves: Moves) -> None:
    straight = replace(made, element=np.zeros((3, 3)), by_force=None)
    acceleration, rate = readings(straight, moves, np.random.default_rng(0))
    script = export(plain(straight), "log.mcap", "matlab").text
    for k in range(5):
        rows = (acceleration[7, k], rate[7, k])
        read = [f"[{' '.join(f'{v:.17g}' for v in row)}]'" for row in rows]
        force, turned, place, name = by_octave(
            script,
            f"(M(:,:,{k + 1}) * {read[0]} + b(:,{k + 1}))'",
            f"(gyro_M(:,:,{k + 1}) * {read[1]} + gyro_b(:,{k + 1}))'",
            f"r(:,{k + 1})'",
            f"names{{{k + 1}}}",
        )
        assert force == pytest.approx(felt(moves, made.places[k])[7], abs=1e-6)
        assert turned == pytest.approx(moves.rate[7], abs=1e-6)
        assert place == pytest.approx(made.places[k])
        assert name == f"imu{k}"


@pytest.mark.parametrize("form", FORMS)
def test_what_is_lost_stands_in_the_file(made: Board, form: str) -> None:
    known = state_walks(plain(replace(made, late=1.5e-3)), 1e-3, 2e-5)
    late = export(known, "log -- 1.mcap", form)
    assert late.lost
    assert not any("_" in text.split(",")[0] for text in late.lost)
    if form in ("kalibr", "openvins"):
        assert any("1.500 ms" in text for text in late.lost)
        for text in late.lost:
            assert text in late.text
    if form in ("ros2-static", "urdf"):
        assert ET.fromstring(late.text) is not None


@pytest.mark.parametrize("form", ["kalibr", "openvins", "ros2-static", "urdf"])
def test_left_handed_sensors_and_single_ones_are_refused(made: Board, form: str) -> None:
    whole = plain(made)
    mirrored = replace(whole.triads[0], gain=whole.triads[0].gain @ np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(UsageError, match="left-handed"):
        export(replace(whole, triads=(mirrored, *whole.triads[1:])), "x", form)
    with pytest.raises(UsageError, match="one accelerometer"):
        export(replace(whole, triads=(), calibrator="lab"), "x", form)


@pytest.mark.parametrize("effect", ["gyro_cubic", "gyro_delay"])
def test_of_an_array_the_rates_of_motion_count(effect: str) -> None:
    whole = calibration(board(np.random.default_rng(0), chips=3))
    rate = {"unit": "deg/s", "raw": 1.3, "final": 0.5, "held_out": {"final": 0.5}}
    facts = {"not_undone": [{"effect": effect, "rms": 9.0, "unit": "deg/s"}], "errors": [rate]}
    known = state_walks(replace(whole, facts={**whole.facts, "sample_interval_s": 0.01, **facts}),
                       1e-3, 2e-5)  # fmt: skip
    for form in ("c-header", "kalibr", "openvins"):
        made = export(known, "x", form)
        assert (made.loss, made.rate_loss) == (0.0, 9.0)
        with pytest.raises(LimitBroken, match=r"9 deg/s, more than 1.2 .*--largest-loss 0,9`"):
            demand_carried(made, form, known, None)
        demand_carried(made, form, known, 0.0, 9.0)
        with pytest.raises(LimitBroken):
            demand_carried(made, form, known, None, 8.9)
    # A frame loses no reading, and the script holds the delay.
    assert export(known, "x", "urdf").rate_loss == 0.0
    held = export(known, "x", "matlab").rate_loss
    assert held == (0.0 if effect == "gyro_delay" else 9.0)
