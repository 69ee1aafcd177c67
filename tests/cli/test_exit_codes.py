"""The program as a process: faults, streams that end, names of any bytes, full disks; its codes."""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from imucalib import cli, writers
from imucalib.errors import CRASH_EXIT_CODE, EXIT_CODES, ImucalError, Undetermined
from imucalib.recording.recording import Channel, Recording
from worlds import command
from worlds.places import ROOT

N = 20_000


@pytest.fixture
def log(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    values = np.array([0, 0, 9.8]) + rng.normal(0, 0.02, (N, 3))
    channel = Channel(np.arange(N) / 100.0, values, "m/s2", "acceleration", "imu0", 100.0)
    writers.write(Recording({"imu0/acceleration": channel}, "", "", ""), tmp_path / "log.h5")
    return tmp_path / "log.h5"


def run(*arguments: object, **options: object) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "imucalib", *map(os.fspath, map(_plain, arguments))]
    done = subprocess.run(command, check=False, stderr=subprocess.PIPE, timeout=120, **options)
    # On a slow machine the work shows that it goes on.
    done.stderr = re.sub(rb"(?m)^[a-z]+: \d+ s\n", b"", done.stderr)
    return done


def _plain(argument: object) -> str | bytes:
    return argument if isinstance(argument, str | bytes) else os.fspath(argument)  # type: ignore[call-overload, no-any-return]


def test_a_fault_of_the_program_is_no_broken_limit(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def fault(*_: object, **__: object) -> None:
        raise ZeroDivisionError("one\ntwo")

    monkeypatch.setattr(cli.cli, "main", fault)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == CRASH_EXIT_CODE == 70
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "ZeroDivisionError: one two" in told
    (kept,) = tmp_path.glob("imucal-crash-*.txt")
    assert str(kept) in told
    assert "in fault" in kept.read_text()


@pytest.mark.slow
def test_a_closed_stdout_is_no_fault(log: Path) -> None:
    found = run("inspect", log, preexec_fn=lambda: os.close(1))
    assert (found.returncode, found.stderr) == (0, b"")


@pytest.mark.slow
def test_a_full_stdout_is_told(log: Path) -> None:
    with open("/dev/full", "wb") as full:
        found = run("inspect", log, stdout=full)
    assert found.returncode == 3
    assert b"space" in found.stderr


def test_a_reader_that_leaves_is_no_broken_limit() -> None:
    ours, theirs = os.pipe()
    os.close(ours)
    found = run("effects", stdout=theirs)
    os.close(theirs)
    assert (found.returncode, found.stderr) == (141, b"")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [b".h5", b".csv", b".mcap"])
def test_names_of_any_bytes(log: Path, suffix: bytes) -> None:
    odd = os.fsencode(log.parent) + b"/\xff\xfe"
    os.rename(log, odd + b".h5")
    found = run("convert", odd + b".h5", odd + b"2" + suffix, stdout=subprocess.PIPE)
    assert (found.returncode, found.stderr) == (0, b"")
    plain = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    found = run("inspect", odd + b"2" + suffix, stdout=subprocess.PIPE, env=plain)
    assert (found.returncode, found.stderr) == (0, b"")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["h5", "csv", "mcap"])
def test_a_file_that_may_not_grow_ends_cleanly(log: Path, suffix: str) -> None:
    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    target = log.parent / f"out.{suffix}"
    found = run("convert", log, target, stdout=subprocess.PIPE, preexec_fn=limited)
    assert found.returncode == 2
    assert found.stderr.count(b"\n") == 1
    assert b"too large" in found.stderr
    assert [p.name for p in log.parent.iterdir()] == ["log.h5"]


@pytest.mark.parametrize("rows", [1, 2, 3, 4])
@pytest.mark.parametrize("option", [[], ["--no-loop"]])
def test_a_sheet_of_too_few_rows_is_told_so(option: list[str], rows: int, tmp_path: Path) -> None:
    lines = [f"{10 * k},0,4.{k},97{8 - k},{57 + 170 * k}" for k in range(rows)]
    path = tmp_path / "few.csv"
    path.write_text("\n".join(["inclination,tool_face,x_mg,y_mg,z_mg", *lines]) + "\n")
    done = command.run("lab", path, "-o", tmp_path / "out", *option)
    assert isinstance(done.exception, Undetermined)
    assert done.exception.exit_code == 4


def test_the_table_of_codes_is_that_of_the_errors() -> None:
    def kinds(one: type[ImucalError]) -> set[int]:
        return {one.exit_code}.union(*map(kinds, one.__subclasses__()))

    assert kinds(ImucalError) <= set(EXIT_CODES)


def test_pages_say_the_codes_that_are() -> None:
    def plain(text: str) -> str:
        return " ".join(text.replace("`", "").split())

    says = ", ".join(f"{code} {says}" for code, says in EXIT_CODES.items())
    assert f"Exit codes: {says}." in plain((ROOT / "README.md").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    table = dict(re.findall(r"^\| (\d+) \| (.+) \|$", page, re.M))
    assert {int(code): plain(text) for code, text in table.items()} == EXIT_CODES


@pytest.mark.parametrize("page", [ROOT / "README.md", *sorted(ROOT.glob("docs/**/*.md"))])
def test_a_code_in_prose_is_one_of_them(page: Path) -> None:
    """Codes beside commands are those that they end with: pages run."""
    said = re.findall(r"exit codes?(?: is)? (\d+)", page.read_text(encoding="utf-8"))
    assert {int(code) for code in said} <= {*EXIT_CODES, 123}  # 123 is of xargs
