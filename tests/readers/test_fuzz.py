"""Every format by files whose every sample is known: read as written, also when damaged."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from imucalib import readers
from imucalib.readers.fields.conversion import readings_at_rest
from imucalib.readers.fields.joining import join
from imucalib.recording.recording import Recording
from worlds.flight_logs import dataflash
from worlds.fuzz.cases import Fuzzer
from worlds.fuzz.files import START, kinds
from worlds.fuzz.truth import Compared, compare


@pytest.mark.parametrize("in_blocks", [False, True])
@pytest.mark.parametrize("name", kinds())
def test_every_sample_is_read_as_written(name: str, in_blocks: bool, tmp_path: Path) -> None:
    kind = kinds()[name]
    made = kind.make(np.random.default_rng(0), tmp_path)
    path = tmp_path / f"a{kind.suffix}"
    path.write_bytes(made.pack(made.data))
    blocks = readers.blocks(path, block_samples=64, strict=True)
    found = join(blocks, "") if in_blocks else readers.read(path, strict=True)
    assert compare(made.truth, found) == Compared(right=made.truth.samples)
    assert not found.gaps


@pytest.mark.parametrize("each", [2, pytest.param(20, marks=pytest.mark.slow)])
def test_damage_is_told(each: int, tmp_path: Path) -> None:
    """No sample that was not written, unsaid, and no traceback."""
    fuzzer = Fuzzer(tmp_path, 1)
    bad = []
    for number in range(each * (len(kinds()) + 1)):
        verdict = fuzzer.case(number)
        untold = verdict.outcome == "silent" and verdict.checked == "all"
        if untold or verdict.outcome in ("traceback", "hang", "memory"):
            bad.append(verdict)
    assert not bad


def test_the_judge_sees_what_is_wrong(tmp_path: Path) -> None:
    made = kinds()["own csv"].make(np.random.default_rng(0), tmp_path)
    path = tmp_path / "a.csv"
    path.write_bytes(made.data)
    whole = readers.read(path)
    channel = whole.channels["imu0/acceleration"]
    assert compare(made.truth, whole).right == made.truth.samples
    assert whole.start_ns == START
    values, t = channel.values.copy(), channel.t.copy()
    values[5, 1] = np.nextafter(values[5, 1], 1e3)
    t[7] += 0.005
    found = compare(made.truth, _with(whole, t, values))
    assert (found.invented, found.moved, found.missing_inside) == (1, 1, 2)
    found = compare(made.truth, _with(whole, t[20:-30], channel.values[20:-30]))
    assert (found.wrong, found.missing_inside, found.missing_ends) == (0, 0, 50)
    twice = np.r_[0:4, 3:300]
    found = compare(made.truth, _with(whole, channel.t[twice], channel.values[twice]))
    assert (found.wrong, found.right) == (1, made.truth.samples)


def _with(whole: Recording, t: np.ndarray, values: np.ndarray) -> Recording:
    name = "imu0/acceleration"
    channel = replace(whole.channels[name], t=t, values=values)
    return replace(whole, channels={**whole.channels, name: channel})


@pytest.mark.parametrize("suffix", [".h5", ".bin"])
def test_a_signalling_nan_is_no_warning(suffix: str, tmp_path: Path) -> None:
    path, acc = tmp_path / f"a{suffix}", np.full((300, 3), 5.66, np.float32)
    acc += np.random.default_rng(0).normal(0.0, 0.02, acc.shape).astype(np.float32)
    acc.view(np.uint32)[7, 1] = 0x7F800001
    if suffix == ".h5":
        with h5py.File(path, "w") as file:
            file["acc"], file["t"] = acc, np.arange(300) / 100.0
    else:
        signalling, quiet = (np.uint32(n).tobytes() for n in (0x7F800001, 0x7FC00001))
        log = dataflash(np.arange(1, 301) * 10_000, acc[None], np.zeros_like(acc)[None])
        path.write_bytes(log.replace(quiet, signalling))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = (readers.read(path), join(readers.blocks(path, block_samples=64), ""))
    for one in found:
        assert (~np.isfinite(one.channels["imu0/acceleration"].values)).sum() <= 1


def test_a_damaged_number_of_any_size_is_no_warning() -> None:
    pieces = np.full((40, 3), 5.0) + np.arange(120).reshape(40, 3) % 7
    pieces[3] = 1e300, np.inf, np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        norms = np.linalg.norm(readings_at_rest([pieces], 10), axis=1)
    assert 8.0 < norms.max() < 20.0
