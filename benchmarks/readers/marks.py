"""Reading against what any reader has to do, in one run: CPU seconds, ratios, peak memory.

    python benchmarks/readers/marks.py [--seconds 60] [--rows 2000000] [--hours 24]

MCAP: 32 IMUs at 1 kHz against unpacking and checking the same chunks once; `inspect` against
reading; four times the length against once. CSV: against pyarrow's streaming parser. HDF5: against
hashing the file and one pass over its numbers with h5py. Every line is a process of its own.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import re
import resource
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from logs import generate


def chunks(path: Path) -> None:
    """Unpack every chunk and check its sum."""
    import zstandard
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    unpack = zstandard.ZstdDecompressor()
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True).records:
            if isinstance(record, Chunk):
                data = unpack.decompress(record.data, record.uncompressed_size)
                assert zlib.crc32(data) == record.uncompressed_crc


def read(path: Path) -> None:
    """All samples."""
    from imucalib.readers import read as read_all

    read_all(path)


def inspect(path: Path) -> None:
    """The command, quiet."""
    from imucalib.cli import main

    sys.argv = ["imucal", "inspect", str(path), "--quiet"]
    with contextlib.suppress(SystemExit):
        main()


def arrow(path: Path) -> None:
    """Every cell, in a stream."""
    from pyarrow import csv

    with csv.open_csv(path) as stream:
        for _ in stream:
            pass


def hashed(path: Path) -> None:
    """The file's hash, and one pass over its numbers."""
    import h5py

    with path.open("rb") as file:
        hashlib.file_digest(file, "sha256")

    def visit(_: str, node: object) -> None:
        if isinstance(node, h5py.Dataset) and node.ndim:
            for start in range(0, node.shape[0], 1 << 18):
                float(np.sum(node[start : start + (1 << 18)]))

    with h5py.File(path) as file:
        file.visititems(visit)


WORK: dict[str, Callable[[Path], None]] = {
    f.__name__: f for f in (chunks, read, inspect, arrow, hashed)
}


def cost(work: str, path: Path) -> tuple[float, float]:
    """CPU seconds without those of starting, and peak memory in MB."""
    command = [sys.executable, __file__, "--work", work, "--path", str(path)]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    seconds, peak = (float(v) for v in text.split()[-2:])
    return seconds, peak


def measured(work: str, path: Path, small: Path) -> None:
    """In this process, after the same on a small file, so that imports are not counted."""
    WORK[work](small)
    before = resource.getrusage(resource.RUSAGE_SELF)
    WORK[work](path)
    after = resource.getrusage(resource.RUSAGE_SELF)
    used = (after.ru_utime - before.ru_utime) + (after.ru_stime - before.ru_stime)
    # Not ru_maxrss, which begins at what the parent had.
    peak = re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())
    print(used, int(peak[1]) / 1e3 if peak else float("nan"))


def table(path: Path, rows: int) -> None:
    """EuRoC's columns."""
    rng = np.random.default_rng(0)
    stamps = 1_700_000_000_000_000_000 + 5_000_000 * np.arange(rows)
    values = np.round(rng.normal((0, 0, 0, 0, 0, 9.81), 0.02, (rows, 6)), 6)
    with path.open("w") as file:
        file.write("#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
                   "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n")  # fmt: skip
        for a in range(0, rows, 100_000):
            part = [stamps[a : a + 100_000], *values[a : a + 100_000].T]
            file.writelines(",".join(map(str, row)) + "\n" for row in zip(*part, strict=True))


def worn(path: Path, hours: float) -> None:
    """100 Hz, three axes and a clock, as this package writes it."""
    from imucalib.recording.recording import Channel, Recording
    from imucalib.writers import write

    n, rng = int(hours * 360_000), np.random.default_rng(0)
    values = rng.normal((0, 0, 9.81), 0.05, (n, 3))
    t = np.arange(n) / 100.0
    channel = Channel(t, values, "m/s2", "acceleration", "imu0", 100.0)
    recording = Recording({"imu0/acceleration": channel}, "", "", "")
    write(recording, path)


def main() -> None:
    """Make the files and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--work", choices=WORK, help=argparse.SUPPRESS)
    parser.add_argument("--path", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.work:
        measured(asked.work, asked.path, asked.path.with_name(f"small{asked.path.suffix}"))
        return
    with tempfile.TemporaryDirectory() as name:
        every(Path(name), asked)


def every(folder: Path, asked: argparse.Namespace) -> None:
    """All ratios."""
    files = {s: [folder / f"{n}.{s}" for n in ("small", "one", "four")]
             for s in ("mcap", "csv", "h5")}  # fmt: skip
    for k, share in enumerate((0.02, 1.0, 4.0)):
        generate(files["mcap"][k], 32, share * asked.seconds)
        table(files["csv"][k], int(share * asked.rows))
        worn(files["h5"][k], share * asked.hours)
    rows = (
        ("mcap", "chunks", "read", 25.0), ("mcap", "read", "inspect", 1.2),
        ("csv", "arrow", "read", 1.3), ("h5", "hashed", "read", 2.0),
    )  # fmt: skip
    print("| file | least | this | ratio | mark | four times the length | peak, MB |")
    print("|---|---|---|---|---|---|---|")
    for kind, least, this, mark in rows:
        (a, _), (b, peak) = (cost(work, files[kind][1]) for work in (least, this))
        longer, top = cost(this, files[kind][2])
        size = files[kind][1].stat().st_size / 1e6
        print(f"| {kind}, {size:.0f} MB | {least} {a:.2f} s | {this} {b:.2f} s | {b / a:.2f} | "
              f"{mark} | {longer / b:.2f} times | {peak:.0f}, {top:.0f} |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
