"""What one over the root of eight could be: python benchmarks/array/fused_bound.py DATA.

The measure of `fused.py`, half of the difference of two sets of four chips over one chip by its
residuals, on boards that are calibrated perfectly: the motion, the noise's size and the clocks are
those of a measured log, the noise itself is drawn, with tails and without, and all gyros are late
alike or by clocks of their own. Here the truth is known too.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from fused import (
    DEG,
    HALVES,
    Array,
    calibration_of,
    delay_of,
    half,
    looked_at,
    mad,
    moving,
)

from imucalib.calibrators.array.fusion.fuse import Fused
from imucalib.calibrators.array.fusion.instrument import Instrument, Stretch
from imucalib.calibrators.array.fusion.recording import fuse_stretch
from imucalib.calibrators.array.fusion.survey import Survey, ages
from imucalib.estimators.array.noise import ChipNoise

CASES = {
    "Gaussian noise, one delay": (np.inf, False),
    "Gaussian noise, own clocks": (np.inf, True),
    "t₃ noise, one delay": (3.0, False),
    "t₃ noise, own clocks": (3.0, True),
}


def perfect(instrument: Instrument) -> Instrument:
    """One whose chips read in board axes and have no error but what is late."""
    none, one = np.zeros(3), np.eye(3)
    triads = tuple(
        replace(t, rotation=one, gain=one, bias=none, gyro_gain=one, gyro_bias=none)
        for t in instrument.triads
    )
    beyond = replace(instrument.beyond, parts=tuple(p for p in instrument.beyond.parts if p.late))
    return replace(
        instrument, triads=triads, biases=None, beyond=beyond,
        accelerometer_range=np.inf, gyroscope_range=np.inf,
    )  # fmt: skip


def drawn(noise: ChipNoise, speed: Array, rng: np.random.Generator) -> Array:
    made = rng.normal(size=(len(speed), len(noise.rest), 3))
    if np.isfinite(noise.freedom):
        made /= np.sqrt(rng.chisquare(noise.freedom, (*made.shape[:2], 1)) / noise.freedom)
    return np.asarray(made * np.sqrt(noise.variance(speed)))


def told(label: str, found: Survey, stretch: Stretch, fused: Fused, rows: Array) -> None:
    late = delay_of(found)
    one, two = (half(found, stretch, chips).motion for chips in HALVES)
    off = ((one.rate - two.rate) - late * (one.spin - two.spin))[rows] / 2.0
    chip = mad(fused.rate_off[rows]) / np.sqrt(7.0)
    print(f"| {label} | {mad(off) / DEG:.3f} | {chip / DEG:.3f} | {mad(off) / chip:.3f} |",
          end=" ")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--calibrations", type=Path, default=Path("calibrations"))
    options = parser.parse_args()
    options.calibrations.mkdir(parents=True, exist_ok=True)
    print("| board | halves, deg/s | one chip / √8 | ratio | truth over true chip / √8: MAD, rms |")
    print("|---|---|---|---|---|")
    for old, new in (("exp_1", "exp_5"), ("exp_4", "exp_2")):
        calibration = calibration_of(options.data, old, options.calibrations)
        found, stretch = looked_at(calibration, options.data / f"{new}.h5")
        fused = fuse_stretch(found, stretch)
        rows, true, late = moving(fused), fused.motion, delay_of(found)
        told(f"{old}, {new}, measured", found, stretch, fused, rows)
        print("|", flush=True)
        age = ages(found.instrument, stretch, found.noise)
        assert age is not None
        speed, rng = np.linalg.norm(true.rate, axis=1), np.random.default_rng(1)
        for label, (freedom, own) in CASES.items():
            plain = perfect(found.instrument)
            if not own:
                plain = replace(plain, beyond=replace(plain.beyond, span=0.0))
            by = plain.beyond.late(stretch.t, np.nan_to_num(age) if own else None)
            assert by is not None
            noise = tuple(replace(n, freedom=freedom) for n in found.noise)
            shaken, turned = (drawn(n, speed, rng) for n in noise)
            rate = true.rate[:, None] + np.matmul(by, true.spin[:, None, :, None])[..., 0]
            made = Stretch(stretch.t, true.predict_force(plain.r) + shaken, rate + turned)
            seen = replace(found, instrument=plain, noise=(noise[0], noise[1]))
            again = fuse_stretch(seen, made)
            told(label, seen, made, again, rows)
            off = (again.motion.rate - true.rate - late * (again.motion.spin - true.spin))[rows]
            ideal = turned[rows] / np.sqrt(8.0)
            rms = np.sqrt(np.mean(off**2) / np.mean(ideal**2))
            print(f"{mad(off) / mad(ideal):.3f}, {rms:.3f} |", flush=True)


if __name__ == "__main__":
    main()
