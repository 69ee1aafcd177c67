"""Axivity .cwa and GENEActiv .bin, through scikit-digital-health (extra `devices`).

The package reads whole files, so memory grows with the recording here, unlike in other formats.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.conversion import acceleration, norms_at_rest, temperature
from imucalib.readers.joining import join
from imucalib.readers.source import sha256_of
from imucalib.readers.timebase import find_gaps, stepping
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Recording

_CWA, _BIN = b"MD", b"Device Identity"


class WornDeviceReader:
    """The reader of Axivity's and GENEActiv's own files."""

    name = "worn device"
    suffixes = (".cwa", ".bin")

    def recognises(self, path: Path, head: bytes) -> bool:
        """An Axivity metadata sector of 1020 bytes, or GENEActiv's first line."""
        return head.startswith((_CWA + b"\xfc\x03", _BIN))

    def read(self, path: Path, mapping: FieldMapping, *, strict: bool) -> Recording:
        """Read all samples."""
        return join(self.blocks(path, mapping, block_samples=1 << 18, strict=strict), str(path))

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Slices of the whole recording; `strict` changes nothing, the package reads or refuses."""
        del strict
        found = _device_data(path)
        raw, seconds = np.asarray(found["accel"], float), np.asarray(found["time"], float)
        step = stepping([seconds])
        if step is None or raw.shape != (seconds.size, 3):
            raise UnreadableInput("no samples with times in it", where=str(path))
        rate = 1.0 / step.step
        convert = acceleration(mapping, "g", norms_at_rest([raw], round(rate)), str(path))
        warm = np.asarray(found.get("temperature", np.zeros(0)), float)[:, None]
        heat = temperature(mapping, "degC", warm, str(path))
        digest, origin = sha256_of(path), float(seconds[0])
        notes = ("times are the device's own, without a zone: taken as UTC", convert.note)
        for first in range(0, seconds.size, block_samples):
            part = slice(first, first + block_samples)
            t = seconds[part] - origin
            before = float(seconds[first - 1] - origin) if first else None
            rows = np.arange(first, first + t.size, dtype=float)
            channels = {"imu0/acceleration": _channel(t, convert.apply(raw[part]), "m/s2", rate)}
            if warm.shape[0] == seconds.size:
                channels["imu0/temperature"] = _channel(t, heat.apply(warm[part]), "degC", rate)
            yield Recording(
                channels=channels,
                path=str(path),
                format=self.name,
                sha256=digest,
                start_ns=round(origin * 1e9),
                gaps=tuple(find_gaps(t, rows, step.threshold, before)),
                notes=() if first else tuple(n for n in notes if n),
                mapping={"acc_unit": convert.source_unit},
            )


READER = WornDeviceReader()


def _channel(t: Array, values: Array, unit: str, rate: float) -> Channel:
    quantity = "acceleration" if unit == "m/s2" else "temperature"
    return Channel(t, values, unit, quantity, "imu0", rate)


def _device_data(path: Path) -> dict[str, Any]:
    try:
        from skdh.io import ReadBin, ReadCwa
    except ImportError:
        raise UnreadableInput(
            "this device file needs scikit-digital-health", where=str(path),
            remedy="pip install 'imucalib[devices]', or export it as CSV with the maker's software",
        ) from None  # fmt: skip
    reader = ReadBin() if path.read_bytes()[: len(_BIN)] == _BIN else ReadCwa()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found: dict[str, Any] = reader.predict(file=str(path))
    except Exception as error:  # the package raises its C code's errors as plain exceptions
        raise UnreadableInput(
            f"scikit-digital-health cannot read it: {error}", where=str(path),
            remedy="copy the file from the device again",
        ) from error  # fmt: skip
    return found
