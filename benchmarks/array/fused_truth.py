"""The fused array against a truth that is known: python benchmarks/array/fused_truth.py.

Boards and readings are those of `tests/worlds/rigid_board.py`, plain numpy that shares no physics
with the program. Rows: rms errors of rate and force over what equal or unequal chips can give
together, and z, the errors over their stated standard deviations.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.calibrators.array.fusion.instrument import Stretch, instrument_of
from imucalib.calibrators.array.fusion.recording import fuse_stretch
from imucalib.calibrators.array.fusion.survey import survey

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from worlds.rigid_board import DEG, G, board, calibration, moves, readings, recording

Array = NDArray[np.float64]
STILL, MOVING, HZ = 15.0, 30.0, 100.0
UNEQUAL = np.array([1.0, 1.0, 2.0, 4.0, 1.0, 1.0, 1.0, 0.5])
SETTINGS: dict[str, dict[str, object]] = {
    "8 chips, 250 deg/s": {},
    "8 chips, 700 deg/s": {"twist": 700.0},
    "8 chips of unequal noise": {"sigma": 0.04 * UNEQUAL, "gyro_sigma": 0.2 * DEG * UNEQUAL},
    "8 chips, elements and g-sensitivity": {"more": True},
    "3 chips": {"chips": 3},
    "2 chips": {"chips": 2},
    "32 chips": {"chips": 32},
    "8 chips, gyros to 500 deg/s": {"twist": 600.0, "ranges": (16 * G, 500.0 * DEG)},
}


def errors(
    seed: int, options: dict[str, object]
) -> tuple[Array, Array, Array, tuple[float, float]]:
    """(T, 9) errors in motion and their z, (T,) which lost a rate, ideal sd of rate and force."""
    rng = np.random.default_rng(seed)
    given = dict(options)
    twist = float(given.pop("twist", 250.0))  # type: ignore[arg-type]
    if given.pop("more", False):
        given["element"] = 3e-4 * rng.normal(size=(3, 3))
        given["by_force"] = 0.15 * DEG / G * rng.normal(size=(8, 3, 3))
    made = board(rng, **given)  # type: ignore[arg-type]
    motion = moves(rng, still=STILL, moving=MOVING, hz=HZ, twist=twist)
    read = readings(made, motion, rng)
    found = survey([recording(made, motion.t, *read)], instrument_of(calibration(made)))
    fused = fuse_stretch(found, Stretch(motion.t, *read))
    at = found.instrument.at[None]
    force = motion.force + np.cross(motion.rate, np.cross(motion.rate, at))
    force = force + np.cross(motion.spin, at)
    own = fused.motion
    off = np.concatenate([own.force - force, own.spin - motion.spin, own.rate - motion.rate], 1)
    z = off / np.sqrt(np.einsum("tii->ti", own.covariance))
    rows = motion.t > STILL + 2.5
    ideal = [float(np.sum(v**-2.0) ** -0.5) for v in (made.gyro_sigma, made.sigma)]
    return off[rows], z[rows], fused.alone[rows], (ideal[0], ideal[1])


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    options = parser.parse_args()
    print("| board | rate / ideal | force / ideal | z force, dω/dt, rate | rate lost, deg/s, z |")
    print("|---|---|---|---|---|")
    for name, given in SETTINGS.items():
        found = [errors(seed, given) for seed in range(options.seeds)]
        off, z = (np.concatenate([f[i] for f in found]) for i in (0, 1))
        lost = np.concatenate([f[2] for f in found]).astype(bool)
        ideal = found[0][3]
        seen = ~lost
        parts = [rms(z[seen, k : k + 3]) for k in (0, 3, 6)]
        alone = "-"
        if lost.any():
            alone = f"{rms(off[lost, 6:]) / DEG:.2f}, {rms(z[lost, 6:]):.2f}"
        over = rms(off[seen, 6:]) / ideal[0], rms(off[seen, :3]) / ideal[1]
        told = ", ".join(f"{part:.3f}" for part in parts)
        print(f"| {name} | {over[0]:.3f} | {over[1]:.3f} | {told} | {alone} |", flush=True)


if __name__ == "__main__":
    main()
