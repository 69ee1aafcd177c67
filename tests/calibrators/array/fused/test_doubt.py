"""A fused sample's covariance holds what the calibration leaves open: boards of plain numpy whose
calibration file is wrong by draws from what it states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibration.calibration import Calibration
from imucalib.calibrators.array.fused.fuse import Stretch
from imucalib.calibrators.array.fused.instrument import instrument_of
from imucalib.calibrators.array.fused.recording import Told, fused_stretch
from imucalib.calibrators.array.fused.survey import survey
from worlds.rigid_board import DEG, board, calibration, moves, readings, recording, turned_by

Array = NDArray[np.float64]
STILL, HZ = 6.0, 100.0
#: m of a coordinate, gain, m/s² of a bias, and of all: gravity, gyros' scale, rad of the frame.
PLACE, GAIN, BIAS, GRAVITY, SCALE, FRAME = 3e-5, 1e-3, 0.02, 1e-3, 2e-3, 1e-3


def wrong(truth: Calibration, rng: np.random.Generator) -> Calibration:
    """The file of a calibration that is off by draws of what it states."""
    facts, count = truth.facts, len(truth.triads)
    places = 1e-3 * np.array([row["mean"] for row in facts["positions_mm"]])
    k, gravity, turn = SCALE * rng.normal(), GRAVITY * rng.normal(), FRAME * rng.normal(size=3)
    places[1:] += PLACE * rng.normal(size=(count - 1, 3))
    # Readings (1 + k) ω and forces (1 + g) f give positions (1 + g) / (1 + k)² as large.
    found = turned_by(turn, places * (1.0 + gravity) / (1.0 + k) ** 2)
    own = found[1:].ravel()
    about = np.stack([np.cross(axis, found[1:]).ravel() for axis in np.eye(3)], axis=1)
    size = np.hypot(2.0 * SCALE, GRAVITY)
    covariance = PLACE**2 * np.eye(len(own)) + size**2 * np.outer(own, own)
    covariance += FRAME**2 * about @ about.T
    stated = np.diag([GAIN**2] * 9 + [BIAS**2] * 3)
    triads = []
    for triad in truth.triads:
        gain = triad.gain @ (np.eye(3) + GAIN * rng.normal(size=(3, 3))) / (1.0 + gravity)
        # What is corrected comes out in a frame that is turned.
        triads.append(replace(
            triad, gain=turned_by(turn, gain), gyro_gain=turned_by(turn, triad.gyro_gain)
            / (1.0 + k), bias=triad.bias + BIAS * rng.normal(size=3), covariance=stated,
        ))  # fmt: skip
    rows = [{"imu": t.name, "mean": (1e3 * found[i]).tolist()} for i, t in enumerate(triads)]
    told = {
        "positions_mm": rows,
        "size": {"sd_beyond_motion": size, "sd_of_gravity": GRAVITY},
        "gyro_scale": {"sd": SCALE},
        "frame": {"sd_deg": [FRAME / DEG] * 3},
    }
    return replace(
        truth, triads=tuple(triads), covariance=1e6 * covariance, facts={**facts, **told}
    )


def z_of(seed: int) -> Array:
    """(T, 9) errors of force, dω/dt and ω in motion, over what is stated."""
    rng = np.random.default_rng(seed)
    made = board(rng)
    motion = moves(rng, still=STILL, moving=6.0, hz=HZ, twist=400.0)
    read = readings(made, motion, rng)
    found = survey([recording(made, motion.t, *read)], instrument_of(wrong(calibration(made), rng)))
    fused = fused_stretch(found, Stretch(motion.t, *read), Told()).motion
    at = found.instrument.at[None]
    force = motion.force + np.cross(motion.rate, np.cross(motion.rate, at))
    force = force + np.cross(motion.spin, at)
    off = [fused.force - force, fused.spin - motion.spin, fused.rate - motion.rate]
    sd = np.sqrt(np.einsum("tii->ti", fused.covariance))
    return np.asarray((np.concatenate(off, axis=1) / sd)[motion.t > STILL + 2.0])


@pytest.mark.slow
def test_what_the_calibration_leaves_open_is_in_the_covariance() -> None:
    z = np.stack([z_of(seed) for seed in range(12)])
    force, spin, rate = (float(np.sqrt(np.mean(z[..., k : k + 3] ** 2))) for k in (0, 3, 6))
    # One draw a board: twelve of them know an rms to a tenth or two.
    assert 0.75 < force < 1.3
    assert 0.75 < rate < 1.3
    assert 0.75 < spin < 1.3
