"""One triad with a gyroscope in every format whose unit may be wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from imucalib import writers
from imucalib.arrays import Array
from worlds.bag_logs import BagWriter
from worlds.flight_logs import dataflash, ulog
from worlds.recordings import recording_of

Write = Callable[[Path, Array, Array, Array], Path]


def _written(writer: writers.Writer | BagWriter) -> Write:
    def write(folder: Path, t: Array, acc: Array, rate: Array) -> Path:
        path = folder / f"log{writer.suffixes[0]}"
        writer.write_blocks([recording_of(t, acc, rate, start_ns=1_700_000_000 * 10**9)], path)
        return path

    return write


def _flight(make: Callable[..., bytes], suffix: str) -> Write:
    def write(folder: Path, t: Array, acc: Array, rate: Array) -> Path:
        stamps = np.rint(t * 1e6).astype(np.int64) + 1_000_000
        path = folder / f"log{suffix}"
        sensors = (acc[None].astype(np.float32), rate[None].astype(np.float32))
        path.write_bytes(make(stamps, *sensors))
        return path

    return write


def _matlab(folder: Path, t: Array, acc: Array, rate: Array) -> Path:
    from scipy.io import savemat

    path = folder / "log.mat"
    savemat(path, {"t": t, "acc": acc, "gyro": rate})
    return path


#: Every format by its reader's name, written with rates that are called rad/s.
WRITE: dict[str, Write] = {
    **{w.name: _written(w) for w in writers.writers()},
    "rosbag": _written(BagWriter((".bag",))),
    "ulog": _flight(ulog, ".ulg"),
    "dataflash": _flight(dataflash, ".bin"),
    "matlab": _matlab,
}
