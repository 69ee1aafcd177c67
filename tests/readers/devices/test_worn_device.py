"""Axivity and GENEActiv files through the extra `devices`."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucalib.errors import UnreadableInput
from imucalib.readers import blocks, read
from worlds.places import DATA

FOLDER = DATA / "actigraph"
AXIVITY, GENEACTIV = FOLDER / "skdh_ax3_sample.cwa", FOLDER / "skdh_gnactv_sample.bin"
here = pytest.mark.skipif(not FOLDER.is_dir(), reason="the measured data are not here")


@here
@pytest.mark.parametrize(
    ("path", "samples", "rate"), [(AXIVITY, 58_800, 200.0), (GENEACTIV, 900, 50.0)]
)
def test_samples_rate_temperature(path: Path, samples: int, rate: float) -> None:
    pytest.importorskip("skdh")
    recording = read(path)
    channel = recording.channels["imu0/acceleration"]
    assert channel.values.shape == (samples, 3)
    assert channel.rate == pytest.approx(rate, rel=0.02)
    norm = np.median(np.linalg.norm(channel.values, axis=1))
    assert 9.0 < norm < 10.6
    assert 10.0 < recording.channels["imu0/temperature"].values.mean() < 40.0
    parts = [b.channels["imu0/acceleration"].values for b in blocks(path, block_samples=500)]
    np.testing.assert_array_equal(np.concatenate(parts), channel.values)


def test_without_the_package_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"Device Identity\nDevice Unique Serial Code:1\n")
    plain = builtins.__import__

    def without(name: str, *rest: Any, **named: Any) -> Any:
        if name.startswith("skdh"):
            raise ImportError(name)
        return plain(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UnreadableInput, match=r"imucalib\[devices\]"):
        read(path)


def test_a_damaged_device_file_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("skdh")
    path = tmp_path / "a.bin"
    path.write_bytes(b"Device Identity\nDevice Unique Serial Code:1\n")
    with pytest.raises(UnreadableInput):
        read(path)
