"""A device is one file: what is known of it fills a mapping and reads tables without headings."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from imucalib import readers
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers import devices as folder
from imucalib.readers.devices.catalogue import devices, with_preset
from imucalib.recording.mapping import FieldMapping

#: All that a new dialect takes: the text of one file.
NEW = """
from imucalib.readers.devices.catalogue import Device, Start
from imucalib.recording.mapping import FieldMapping

DEVICE = Device(
    "tumbler",
    FieldMapping(acc=("2", "3", "4"), temperature=("5",), acc_unit="mg", temperature_unit="degC"),
    words=("tumbler 3000",),
    start=lambda text: Start(1_600_000_000_000_000_000, ("the start is the maker's birthday",)),
)
"""
TABLE = "Tumbler 3000 data logger, sample rate 50 Hz\n" + "".join(
    f"{k};{a};{b};{c};{21 + k % 2}\n"
    for k, (a, b, c) in enumerate(np.tile([[3, -1000, 12]], (200, 1)) + np.arange(200)[:, None] % 3)
)


@pytest.fixture
def tumbler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    room = tmp_path / "more_devices"
    room.mkdir()
    (room / "tumbler.py").write_text(NEW, encoding="utf-8")
    monkeypatch.setattr(folder, "__path__", [*folder.__path__, str(room)])
    devices.cache_clear()
    yield
    devices.cache_clear()
    sys.modules.pop("imucalib.readers.devices.tumbler", None)


def test_a_new_dialect_is_one_file(tumbler: None, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(TABLE, encoding="utf-8")
    found = readers.read(path)
    acc, warm = found.channels["imu0/acceleration"], found.channels["imu0/temperature"]
    assert np.allclose(acc.values[:3, 1], np.array([-1.0, -0.999, -0.998]) * 9.80665)
    assert list(warm.values[:3, 0]) == [21.0, 22.0, 21.0]
    assert found.start_ns == 1_600_000_000_000_000_000
    assert "the start is the maker's birthday" in found.notes
    assert found.mapping["preset"] == "tumbler"
    assert with_preset(FieldMapping(preset="tumbler")).acc_unit == "mg"


def test_without_that_file_the_dialect_is_unknown(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(TABLE, encoding="utf-8")
    with pytest.raises(UnreadableInput, match="--acc"):
        readers.read(path)


def test_an_unknown_preset_is_refused() -> None:
    with pytest.raises(UsageError, match=r"unknown preset.*actigraph"):
        with_preset(FieldMapping(preset="nokia"))
