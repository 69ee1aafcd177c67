"""The fused array against its own chips: python benchmarks/array/fused.py ../shared/data/mimu4444.

One log's calibration fuses another log. Rows: residuals of the chips about the fused motion with
the other log's calibration and with the log's own; half of the difference of two sets of four
chips beside one chip over the root of eight; rates above a limit, with the readings cut there,
against the gyros that saw them; CPU time.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import read as read_calibration
from imucalib.calibration.file import to_yaml, write_whole
from imucalib.calibrators.array.board.board import read_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.fusion.fuse import Fused
from imucalib.calibrators.array.fusion.instrument import Stretch, instrument_of
from imucalib.calibrators.array.fusion.recording import fuse_stretch
from imucalib.calibrators.array.fusion.survey import Survey, side_by_side, survey
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.readers import read
from imucalib.units import DEG

Array = NDArray[np.float64]
GRAVITY = 9.8189  # m/s² where the logs were taken
HALVES = ((0, 3, 5, 6), (1, 2, 4, 7))  # chips of two sets that lie alike about the middle


def mad(values: Array) -> float:
    """1.4826 times the median absolute value."""
    return 1.4826 * float(np.median(np.abs(values)))


def calibration_of(data: Path, name: str, folder: Path) -> Calibration:
    """The calibration of a log, made once."""
    path = folder / f"{name}.yaml"
    if not path.exists():
        request = ArrayRequest(board=read_board("mimu4444_corners"), gravity=GRAVITY)
        run = calibrate_array(read(data / f"{name}.h5"), request, lambda _: None)
        write_whole(path, to_yaml(run.calibration))
    return read_calibration(path)


def looked_at(found: Calibration, path: Path) -> tuple[Survey, Stretch]:
    """What a first pass says, and the whole log side by side."""
    # Two sets of chips share what the calibration leaves open: here the noise alone counts.
    recording, instrument = read(path), replace(instrument_of(found), doubt=None)
    (stretch,) = side_by_side([recording], instrument)
    return survey([recording], instrument), stretch


def moving(fused: Fused) -> NDArray[np.bool_]:
    """Samples that turn, with every chip in range."""
    whole = fused.rate_live.all(axis=(1, 2)) & fused.live.all(axis=(1, 2))
    return np.asarray(whole & (np.linalg.norm(fused.motion.rate, axis=1) > 60.0 * DEG))


def half(found: Survey, stretch: Stretch, chips: tuple[int, ...]) -> Fused:
    """Fused from some of the chips."""
    out = [k for k in range(stretch.rate.shape[1]) if k not in chips]
    acceleration, rate = stretch.acceleration.copy(), stretch.rate.copy()
    acceleration[:, out] = rate[:, out] = np.nan
    return fuse_stretch(found, Stretch(stretch.t, acceleration, rate))


def residuals(label: str, found: Survey, stretch: Stretch) -> Fused:
    """Print and return."""
    start = time.process_time()
    fused = fuse_stretch(found, stretch)
    cost = 1e6 * (time.process_time() - start) / len(stretch.t)
    rows = moving(fused)
    print(f"| {label} | {mad(fused.rate_off[rows]) / DEG:.3f} | {mad(fused.off[rows]):.4f} | "
          f"{cost:.0f} |", flush=True)  # fmt: skip
    return fused


def halves(found: Survey, stretch: Stretch, fused: Fused) -> None:
    """Two sets of four chips against each other, in motion and at rest."""
    one, two = (half(found, stretch, chips) for chips in HALVES)
    rate = np.linalg.norm(fused.motion.rate, axis=1)
    doubt = one.motion.covariance + two.motion.covariance
    sd = np.sqrt(np.einsum("tii->ti", doubt))
    off = [one.motion.force - two.motion.force, one.motion.spin - two.motion.spin,
           one.motion.rate - two.motion.rate]  # fmt: skip
    for name, rows in (("motion", moving(fused)), ("rest", rate < 3.0 * DEG)):
        chip = mad(fused.rate_off[rows]) / np.sqrt(7.0 / 8.0) / DEG
        z = [mad(o[rows] / sd[rows, 3 * k : 3 * k + 3]) for k, o in enumerate(off)]
        print(f"| {name} | {mad(off[0][rows]) / 2:.4f} | {mad(off[1][rows]) / 2 / DEG:.1f} | "
              f"{mad(off[2][rows]) / 2 / DEG:.4f} | {chip / np.sqrt(8.0):.4f} | "
              f"{z[0]:.2f}, {z[1]:.2f}, {z[2]:.2f} |", flush=True)  # fmt: skip
    rows, late = moving(fused), delay_of(found)
    asked = off[2][rows] - late * off[1][rows]
    print(f"| motion, when the gyros read | | | {mad(asked) / 2 / DEG:.4f} | | |", flush=True)


def delay_of(found: Survey) -> float:
    """s, by which all gyros are late."""
    late = found.instrument.beyond.late(np.zeros(1), None)
    return 0.0 if late is None else -float(np.mean(late[0, :, range(3), range(3)]))


def beyond(found: Survey, stretch: Stretch, fused: Fused, limit: float) -> None:
    """Rates above a limit (deg/s) from readings that were cut there."""
    cut = np.clip(stretch.rate, -limit * DEG, limit * DEG)
    blind = replace(found, instrument=replace(found.instrument, gyroscope_range=limit * DEG))
    lost = fuse_stretch(blind, Stretch(stretch.t, stretch.acceleration, cut))
    rows = lost.alone & fused.rate_live.all(axis=(1, 2))
    true, off = fused.motion.rate[rows], (lost.motion.rate - fused.motion.rate)[rows]
    axes = np.abs(true) > limit * DEG
    share = float(np.median(off[axes] / true[axes]))
    wrong = 100.0 * float(np.mean(off[axes] / true[axes] < -1.0))
    sd = np.sqrt(np.einsum("tii->ti", lost.motion.covariance[rows])[:, 6:])
    high = float(np.percentile(np.abs(off[axes]), 95)) / DEG
    print(f"| {limit:.0f} | {int(rows.sum())} | {mad(off[axes]) / DEG:.1f} | {high:.0f} | "
          f"{share:+.4f} | {wrong:.2f} % | {mad(off[axes] / sd[axes]):.2f} |",
          flush=True)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--calibrations", type=Path, default=Path("calibrations"))
    options = parser.parse_args()
    options.calibrations.mkdir(parents=True, exist_ok=True)
    own = {n: calibration_of(options.data, n, options.calibrations)
           for n in ("exp_1", "exp_2", "exp_4", "exp_5")}  # fmt: skip
    print("| calibration of, log | gyros, deg/s | accelerometers, m/s² | CPU us a sample |")
    print("|---|---|---|---|")
    for old, new in (("exp_1", "exp_5"), ("exp_4", "exp_2")):
        found, stretch = looked_at(own[old], options.data / f"{new}.h5")
        fused = residuals(f"{old}, {new}", found, stretch)
        residuals(f"{new}, {new}", *looked_at(own[new], options.data / f"{new}.h5"))
        print("\n| two sets of four | force, m/s² | dω/dt, deg/s² | rate, deg/s | "
              "one chip / sqrt 8 | z |\n|---|---|---|---|---|---|")  # fmt: skip
        halves(found, stretch, fused)
        print("\n| limit, deg/s | samples | MAD, deg/s | 95 % | error of scale | wrong sign | z |")
        print("|---|---|---|---|---|---|---|")
        for limit in (500.0, 1000.0, 1500.0):
            beyond(found, stretch, fused, limit)
        print()


if __name__ == "__main__":
    main()
