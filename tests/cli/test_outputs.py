"""What commands write: inputs survive, names are harmless."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from imucalib import readers, writers
from imucalib.atomic_file import replace_atomically
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import to_yaml, write_together, write_whole
from imucalib.core.fit import StoredParameter
from imucalib.errors import UsageError
from imucalib.file_hash import sha256_of
from imucalib.recording.recording import Channel, Recording
from imucalib.recording.yaml_text import dump, load
from worlds.command import run
from worlds.mcap_logs import START, cdr, packed, readings, write_log
from worlds.places import ROOT

FORMATS = pytest.mark.parametrize("suffix", [".csv", ".h5", ".mcap"])
N = 2000


def values(n: int = N) -> np.ndarray:
    return np.array([0, 0, 9.8]) + np.random.default_rng(0).normal(0, 0.02, (n, 3))


def recording(*names: str, n: int = 400) -> Recording:
    channels = {
        f"{name}/acceleration": Channel(
            np.arange(n) / 100.0, values(n), "m/s2", "acceleration", name, 100
        )
        for name in names
    }
    return Recording(channels, "made", "made", "", start_ns=1_700_000_000_000_000_000)


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    names = ("b_x", "b_y", "b_z")
    made = Calibration(
        calibrator="lab",
        parameters=tuple(StoredParameter(n, "bias", "sensor", 10.0, 1.0, "mg") for n in names),
        covariance=np.eye(3),
        raw_unit="m/s2",
        raw_to_si=1.0,
        gravity=9.80665,
        status="ok",
    )
    write_whole(tmp_path / "calibration.yaml", to_yaml(made))
    return tmp_path / "calibration.yaml"


def refused(*arguments: object) -> str:
    result = run(*arguments)
    assert isinstance(result.exception, UsageError), (result.exception, result.output)
    return str(result.exception)


def spellings(path: Path) -> list[Path]:
    hard, soft = path.with_name("hard" + path.suffix), path.with_name("soft" + path.suffix)
    os.link(path, hard)
    soft.symlink_to(path)
    (path.parent / "d").mkdir()
    return [path, path.parent / "d" / ".." / path.name, soft, hard]


@FORMATS
def test_no_output_is_an_input(suffix: str, tmp_path: Path, calibration: Path) -> None:
    path = tmp_path / f"raw{suffix}"
    writers.write(recording("left"), path)
    before, was = path.read_bytes(), calibration.read_bytes()
    for output in spellings(path):
        for arguments in (
            ("apply", calibration, path, "-o", output, "--sensor", "left"),
            ("convert", path, output, "--force"),
            ("inspect", path, "--save-mapping", output, "--force"),
        ):
            assert "the output is the input" in refused(*arguments)
        assert path.read_bytes() == before
    names = ("--mapping", calibration, "--save-mapping", calibration, "--force")
    assert "is the input" in refused("inspect", path, *names)
    assert calibration.read_bytes() == was


@FORMATS
def test_a_corrected_recording_is_marked(suffix: str, tmp_path: Path, calibration: Path) -> None:
    raw, once = tmp_path / f"raw{suffix}", tmp_path / f"once{suffix}"
    writers.write(recording("left", "right"), raw)
    assert readers.read(raw).corrections == ()
    assert run("apply", calibration, raw, "-o", once, "--sensor", "left").exception is None
    found = readers.read(once)
    assert [(c.triad, c.calibrator, c.sha256) for c in found.corrections] == [
        ("left", "lab", sha256_of(calibration))
    ]
    assert any("left is corrected" in note for note in found.notes)
    assert list(readers.blocks(once, block_samples=100))[-1].corrections == found.corrections
    twice = ("apply", calibration, once, "-o", tmp_path / f"twice{suffix}", "--sensor")
    assert "--again" in refused(*twice, "left")
    assert not (tmp_path / f"twice{suffix}").exists()
    assert run(*twice, "right").exception is None
    assert len(readers.read(tmp_path / f"twice{suffix}").corrections) == 2
    insisted = tmp_path / f"again{suffix}"
    again = ("apply", calibration, once, "-o", insisted, "--sensor", "left", "--again")
    assert run(*again).exception is None
    sizes = [readers.read(p).channels["left/acceleration"].values for p in (raw, once, insisted)]
    np.testing.assert_allclose(sizes[2] - sizes[1], sizes[1] - sizes[0], atol=1e-9)
    assert abs(sizes[1] - sizes[0]).max() > 0.09


@FORMATS
def test_a_mark_survives_conversion_and_new_names(
    suffix: str, tmp_path: Path, calibration: Path
) -> None:
    raw, corrected = tmp_path / "raw.h5", tmp_path / "c.h5"
    writers.write(recording("left"), raw)
    assert run("apply", calibration, raw, "-o", corrected).exception is None
    path, mapping = tmp_path / f"converted{suffix}", tmp_path / "names.yaml"
    assert run("convert", corrected, path).exception is None
    assert run("inspect", path, "--save-mapping", mapping, "-q").exception is None
    mapping.write_text(mapping.read_text().replace("triads: [left]", "triads: [other]"))
    assert "other" in mapping.read_text()
    output = tmp_path / f"second{suffix}"
    assert "--again" in refused("apply", calibration, path, "-o", output, "--mapping", mapping)


def test_a_killed_run_leaves_nothing_for_long(tmp_path: Path) -> None:
    script = (
        "import sys, time\n"
        "from imucalib.atomic_file import replace_atomically\n"
        "with replace_atomically(sys.argv[1]) as temporary:\n"
        "    temporary.write_bytes(b'x' * 100)\n"
        "    print('there', flush=True)\n"
        "    time.sleep(60)\n"
    )
    target = tmp_path / "out.csv"
    with subprocess.Popen(
        [sys.executable, "-c", script, target], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        with replace_atomically(target) as temporary:  # another run does not touch a living one's
            temporary.write_bytes(b"1")
        assert len(list(tmp_path.glob(".*"))) == 1
        process.kill()
    assert len(list(tmp_path.glob(".*"))) == 1
    with replace_atomically(target) as temporary:
        temporary.write_bytes(b"2")
    assert [p.name for p in tmp_path.iterdir()] == ["out.csv"]


@pytest.mark.slow
def test_termination_takes_its_temporary_files_along(tmp_path: Path) -> None:
    source, target = tmp_path / "raw.csv", tmp_path / "out.csv"
    writers.write(recording("left", n=300_000), source)
    command = [sys.executable, "-m", "imucalib", "convert", str(source), str(target)]
    with subprocess.Popen(command, stderr=subprocess.PIPE) as process:
        end = time.monotonic() + 60
        while not list(tmp_path.glob(".out.csv.*.tmp")):
            assert process.poll() is None
            assert time.monotonic() < end
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 128 + signal.SIGTERM
    assert [p.name for p in tmp_path.iterdir()] == ["raw.csv"]


@pytest.mark.slow
def test_results_of_another_input_are_replaced_only_by_force(tmp_path: Path) -> None:
    out = tmp_path / "out"
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_bytes((ROOT / "sample_logs" / "bench.csv").read_bytes())

    def lab(name: str, *more: str) -> str:
        result = run("lab", tmp_path / name, "-o", out, "--no-loop", "-q", *more)
        return str(result.exception or "")

    assert lab("a.csv") == lab("a.csv") == ""  # the same again
    before = (out / "calibration.yaml").read_bytes()
    assert "the calibration of a.csv" in lab("b.csv")
    assert (out / "calibration.yaml").read_bytes() == before
    assert lab("b.csv", "--force") == ""
    (out / "calibration.yaml").write_text("somebody: else\n")
    assert "no calibration" in lab("b.csv")


def test_files_of_one_run_appear_together_or_not_at_all(tmp_path: Path) -> None:
    kept, blocked, new = (tmp_path / n for n in ("calibration.yaml", "report.html", "report.json"))
    kept.write_text("before")
    blocked.mkdir()
    with pytest.raises(UsageError):
        write_together({kept: "after", new: "after", blocked: "after"})
    assert kept.read_text() == "before"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["calibration.yaml", "report.html"]
    blocked.rmdir()
    write_together({kept: "after", new: "after", blocked: "after"})
    assert {p.read_text() for p in tmp_path.iterdir()} == {"after"}


EVIL = "\x1b]0;owned\x07\x1b[2J\u009b31m\u202e"
STEERING = ["\x1b", "\x07", "\u009b", "\u202e", "\x7f"]


def mcap(folder: Path) -> Path:
    return write_log(folder / "a.mcap", {f"/imu{EVIL}/data": packed(readings(N), cdr)})


def no_imu(folder: Path) -> Path:
    schema = ("std_msgs/msg/String", "ros2msg", b"string data")
    return write_log(folder / "a.mcap", {f"/{EVIL}": [(START, bytes(12))]}, schema=schema)


def text(folder: Path) -> Path:
    head = ",".join(["time [s]", *(f"acc{EVIL} {a} [g]" for a in "xyz"), f"other{EVIL}"])
    rows = [f"{k / 100:.2f},0.001,0.002,{0.99 + 0.01 * (k % 3):.3f},1" for k in range(N)]
    (folder / "a.csv").write_text("\n".join([head, *rows]) + "\n")
    return folder / "a.csv"


def hdf5(folder: Path) -> Path:
    with h5py.File(folder / "a.h5", "w") as file:
        file[f"s{EVIL}/acc"] = values()
        file[f"s{EVIL}/acc"].attrs["units"] = "m/s2"
        file[f"s{EVIL}"].attrs["rate"] = 100.0
    return folder / "a.h5"


@pytest.mark.slow
@pytest.mark.parametrize("make", [mcap, no_imu, text, hdf5])
def test_no_name_steers_the_terminal(make: Callable[[Path], Path], tmp_path: Path) -> None:
    path = make(tmp_path)
    for arguments in (
        ("inspect", path),
        ("inspect", path, "--json"),
        ("inspect", path, "--acc", "none"),
        ("convert", path, tmp_path / "b.csv"),
        ("convert", path, tmp_path / "b.h5", "--json"),
    ):
        command = [sys.executable, "-m", "imucalib", *map(str, arguments)]
        found = subprocess.run(command, check=False, capture_output=True, timeout=120)
        told = (found.stdout + found.stderr).decode("utf-8")
        assert told
        assert not [c for c in STEERING if c in told], (arguments, told)
    if make is hdf5:
        content = json.loads(run("inspect", path, "--json", "--quiet").stdout)
        assert EVIL in content["channels"][0]["name"]


@pytest.mark.parametrize(
    "name", ["=1+1", "+1", "-1", "@sum", "a,b", 'a"b', " =1", "a\n=1", "a\r=1"]
)
def test_a_written_table_holds_no_formula(name: str, tmp_path: Path) -> None:
    path, made = tmp_path / "a.csv", recording(name, n=N)
    writers.write(replace(made, start_ns=None), path)
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert len(rows[1]) == 4
    assert len(rows) == N + 2
    assert not [c for row in rows[:2] for c in row if c.lstrip()[:1] in tuple("=+-@")]
    (back,) = readers.read(path).channels.values()
    np.testing.assert_array_equal(back.values, values())


def test_a_form_that_loses_too_much_is_left_out_and_the_rest_is_written(tmp_path: Path) -> None:
    """Of a sensor whose axes are 3° off square, in g, with hardly any noise."""
    rng = np.random.default_rng(4)
    force = rng.normal(size=(30, 3))
    force /= np.linalg.norm(force, axis=1, keepdims=True)
    reading = force @ np.array([[1, 0, 0], [0.05, 1, 0], [0, 0.05, 1.0]]).T
    reading += 1e-5 * rng.normal(size=reading.shape)
    table, out = tmp_path / "norms.csv", tmp_path / "out"
    np.savetxt(table, reading, "%.7f", ",", header="ax_g,ay_g,az_g", comments="")
    usual = ("lab", table, "--reference", "norm", "--no-loop", "-q", "--export", "c-header")
    result = run(*usual, "--export", "px4", "-o", out)
    assert result.exception is None, result.exception
    assert result.return_value == 1
    assert "error: px4 loses" in result.stderr
    assert "--force" in result.stderr
    whole = {"calibration.yaml", "report.html", "report.json", "imucal_calibration.h"}
    assert {p.name for p in out.iterdir()} == whole
    assert run(*usual, "--export", "px4", "-o", out, "--force").return_value == 0
    assert (out / "imucal_px4.params").read_text().count("\tCAL_ACC0_") == 6


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["b_x", "gravity_m_per_s2", "to_m_per_s2"])
def test_a_calibration_that_is_no_number_is_refused(
    name: str, value: float, calibration: Path
) -> None:
    content = load(calibration)
    place = {"b_x": content["parameters"][0], "to_m_per_s2": content["raw"]}.get(name, content)
    place["value" if name == "b_x" else name] = value
    calibration.write_text(dump(content))
    result = run("validate", calibration)
    assert result.return_value == 3
    assert name in str(result.exception)
