"""Samples that repeat the one before as no noise does: told by every reader, and no rest."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib import readers
from imucalib.inspection.inspection import Inspection, inspect_recording, problems
from imucalib.recording.mapping import FieldMapping
from worlds.every_format import WRITE
from worlds.places import DATA, MEASURED, SAMPLES
from worlds.turned import turned

Array = NDArray[np.float64]
Change = Callable[[Array, Array], None]
RATES = FieldMapping(gyro_unit="rad/s")
WORDS = "repeat the one before to the last digit"
#: Steps of a converter of 16 bits, a quarter of the noise of a sample and less.
ACC_STEP, RATE_STEP = 0.0024, 0.00025


def _changed(change: Change | None = None, steps: float = 1.0) -> tuple[Array, Array, Array]:
    t, acc, rate = turned(8)
    acc, rate = (
        np.round(x / (s * steps)) * s * steps for x, s in ((acc, ACC_STEP), (rate, RATE_STEP))
    )
    if change is not None:
        change(acc, rate)
    return t, acc, rate


def _hold(acc: Array, rate: Array) -> None:
    acc[800:1000], rate[800:1000] = acc[800], rate[800]


def _fill(acc: Array, rate: Array) -> None:
    acc[800:1000] = rate[800:1000] = 0.0


def _hold_shortly(acc: Array, rate: Array) -> None:
    for values in (acc, rate):
        for at in range(100, len(values) - 20, 150):
            values[at : at + 15] = values[at]


def _copy(acc: Array, rate: Array) -> None:
    for values in (acc, rate):
        values[1::2] = values[::2][: len(values[1::2])]


def _dead_zone(acc: Array, rate: Array) -> None:
    rate[np.abs(rate).max(axis=1) < 0.02] = (0.0, 0.0, 0.0)


def _offset_zone(acc: Array, rate: Array) -> None:
    rate[np.abs(rate).max(axis=1) < 0.02] = (0.005, 0.001, -0.002)


def _inspected(path: Path, block: int = 1 << 18) -> Inspection:
    return inspect_recording(readers.blocks(path, RATES, block_samples=block))


@pytest.mark.parametrize("name", WRITE)
@pytest.mark.parametrize("change", [_hold, _fill, _hold_shortly, _copy])
def test_every_reader_tells_what_noise_does_not_do(
    name: str, change: Change, tmp_path: Path
) -> None:
    path = WRITE[name](tmp_path, *_changed(change))
    for notes in (readers.read(path, RATES).notes, _inspected(path, 1000).notes):
        told = [note.partition(":")[0] for note in notes if WORDS in note]
        assert sorted(told) == ["imu0/acceleration", "imu0/angular_rate"]
    assert "repeat the one before" in " ".join(problems(_inspected(path)))


@pytest.mark.parametrize("name", WRITE)
@pytest.mark.parametrize("change", [None, _dead_zone, _offset_zone])
def test_no_reader_tells_what_a_sound_sensor_does(
    name: str, change: Change | None, tmp_path: Path
) -> None:
    path = WRITE[name](tmp_path, *_changed(change))
    assert not [note for note in readers.read(path, RATES).notes if WORDS in note]


@pytest.mark.parametrize("change", [_hold, _fill])
def test_what_is_held_is_no_rest(change: Change, tmp_path: Path) -> None:
    path = WRITE["hdf5"](tmp_path, *_changed(change))
    for block in (700, 1 << 18):
        found = _inspected(path, block).still
        assert found is not None
        assert found.n == 8
        assert not ((found.start < 9.9) & (found.stop > 8.1)).any()


@pytest.mark.parametrize("zone", [_dead_zone, _offset_zone])
def test_a_gyroscope_with_a_dead_zone_hides_no_rest(zone: Change, tmp_path: Path) -> None:
    path = WRITE["hdf5"](tmp_path, *_changed(zone))
    found = _inspected(path).still
    assert found is not None
    assert found.n == 9
    assert (found.rate_noise >= RATE_STEP / np.sqrt(12.0) * 0.999).all()


#: Measured recordings that lie with the project, and larger ones that need not be there.
SOUND: dict[Path, FieldMapping] = {
    MEASURED / "ax3.cwa": FieldMapping(),
    MEASURED / "geneactiv.bin": FieldMapping(),
    **{
        MEASURED / f"imu{k}.log.gz": FieldMapping(
            acc=("1", "2", "3"), gyro=("4", "5", "6"), rate=100.0, header=False, acc_unit="m/s2",
            gyro_unit="rad/s",
        )
        for k in (0, 1)
    },
    **{SAMPLES / name: FieldMapping() for name in ("board.h5", "board_part.mcap", "rests.mcap")},
    **{DATA / "mimu4444" / f"exp_{k}.h5": FieldMapping() for k in (1, 2, 4, 5)},
    DATA / "actigraph" / "paat_example_day.csv.gz": FieldMapping(),
    DATA / "actigraph" / "ggir_actigraph_testfile.gt3x": FieldMapping(),
}  # fmt: skip


@pytest.mark.parametrize("path", SOUND, ids=lambda p: p.name)
def test_no_measured_log_is_refused_or_told(path: Path) -> None:
    if not path.exists():
        pytest.skip("needs the shared data")
    for block in readers.blocks(path, SOUND[path]):
        assert not [note for note in block.notes if WORDS in note]
        assert not block.held
