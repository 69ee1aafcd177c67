"""Devices against the first lines of true exports: named as themselves, and read as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from imucalib import readers
from imucalib.readers.devices.catalogue import Device, devices
from imucalib.recording.mapping import FieldMapping
from imucalib.units import ACCELERATION_UNITS, RATE_UNITS
from worlds.places import ROOT

#: Of which no true export is known: what they write is HDF5, messages, or a table of which pages
#: show two rows that are not neighbours.
WITHOUT = {"apdm", "sensor_msgs", "kalibr"}
EXAMPLES = {name: device for name, device in devices().items() if device.example}


def named(device: Device, text: str) -> bool:
    lines = text.split("\n")
    return any(word in text.lower() for word in device.words) or bool(device.heading(lines))


def numbers_in(text: str) -> set[float]:
    return {float(cell) for cell in re.split(r"[,;\t\n]", text) if re.fullmatch(r"-?[\d.]+", cell)}


def test_the_page_of_formats_names_every_device() -> None:
    page = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    (row,) = re.findall(r"^\| `--preset` \| (.*) \|$", page, re.M)
    assert row.split(", ") == sorted(devices())


def test_every_device_has_an_example_and_its_source() -> None:
    assert set(EXAMPLES) == set(devices()) - WITHOUT
    assert all(device.source for device in EXAMPLES.values())


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_of_its_device_and_of_no_other(name: str) -> None:
    device = EXAMPLES[name]
    known = bool(device.words) or device.heading(device.example.split("\n")) > 0
    found = {other for other, one in devices().items() if named(one, device.example)}
    assert found == ({name} if known else set())


@pytest.mark.parametrize("name", EXAMPLES)
@pytest.mark.parametrize("preset", [False, True])
def test_an_example_is_read(name: str, preset: bool, tmp_path: Path) -> None:
    text = EXAMPLES[name].example
    path = tmp_path / "export.csv"
    path.write_text(text, encoding="utf-8")
    found = readers.read(path, FieldMapping(preset=name if preset else ""))
    force = found.channels["imu0/acceleration"]
    assert force.unit == "m/s2"
    assert any("read" in str(count) and not sum(count.left.values()) for count in found.counts)
    for channel in found.channels.values():
        if channel.quantity in ("acceleration", "angular_rate"):
            units = {**ACCELERATION_UNITS, **RATE_UNITS}
            assert channel.raw_unit in (*units, "counts")
            raw = channel.values / np.array(channel.raw_to_si)
            written = np.array(sorted(numbers_in(text)))
            away = np.abs(raw.reshape(-1, 1) - written).min(axis=1)
            assert away.max() < 1e-9
    again = readers.read(path, FieldMapping(preset="" if preset else name))
    assert set(again.channels) == set(found.channels)
    np.testing.assert_array_equal(again.channels["imu0/acceleration"].values, force.values)
    np.testing.assert_array_equal(again.channels["imu0/acceleration"].t, force.t)
