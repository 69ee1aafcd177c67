"""Readings counted from an offset: told with the options that read them, never as a unit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from imucalib.cli import cli as root
from imucalib.errors import UnreadableInput
from imucalib.readers import read
from imucalib.readers.conversion import zero_g

Array = NDArray[np.float64]

_LEVEL, _SCALE = np.array([33123.0, 33276.0, 32360.0]), np.array([4076.0, 4006.0, 4052.0])


def _directions(rng: np.random.Generator, count: int) -> Array:
    out = rng.normal(size=(count, 3))
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def _recording(path: Path) -> Path:
    """36 rests of 4 s at 50 Hz, half a second of turning between them."""
    rng = np.random.default_rng(5)
    rests = [np.repeat(u[None], 200, axis=0) for u in _directions(rng, 36)]
    turns = [rng.normal(0.0, 0.6, (25, 3)) for _ in rests]
    truth = np.concatenate([part for both in zip(rests, turns, strict=True) for part in both])
    counts = np.rint(_LEVEL + _SCALE * truth + rng.normal(0.0, 6.0, truth.shape))
    np.savetxt(path, np.column_stack([np.arange(len(counts)) / 50.0, counts]), fmt="%.7e")
    return path


def test_a_recording_from_an_offset_is_refused_with_the_options_that_read_it(
    tmp_path: Path,
) -> None:
    log = _recording(tmp_path / "acc.txt")
    refused = CliRunner().invoke(root, ["inspect", str(log)])
    assert isinstance(refused.exception, UnreadableInput)
    told = str(refused.exception)
    assert "counted from an offset" in told
    line = told.split("offset. ")[1].split(" counts them", maxsplit=1)[0]
    assert line.startswith("--unit counts --lsb 40")
    run = [
        "lab",
        str(log),
        "--reference",
        "norm",
        "-o",
        str(tmp_path / "out"),
        "--full",
        *line.split(),
    ]
    read = CliRunner().invoke(root, run)
    assert read.exit_code == 0, read.stderr
    assert "as the recording was read" in " ".join(read.stdout.split())


@given(
    seed=st.integers(0, 10_000),
    away=st.floats(1.5, 12.0),
    size=st.sampled_from([0.33, 66.0, 1024.0, 4096.0]),
)
def test_the_level_and_what_a_g_reads_come_back(seed: int, away: float, size: float) -> None:
    rng = np.random.default_rng(seed)
    level = away * size * _directions(rng, 1)[0]
    rest = level + size * _directions(rng, 30) * rng.uniform(0.98, 1.02, (1, 3))
    found = zero_g(rest)
    assert found is not None
    assert found.radius == pytest.approx(size, rel=0.05)
    assert np.abs(found.level - level).max() < 0.05 * size


@pytest.mark.parametrize("stated", [True, False])
def test_acceleration_without_gravity_is_said_to_be_that(stated: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(2000) / 100.0
    moved = rng.normal(0.0, 0.02, (2000, 3)) + np.sin(t)[:, None] * (t[:, None] % 4 > 2)
    head = "t_s,acc_x [m/s2],acc_y [m/s2],acc_z [m/s2]" if stated else "t_s,acc_x,acc_y,acc_z"
    path = tmp_path / "linear.csv"
    np.savetxt(path, np.column_stack([t, moved]), delimiter=",", header=head, comments="")
    with pytest.raises(UnreadableInput, match="gravity was removed"):
        read(path)
