"""What commands write: inputs survive, names are harmless."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner, Result

from imucalib import readers, writers
from imucalib.atomic_file import replaced_atomically
from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.calibration.file import write as write_calibration
from imucalib.calibration.file import write_together
from imucalib.cli import cli
from imucalib.cli import cli as root
from imucalib.errors import UsageError
from imucalib.readers import sha256_of
from imucalib.recording.recording import Channel, Recording
from worlds.mcap_logs import START, cdr, packed, readings, write_log
from worlds.places import ROOT

FORMATS = pytest.mark.parametrize("suffix", [".csv", ".h5", ".mcap"])


def recording(n: int = 400) -> Recording:
    rng = np.random.default_rng(0)
    t = np.arange(n) / 100.0
    channels = {
        f"{name}/acceleration": Channel(
            t,
            np.array([0, 0, 9.8]) + rng.normal(0, 0.02, (n, 3)),
            "m/s2",
            "acceleration",
            name,
            100,
        )
        for name in ("left", "right")
    }
    return Recording(channels, "made", "made", "", start_ns=1_700_000_000_000_000_000)


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    names = ("b_x", "b_y", "b_z")
    stored = tuple(StoredParameter(n, "bias", "sensor", 10.0, 1.0, "mg") for n in names)
    made = Calibration(
        calibrator="lab",
        parameters=stored,
        covariance=np.eye(3),
        raw_unit="m/s2",
        raw_to_si=1.0,
        gravity=9.80665,
        status="ok",
    )
    write_calibration(made, tmp_path / "calibration.yaml")
    return tmp_path / "calibration.yaml"


def call(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments], standalone_mode=False)


def refused(*arguments: object) -> str:
    result = call(*arguments)
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
    writers.write(recording(), path)
    before, was = path.read_bytes(), calibration.read_bytes()
    for output in spellings(path):
        for force in ((), ("--force",)):
            for arguments in (
                ("apply", calibration, path, "-o", output, "--triad", "left"),
                ("convert", path, output),
                ("inspect", path, "--save-mapping", output),
            ):
                assert "the output is the input" in refused(*arguments, *force)
            assert path.read_bytes() == before
    assert "is the input" in refused(
        "inspect", path, "--mapping", calibration, "--save-mapping", calibration, "--force"
    )
    assert calibration.read_bytes() == was


@FORMATS
def test_a_corrected_recording_is_marked(suffix: str, tmp_path: Path, calibration: Path) -> None:
    raw, once = tmp_path / f"raw{suffix}", tmp_path / f"once{suffix}"
    writers.write(recording(), raw)
    assert readers.read(raw).corrections == ()
    assert call("apply", calibration, raw, "-o", once, "--triad", "left").exception is None
    found = readers.read(once)
    assert [(c.triad, c.calibrator, c.sha256) for c in found.corrections] == [
        ("left", "lab", sha256_of(calibration))
    ]
    assert any("left is corrected" in note for note in found.notes)
    assert list(readers.blocks(once, block_samples=100))[-1].corrections == found.corrections

    arguments = ("apply", calibration, once, "-o", tmp_path / f"twice{suffix}", "--triad")
    assert "--again" in refused(*arguments, "left")
    assert not (tmp_path / f"twice{suffix}").exists()
    assert call(*arguments, "right").exception is None
    assert len(readers.read(tmp_path / f"twice{suffix}").corrections) == 2
    insisted = tmp_path / f"again{suffix}"
    arguments = ("apply", calibration, once, "-o", insisted, "--triad", "left", "--again")
    assert call(*arguments).exception is None
    values = [readers.read(p).channels["left/acceleration"].values for p in (raw, once, insisted)]
    np.testing.assert_allclose(values[2] - values[1], values[1] - values[0], atol=1e-9)
    assert abs(values[1] - values[0]).max() > 0.09


@FORMATS
def test_a_mark_survives_conversion_and_new_names(
    suffix: str, tmp_path: Path, calibration: Path
) -> None:
    one = replace(
        recording(), channels={k: c for k, c in recording().channels.items() if c.triad == "left"}
    )
    writers.write(one, tmp_path / "raw.h5")
    assert (
        call("apply", calibration, tmp_path / "raw.h5", "-o", tmp_path / "c.h5").exception is None
    )
    path = tmp_path / f"converted{suffix}"
    assert call("convert", tmp_path / "c.h5", path).exception is None
    mapping = tmp_path / "names.yaml"
    assert call("inspect", path, "--save-mapping", mapping, "-q").exception is None
    mapping.write_text(mapping.read_text().replace("triads: [left]", "triads: [other]"))
    assert "other" in mapping.read_text()
    output = tmp_path / f"second{suffix}"
    assert "--again" in refused("apply", calibration, path, "-o", output, "--mapping", mapping)


def test_a_killed_run_leaves_nothing_for_long(tmp_path: Path) -> None:
    script = (
        "import sys, time, pathlib\n"
        "from imucalib.atomic_file import replaced_atomically\n"
        "with replaced_atomically(sys.argv[1]) as temporary:\n"
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
        with replaced_atomically(target) as temporary:  # another run does not touch a living one's
            temporary.write_bytes(b"1")
        assert len(list(tmp_path.glob(".*"))) == 1
        process.kill()
    assert len(list(tmp_path.glob(".*"))) == 1
    with replaced_atomically(target) as temporary:
        temporary.write_bytes(b"2")
    assert [p.name for p in tmp_path.iterdir()] == ["out.csv"]


@pytest.mark.slow
def test_termination_takes_its_temporary_files_along(tmp_path: Path) -> None:
    source, target = tmp_path / "raw.csv", tmp_path / "out.csv"
    writers.write(recording(300_000), source)
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


def lab(folder: Path, table: Path, *more: str) -> Result:
    gravity = ("--no-loop", "--gravity", "9.8061", "-q")
    return CliRunner().invoke(cli, ["lab", str(table), "-o", str(folder), *gravity, *more])


def bench(folder: Path, name: str) -> Path:
    table = folder / name
    table.write_bytes((ROOT / "sample_logs" / "bench.csv").read_bytes())
    return table


@pytest.mark.slow
def test_results_of_another_input_are_replaced_only_by_force(tmp_path: Path) -> None:
    one, two, out = bench(tmp_path, "a.csv"), bench(tmp_path, "b.csv"), tmp_path / "out"
    assert lab(out, one).exit_code == 0
    assert lab(out, one).exit_code == 0  # the same again
    before = (out / "calibration.yaml").read_bytes()
    refused = lab(out, two)
    assert isinstance(refused.exception, UsageError)
    assert "the calibration of a.csv" in str(refused.exception)
    assert (out / "calibration.yaml").read_bytes() == before
    assert lab(out, two, "--force").exit_code == 0
    (out / "calibration.yaml").write_text("somebody: else\n")
    assert "no calibration" in str(lab(out, two).exception)


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


N = 2000


EVIL = "\x1b]0;owned\x07\x1b[2J\u009b31m\u202e"


STEERING = ["\x1b", "\x07", "\u009b", "\u202e", "\x7f"]


def values() -> np.ndarray:
    return np.array([0, 0, 9.8]) + np.random.default_rng(0).normal(0, 0.02, (N, 3))


def mcap(folder: Path, *, imu: bool = True) -> Path:
    topics = {f"/imu{EVIL}/data": packed(readings(N), cdr)}
    if imu:
        return write_log(folder / "a.mcap", topics)
    schema = ("std_msgs/msg/String", "ros2msg", b"string data")
    return write_log(folder / "a.mcap", {f"/{EVIL}": [(START, bytes(12))]}, schema=schema)


def text(folder: Path) -> Path:
    head = ",".join(["time [s]", *(f"acc{EVIL} {a} [g]" for a in "xyz"), f"other{EVIL}"])
    rows = [f"{k / 100:.2f},0.001,0.002,{0.99 + 0.01 * (k % 3):.3f},1" for k in range(N)]
    (folder / "a.csv").write_text("\n".join([head, *rows]) + "\n")
    return folder / "a.csv"


def hdf5(folder: Path, unit: str = f"furlong{EVIL}") -> Path:
    with h5py.File(folder / "a.h5", "w") as file:
        file[f"s{EVIL}/acc"] = values()
        file[f"s{EVIL}/acc"].attrs["units"] = unit
        file[f"s{EVIL}"].attrs["rate"] = 100.0
    return folder / "a.h5"


def run(*arguments: object) -> str:
    command = [sys.executable, "-m", "imucalib", *map(str, arguments)]
    found = subprocess.run(command, check=False, capture_output=True, timeout=120)
    return (found.stdout + found.stderr).decode("utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        mcap,
        lambda folder: mcap(folder, imu=False),
        text,
        hdf5,
        lambda folder: hdf5(folder, "m/s2"),
    ],
    ids=["mcap", "no imu", "csv", "hdf5 unit", "hdf5"],
)
def test_no_name_steers_the_terminal(make: object, tmp_path: Path) -> None:
    path = make(tmp_path)  # type: ignore[operator]
    for arguments in (
        ("inspect", path),
        ("inspect", path, "--json"),
        ("inspect", path, "--acc", "none"),
        ("convert", path, tmp_path / "b.csv"),
        ("convert", path, tmp_path / "b.h5", "--json"),
    ):
        told = run(*arguments)
        assert told
        assert not [c for c in STEERING if c in told], (arguments, told)


@pytest.mark.slow
def test_json_keeps_the_name_itself(tmp_path: Path) -> None:
    told = json.loads(run("inspect", hdf5(tmp_path, "m/s2"), "--json", "--quiet"))
    assert EVIL in told["channels"][0]["name"]


@pytest.mark.parametrize(
    "name", ["=1+1", "+1", "-1", "@sum", "a,b", 'a"b', " =1", "a\n=1", "a\r=1"]
)
def test_a_written_table_holds_no_formula(name: str, tmp_path: Path) -> None:
    channel = Channel(np.arange(N) / 100.0, values(), "m/s2", "acceleration", name, 100.0)
    path = tmp_path / "a.csv"
    writers.write(Recording({f"{name}/acceleration": channel}, "", "", ""), path)
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert len(rows[1]) == 4
    assert len(rows) == N + 2
    assert not [c for row in rows[:2] for c in row if c.lstrip()[:1] in tuple("=+-@")]
    (back,) = readers.read(path).channels.values()
    np.testing.assert_array_equal(back.values, channel.values)


G = 9.80665


def exports_run(*arguments: object) -> Result:
    return CliRunner().invoke(root, [str(a) for a in arguments], standalone_mode=False)


def skewed(path: Path) -> Path:
    """Norms of a sensor whose axes are 3° off square, in g, with hardly any noise."""
    rng = np.random.default_rng(4)
    force = rng.normal(size=(30, 3))
    force /= np.linalg.norm(force, axis=1, keepdims=True)
    reading = force @ np.array([[1, 0, 0], [0.05, 1, 0], [0, 0.05, 1.0]]).T
    reading += 1e-5 * rng.normal(size=reading.shape)
    rows = "\n".join(",".join(f"{v:.7f}" for v in row) for row in reading)
    path.write_text(f"ax_g,ay_g,az_g\n{rows}\n")
    return path


def test_a_form_that_loses_too_much_is_left_out_and_the_rest_is_written(tmp_path: Path) -> None:
    table, out = skewed(tmp_path / "norms.csv"), tmp_path / "out"
    usual = ("lab", table, "--reference", "norm", "--no-loop", "-q", "--export", "c-header")
    result = exports_run(*usual, "--export", "px4", "-o", out)
    assert result.exception is None, result.exception
    assert result.return_value == 1
    assert "error: px4 loses" in result.stderr
    assert "--force" in result.stderr
    assert {p.name for p in out.iterdir()} == {
        "calibration.yaml", "report.html", "report.json", "imucal_calibration.h"
    }  # fmt: skip
    forced = exports_run(*usual, "--export", "px4", "-o", out, "--force")
    assert forced.return_value == 0
    assert (out / "imucal_px4.params").read_text().count("\tCAL_ACC0_") == 6
