"""A worn sensor's calibration beside its peers: python benchmarks/actigraph/peers.py.

Generates recordings of one wrist sensor (scale 1.03, 0.97, 1.015; misalignment 0.012, -0.018,
0.009; offset 25, -40, 15 mg; noise 4 mg) and calibrates each with every program, one process a
run. CPU seconds and peak memory are the process's own. The error is that of |a| over
a uniform sphere without noise, in mg. Programs that are not installed are left out.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import warnings
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
G = 9.80665
PACKAGES = {"skdh": "scikit-digital-health"}


def make(path: Path, days: float, rate: float) -> None:
    """A contiguous float32 recording in g."""
    import h5py

    from imucalib.calibrators.actigraph.simulation import WeekPlan, worn_blocks

    with h5py.File(path, "w") as file:
        n = round(days * 86400 * rate)
        data = file.create_dataset("accelerometer/data", (n, 3), "f4")
        data.attrs["unit"] = "g"
        data.attrs["sample_rate"] = rate
        at = 0
        for block in worn_blocks(WeekPlan(days=days, rate=rate, temperature=False), 1):
            values = block.channels["imu0/acceleration"].values / 9.80665
            data[at : at + len(values)] = values
            at += len(values)


def environment() -> dict[str, str]:
    """One BLAS thread, and bytecode kept between runs as in an installed package."""
    cache = str(Path(tempfile.gettempdir()) / "imucal_benchmark_bytecode")
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    own = {"OPENBLAS_NUM_THREADS": "1", "PYTHONPYCACHEPREFIX": cache}
    return {**kept, **own}


def peak() -> float:
    """Peak memory of this process, MB; Linux only."""
    return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024


def sphere_error(gain: Array, offset: Array) -> float:
    """Mean | |gain @ reading + offset| - 1 | in mg over the sphere; readings of the sensor in g."""
    from imucalib.calibrators.actigraph.simulation import SENSOR
    from imucalib.calibrators.planted import plant_model
    from imucalib.core.effect import Context

    rng = np.random.default_rng(0)
    truth = rng.standard_normal((20000, 3))
    truth *= G / np.linalg.norm(truth, axis=1, keepdims=True)
    context = Context(len(truth))
    model, theta = plant_model(SENSOR, context)
    reading = model.predict(theta, truth[:, None], context).reading[:, 0] / G
    size = np.linalg.norm(reading @ gain.T + offset, axis=1)
    return float(1e3 * np.abs(size - 1.0).mean())


def stored(path: Path) -> Array:
    import h5py

    with h5py.File(path) as file:
        return file["accelerometer/data"][:]


def spent() -> float:
    use = resource.getrusage(resource.RUSAGE_SELF)
    return use.ru_utime + use.ru_stime


def whole(path: Path, rate: float) -> dict[str, Any]:
    """The command, from the file to YAML and reports."""
    from imucalib.cli import cli

    unit = ["--unit", "g"] if path.suffix == ".csv" else []
    out = path.with_suffix(".out")
    cli.main(["actigraph", str(path), "-o", str(out), "-q", *unit], standalone_mode=False)
    found = json.loads((out / "report.json").read_text())["matrices"]
    linear = found["corrected_from_raw"]
    return {"error": sphere_error(np.array(linear["M"]), np.array(linear["b"]) / G)}


def imucal(path: Path, rate: float) -> dict[str, Any]:
    """Windows, rests, fit and search on an array in memory."""
    from imucalib.calibrators.actigraph.request import ActigraphRequest
    from imucalib.calibrators.actigraph.run import run_of
    from imucalib.readers.fields.conversion import Conversion
    from imucalib.recording.recording import Channel, Recording
    from imucalib.rests.runs import posture_runs, scan

    values = stored(path)
    before = spent()
    t = np.arange(len(values)) / rate
    unit = Conversion("m/s2", "g", np.array([G]), np.zeros(1))
    channel = Channel(
        t=t,
        values=unit.apply(values),
        unit="m/s2",
        quantity="acceleration",
        triad="imu0",
        rate=rate,
    )
    scanned = scan([Recording({"imu0/acceleration": channel}, "week", "array", "")], 10.0)
    runs = posture_runs(scanned)
    run = run_of(runs, scanned.drop_windows(), ActigraphRequest(), lambda _: None)
    cpu = spent() - before
    linear = run.calibration.matrices().as_dict()["corrected_from_raw"]
    error = sphere_error(np.array(linear["M"]), np.array(linear["b"]) / G)
    return {"cpu": cpu, "error": error}


def skdh(path: Path, rate: float) -> dict[str, Any]:
    """scikit-digital-health; it refuses less than 72 h unless it is told to take 12."""
    from skdh.preprocessing import CalibrateAccelerometer

    values = stored(path).astype(np.float64)
    t = 1.7e9 + np.arange(len(values)) / rate
    before = spent()
    hours = 72 if len(values) >= 72 * 3600 * rate else 12
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = CalibrateAccelerometer(min_hours=hours).predict(time=t, accel=values, fs=rate)
    cpu = spent() - before
    gain, offset = np.diag(found["scale"]), found["scale"] * found["offset"]
    return {"cpu": cpu, "error": sphere_error(gain, offset)}


def detection(path: Path, rate: float) -> dict[str, Any]:
    """Statistics and rests of an array in memory, and the time of one sum over it."""
    from imucalib.recording.recording import Channel
    from imucalib.rests.runs import WORN
    from imucalib.rests.stillness import Sensor, still_windows
    from imucalib.rests.windows import WindowBuilder, window_statistics

    values = stored(path)

    def fastest(what: Any) -> float:
        best = np.inf
        for _ in range(5):
            before = spent()
            what()
            best = min(best, spent() - before)
        return best

    w = round(10.0 * rate)
    once = fastest(lambda: np.sum(values))
    cube = values[: len(values) // w * w].reshape(-1, w, 3)
    statistics = fastest(lambda: window_statistics(cube))
    t = np.arange(len(values)) / rate

    builder = WindowBuilder(w)
    builder.add(Channel(t, values, "m/s2", "acceleration", "imu0", rate), [])
    windows = builder.windows()
    assert windows is not None
    sensor = Sensor("imu0", "acceleration", rate, windows, WORN)
    decision = fastest(lambda: still_windows(replace(sensor)))
    return {"once": once, "statistics": statistics, "decision": decision}


def pyarrow(path: Path, rate: float) -> dict[str, Any]:
    before = spent()
    from pyarrow import csv

    rows = sum(b.num_rows for b in csv.open_csv(path, csv.ReadOptions(block_size=16 << 20)))
    return {"cpu": spent() - before, "rows": rows}


def pandas(path: Path, rate: float) -> dict[str, Any]:
    before = spent()
    import pandas as pd

    rows = sum(len(part) for part in pd.read_csv(path, chunksize=1 << 18))
    return {"cpu": spent() - before, "rows": rows}


RUNS = {f.__name__: f for f in (whole, imucal, skdh, detection, pyarrow, pandas)}


def run(name: str, path: Path, rate: float) -> dict[str, Any]:
    """One run in a process of its own."""
    code = [sys.executable, __file__, "--run", name, str(path), "--rate", str(rate)]
    done = subprocess.run(code, capture_output=True, text=True, env=environment(), check=False)
    if done.returncode:
        return {"failed": done.stderr.strip().splitlines()[-1:]}
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def show(label: str, name: str, found: dict[str, Any]) -> None:
    numbers = {k: round(v, 4) if isinstance(v, float) else v for k, v in found.items()}
    print(f"{label:14s} {name:10s} {numbers} load {os.getloadavg()[0]:.1f}", flush=True)


def text_of(source: Path, target: Path, rate: float) -> None:
    """The recording as CSV: time in ms, x, y, z in g with six decimals."""
    values, start = stored(source).astype(np.float64), 1_700_000_000_000
    with target.open("w") as file:
        file.write("time_ms,x,y,z\n")
        for a in range(0, len(values), 100_000):
            part = values[a : a + 100_000]
            t = start + np.round(1e3 * np.arange(a, a + len(part)) / rate)
            np.savetxt(file, np.column_stack([t, part]), fmt="%d,%.6f,%.6f,%.6f")


def other_formats(source: Path, rate: float) -> None:
    """One day as CSV and as MCAP, from the file to the reports."""
    for suffix in (".csv", ".mcap"):
        path = source.with_suffix(suffix)
        if suffix == ".csv":
            text_of(source, path, rate)
        else:
            convert = [sys.executable, "-m", "imucalib", "convert", str(source), str(path)]
            subprocess.run(convert, check=True, capture_output=True)
        size = path.stat().st_size / 1e6
        parsers = [n for n in ("pyarrow", "pandas") if suffix == ".csv" and find_spec(n)]
        for name in ("whole", *parsers):
            show(f"{suffix} {size:.0f} MB", name, run(name, path, rate))
        path.unlink()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", nargs=2, metavar=("NAME", "FILE"), help="one run, in this process")
    parser.add_argument("--rate", type=float, default=0.0)
    parser.add_argument("--days", default="1,3,7")
    parser.add_argument("--rates", default="50,100")
    options = parser.parse_args()
    if options.run:
        found = RUNS[options.run[0]](Path(options.run[1]), options.rate)
        print(json.dumps({"cpu": spent(), "peak": peak(), **found}))
        return
    names = ["whole", "imucal", *(n for n in PACKAGES if find_spec(n))]
    for name in names[2:]:
        try:
            print(f"{PACKAGES[name]} {version(PACKAGES[name])}")
        except PackageNotFoundError:
            print(f"{PACKAGES[name]}, version unknown")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.h5"
        make(path, 0.5, 50.0)
        run("whole", path, 50.0)  # bytecode of everything in place, as in an installed package
        for rate in (float(r) for r in options.rates.split(",")):
            for days in (float(d) for d in options.days.split(",")):
                make(path, days, rate)
                for name in names:
                    show(f"{days:g} d {rate:g} Hz", name, run(name, path, rate))
                if rate == 100.0 and days == 1.0:
                    show(f"{days:g} d {rate:g} Hz", "detection", run("detection", path, rate))
                    other_formats(path, rate)


if __name__ == "__main__":
    main()
