"""The rests of an array's IMUs against their linear corrections, each IMU by itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.misfit import Misfits, Part
from imucalib.calibration.checking.noise import CheckNoise
from imucalib.calibration.triads import Triad
from imucalib.core.references import tangents
from imucalib.units import DEG, MG


@dataclass(frozen=True)
class GyroRest:
    """A gyroscope at rest. bias : (3,) deg/s that it reads beyond its calibrated bias; sd : (3,)
    by the scatter between rests, the calibration's rests included; p : of no change, the smallest
    of its axes times three"""

    bias: Array
    sd: Array
    p: float


def triad_misfits(
    calibration: Calibration, triad: Triad, reading: Array, noise: CheckNoise, more: Array
) -> Misfits:
    """Misfits of one IMU. reading : (n, 3) m/s² in package axes, one a rest; more : (n,) (m/s²)²,
    variance of a rest beyond the array's usual one.

    reading = gain · force + bias in board axes; what its direction is, is not known.
    """
    n = len(reading)
    seen = reading @ triad.rotation.T
    force = np.linalg.solve(triad.gain, (seen - triad.bias).T).T
    direction = force / np.linalg.norm(force, axis=1, keepdims=True)
    truth = calibration.gravity * direction
    across = triad.gain @ tangents(direction)
    keep = np.cross(across[..., 0], across[..., 1])
    keep = keep / np.linalg.norm(keep, axis=1, keepdims=True)
    slope = np.concatenate(
        [np.einsum("ij,nk->nijk", np.eye(3), truth).reshape(n, 3, 9),
         np.broadcast_to(np.eye(3), (n, 3, 3))], axis=2,
    )  # fmt: skip
    jacobian = np.einsum("ni,nip->np", keep, slope)
    bias = MG * keep
    return Misfits(
        value=np.einsum("ni,ni->n", keep, seen - truth @ triad.gain.T - triad.bias),
        reading=Part(np.diag(noise.reading.sd**2 + more), noise.reading.dof),
        setting={},
        session=noise.session,
        jacobian=jacobian,
        parameters=triad.covariance,
        changes={"bias": bias, "scale": 1e-3 * keep * truth},
        owner=np.arange(n, dtype=np.intp),
        label=tuple(f"rest {k + 1}" for k in range(n)),
        force=np.asarray(force, np.float64),
        directed=False,
    )


def gyro_rest(triad: Triad, rate: Array, rests: Mapping[str, float]) -> GyroRest | None:
    """rate : (n, 3) rad/s in package axes, one a rest; rests : of the calibration, its block.

    None where fewer than three rests have a rate: their scatter is the only noise that counts.
    """
    from scipy.special import stdtr

    known = rate[np.isfinite(rate).all(axis=1)]
    if len(known) < 3:
        return None
    moved = triad.rate(known) / DEG
    before = float(rests.get("count") or len(known))
    sd = moved.std(axis=0, ddof=1) * np.sqrt(1.0 / len(known) + 1.0 / before)
    sd = np.maximum(sd, 1e-12)
    each = 2.0 * stdtr(len(known) - 1, -np.abs(moved.mean(axis=0)) / sd)
    return GyroRest(moved.mean(axis=0), sd, float(min(1.0, 3.0 * each.min())))
