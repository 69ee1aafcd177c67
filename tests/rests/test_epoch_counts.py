"""Files of activity counts look like recordings and are none: refused in words that help."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from imucalib import cli
from imucalib.errors import UnreadableInput

HEAD = """\
------------ Data File Created By ActiGraph GT3X+ ActiLife v6.11.5 Firmware v2.5.0 date format \
M/d/yyyy at 30 Hz  Filter Normal -----------
Serial Number: CLE2B21130054
Start Time 11:00:00
Start Date 9/17/2014
Epoch Period (hh:mm:ss) 00:00:05
Download Time 16:25:52
Download Date 9/25/2014
Current Memory Address: 0
Current Battery Voltage: 4.10     Mode = 61
--------------------------------------------------
"""
COLUMNS = ("", "Axis1,Axis2,Axis3,Steps\n", "Date,Time,Axis1,Axis2,Axis3,Steps\n")


def counts(head: str, columns: str) -> str:
    rng = np.random.default_rng(0)
    rows = rng.poisson(60, (3000, 4)) * (rng.random((3000, 1)) > 0.4)
    text = [",".join(map(str, row)) for row in rows]
    if "Time" in columns:
        clock = (f"{11 + k // 720}:{k // 12 % 60:02d}:{5 * k % 60:02d}" for k in range(3000))
        text = [f"9/17/2014,{t},{row}" for t, row in zip(clock, text, strict=True)]
    return head + columns + "\n".join(text) + "\n"


@pytest.mark.parametrize("columns", COLUMNS)
@pytest.mark.parametrize("command", ["actigraph", "inspect"])
def test_an_epoch_file_is_named_as_what_it_is(tmp_path: Path, columns: str, command: str) -> None:
    path = tmp_path / "epochs.csv"
    path.write_text(counts(HEAD, columns), encoding="utf-8")
    result = CliRunner().invoke(cli.cli, [command, str(path)], standalone_mode=False)
    assert isinstance(result.exception, UnreadableInput)
    assert "activity counts per epoch of 00:00:05, not acceleration" in str(result.exception)
    assert ".gt3x" in str(result.exception)


def test_a_raw_file_with_the_same_header_is_read(tmp_path: Path) -> None:
    head = HEAD.replace("00:00:05", "00:00:00").replace("Mode = 61", "Mode = 12")
    rng = np.random.default_rng(0)
    values = np.array([0.0, 0.0, 1.0]) + 0.01 * rng.standard_normal((900, 3))
    rows = "\n".join(",".join(f"{v:.3f}" for v in row) for row in values)
    path = tmp_path / "raw.csv"
    path.write_text(head + "Accelerometer X,Accelerometer Y,Accelerometer Z\n" + rows + "\n")
    result = CliRunner().invoke(cli.cli, ["inspect", str(path)], standalone_mode=False)
    assert result.exception is None
