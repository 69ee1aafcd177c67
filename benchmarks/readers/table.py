"""CPU seconds and peak memory of reading CSV and HDF5, beside numpy.loadtxt and plain h5py.

    python benchmarks/readers/table.py [--folder DIR] [--rows N]

Both others do less than a recording needs: they give raw columns, without units, gaps or notes,
and the h5py line reads no unit, checks no clock, hashes nothing.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

START = 1_700_000_000_000_000_000


def generate(folder: Path, rows: int) -> dict[str, Path]:
    """EuRoC-like CSV, ActiGraph-like CSV of four times the rows, and this package's HDF5."""
    from imucalib.readers import read
    from imucalib.writers import write

    rng = np.random.default_rng(1)
    acc = rng.normal((0, 0, 9.81), 0.02, (rows, 3))
    gyro = rng.normal(0, 0.01, (rows, 3))
    ns = START + 5_000_000 * np.arange(rows)
    paths = {name: folder / name for name in ("euroc.csv", "actigraph.csv", "own.h5")}
    with paths["euroc.csv"].open("w") as file:
        file.write("#timestamp [ns],w_x [rad s^-1],w_y [rad s^-1],w_z [rad s^-1]")
        file.write(",a_x [m s^-2],a_y [m s^-2],a_z [m s^-2]\n")
        values = np.column_stack([gyro, acc])
        lines = (
            f"{t},{','.join(f'{v:.14f}' for v in row)}\n"
            for t, row in zip(ns.tolist(), values.tolist(), strict=True)
        )
        file.writelines(lines)
    with paths["actigraph.csv"].open("w") as file:
        file.write("x,y,z\n")
        for _ in range(4):
            part = rng.normal((0, 0, 1), 0.02, (rows, 3))
            file.writelines(f"{x:.3f},{y:.3f},{z:.3f}\n" for x, y, z in part.tolist())
    write(read(paths["euroc.csv"]), paths["own.h5"])
    return paths


def with_imucal(path: Path) -> int:
    """All channels, in SI."""
    from imucalib.readers import read
    from imucalib.recording.mapping import FieldMapping

    mapping = FieldMapping(rate=100.0) if path.name == "actigraph.csv" else FieldMapping()
    return next(iter(read(path, mapping).channels.values())).t.size


def with_numpy(path: Path) -> int:
    """All columns as float64; nanosecond stamps as int64, since float64 would round them."""
    if path.name == "euroc.csv":
        kind = np.dtype([("t", "i8"), ("v", "f8", (6,))])
        return int(np.loadtxt(path, delimiter=",", skiprows=1, dtype=kind).size)
    return int(np.loadtxt(path, delimiter=",", skiprows=1).shape[0])


def with_h5py(path: Path) -> int:
    """All datasets into arrays."""
    import h5py

    arrays: list[np.ndarray] = []
    with h5py.File(path) as file:
        file.visititems(lambda _, n: arrays.append(n[...]) if isinstance(n, h5py.Dataset) else None)
    return max(array.shape[0] for array in arrays)


READERS = {"imucal": with_imucal, "numpy.loadtxt": with_numpy, "h5py": with_h5py}
PACKAGES = {"imucal": "imucalib", "numpy.loadtxt": "numpy", "h5py": "h5py"}


def one(reader: str, path: Path) -> None:
    """The measured process."""
    if reader == "imucal":
        import imucalib.readers

        imucalib.readers.readers()
    import h5py  # noqa: F401 - its import is not what is measured

    before = time.process_time()
    count = READERS[reader](path)
    cpu = time.process_time() - before
    # ru_maxrss would start from the parent's peak.
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak = int(status.split("VmHWM:")[1].split()[0]) * 1024
    print(count, cpu, peak)


def main() -> None:
    """Parse the options and run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, help="keep the files here")
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--reader", choices=READERS, help=argparse.SUPPRESS)
    parser.add_argument("path", nargs="?", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.reader:
        one(options.reader, options.path)
        return
    with TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name, path in generate(folder, options.rows).items():
            size = path.stat().st_size / 1e6
            print(f"{name}: {size:.0f} MB")
            for reader in ("imucal", "h5py" if path.suffix == ".h5" else "numpy.loadtxt"):
                command = [sys.executable, __file__, "--reader", reader, str(path)]
                done = subprocess.run(command, check=True, capture_output=True, text=True)
                count, cpu, peak = map(float, done.stdout.split())
                print(
                    f"  {reader:14} {version(PACKAGES[reader]):8} {count:9.0f} rows"
                    f" {cpu:6.2f} CPU s {size / cpu:6.0f} MB / CPU s {peak / 1e6:6.0f} MB peak"
                )


if __name__ == "__main__":
    main()
