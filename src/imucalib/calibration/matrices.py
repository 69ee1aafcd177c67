"""The linear part of a calibration as matrices, and its intrinsic (frame-free) quantities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.core.model import Model
from imucalib.units import DEG, MG


@dataclass(frozen=True)
class Matrices:
    """corrected = M raw + b and raw = S corrected + c, raw and corrected in m/s².

    scale : (3,) length of S's rows, sensitivity of each axis; angle : (3,) deg between the sensing
    axes xy, xz, yz. Both are free of the frame: a rotation of the tool does not change them.
    *_sd : standard deviations, same shapes
    """

    M: Array
    b: Array
    S: Array
    S_sd: Array
    c: Array
    M_sd: Array
    b_sd: Array
    scale: Array
    scale_sd: Array
    angle: Array
    angle_sd: Array
    bias_mg: Array
    bias_mg_sd: Array

    def as_dict(self) -> dict[str, Any]:
        pairs = ("xy", "xz", "yz")
        return {
            "corrected_from_raw": {
                "formula": "a = M raw + b, m/s2",
                "M": self.M.tolist(),
                "b": self.b.tolist(),
                "M_sd": self.M_sd.tolist(),
                "b_sd": self.b_sd.tolist(),
            },
            "raw_from_corrected": {
                "formula": "raw = S a + c, m/s2",
                "S": self.S.tolist(),
                "c": self.c.tolist(),
            },
            "intrinsic": {
                "scale": self.scale.tolist(),
                "scale_sd": self.scale_sd.tolist(),
                "axis_angle_deg": dict(zip(pairs, self.angle.tolist(), strict=True)),
                "axis_angle_sd_deg": dict(zip(pairs, self.angle_sd.tolist(), strict=True)),
            },
        }


def matrices(model: Model, theta: Array, covariance: Array) -> Matrices:
    """Linear part of a correcting model (K = 1) at zero force; standard deviations to first order.

    model, theta : without fixture effects; covariance : (p, p) of θ
    """
    linear = Model(tuple(e for e in model.effects if not e.needs and e.name in _LINEAR))
    context = Context(1)
    slices, own = model.slices(context), linear.slices(context)
    # Only effects whose derivative is free of covariates make up the matrices.
    pick = np.concatenate(
        [np.arange(slices[n].start, slices[n].stop) for n in own] or [np.zeros(0, int)]
    )
    pick = pick.astype(int)

    def pieces(values: Array) -> Array:
        prediction = linear.predict(values, np.zeros((1, 1, 3)), context)
        sensitivity, offset = prediction.d_truth[0, 0], prediction.reading[0, 0]
        inverse = np.linalg.inv(sensitivity)
        length = np.linalg.norm(sensitivity, axis=1)
        unit = sensitivity / length[:, None]
        cosines = [unit[0] @ unit[1], unit[0] @ unit[2], unit[1] @ unit[2]]
        return np.concatenate(
            [inverse.ravel(), -inverse @ offset, sensitivity.ravel(), offset, length,
             np.arccos(cosines) / DEG, offset / MG]
        )  # fmt: skip

    start = theta[pick]
    value = pieces(start)
    slope = np.zeros((value.size, start.size))
    for k in range(start.size):
        step = np.zeros(start.size)
        step[k] = 1e-5 * max(1.0, abs(float(start[k])))
        slope[:, k] = (pieces(start + step) - pieces(start - step)) / (2.0 * step[k])
    sd = _sd(slope, covariance[np.ix_(pick, pick)])
    return Matrices(
        M=value[:9].reshape(3, 3),
        b=value[9:12],
        S=value[12:21].reshape(3, 3),
        S_sd=sd[12:21].reshape(3, 3),
        c=value[21:24],
        M_sd=sd[:9].reshape(3, 3),
        b_sd=sd[9:12],
        scale=value[24:27],
        scale_sd=sd[24:27],
        angle=value[27:30],
        angle_sd=sd[27:30],
        bias_mg=value[30:33],
        bias_mg_sd=sd[30:33],
    )


def _sd(slope: Array, covariance: Array) -> Array:
    variance = np.einsum("ik,kl,il->i", slope, covariance, slope)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


_LINEAR = ("mounting", "bias", "scale", "non_orthogonality")
