"""Errors as who gets them reads them: no numbers of the system, no list without an end."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from imucalib import cli
from imucalib.errors import ImucalError
from worlds.places import SAMPLES


def failed(*words: object) -> ImucalError:
    done = CliRunner().invoke(cli.cli, [str(w) for w in words], standalone_mode=False)
    assert isinstance(done.exception, ImucalError)
    return done.exception


def test_a_manifest_that_is_not_there(tmp_path: Path) -> None:
    error = failed("batch", tmp_path / "none.txt", "-o", tmp_path / "out")
    assert error.what == "no such manifest"
    assert "Errno" not in str(error)
    assert error.remedy


def test_entries_that_are_not_there(tmp_path: Path) -> None:
    error = failed("collect", tmp_path / "none", "-o", tmp_path / "c.csv")
    assert error.what == "no such folder"
    empty = failed("collect", tmp_path, "-o", tmp_path / "c.csv")
    assert "no entries" in empty.what
    assert "imucal batch" in empty.remedy


def test_a_table_of_many_columns_without_a_meaning_is_told_briefly(tmp_path: Path) -> None:
    path = tmp_path / "words.csv"
    path.write_text("\n".join(",".join(str(7 * r + c) for c in range(40)) for r in range(9)))
    lines = str(failed("convert", path, tmp_path / "o.h5")).splitlines()
    assert len(lines) <= 16
    assert "and 28 more" in str(lines)


def test_many_missing_imus_are_counted(tmp_path: Path) -> None:
    error = failed("array", SAMPLES / "rests.mcap", "--board", "mimu4444")
    assert "1 accelerometer (imu0)" in error.what
    assert "and 23 more" in error.what
    assert len(error.what) < 160


@pytest.mark.parametrize("kind", ["lab", "actigraph", "array"])
def test_a_simulation_takes_no_other_files_place(kind: str, tmp_path: Path) -> None:
    target = tmp_path / "measured.csv"
    target.write_text("measured")
    error = failed("simulate", kind, target)
    assert "there already" in error.what
    assert target.read_text() == "measured"
