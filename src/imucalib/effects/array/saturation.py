"""Gyros that read less and less of the rate as it grows towards the end of their range."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Response, Truth
from imucalib.units import DEG

_FULL = 2000.0 * DEG


def _odd(truth: Truth, context: Context) -> Array:
    """Of a tanh of 1500 deg/s at 700 deg/s rms a cube leaves 24 deg/s, two powers 6. With a third
    (2) one gyro's bend passed for that of all more often: one board of seven was 0.35 % too large.
    """
    share = truth.turning.rate / _FULL
    out = np.zeros((*truth.shape, 6))
    for i in range(3):
        for column, power in ((i, 3), (3 + i, 5)):
            out[..., i, column] = DEG * share[..., i] ** power
    return out


EFFECTS = (
    Response(
        "gyro_saturation",
        "The gyros read less of a fast rate, more and more so towards the end of their range.",
        "y_i = ω_i + k_i (ω_i / 2000 deg/s)³ + l_i (ω_i / 2000 deg/s)⁵",
        "2500 deg/s · tanh(ω / 2500 deg/s): -427 and 109 deg/s at 2000 deg/s",
        "Turn slowly and fast about each axis; leave some of the range unused.",
        ("rate",),
        tuple(
            Parameter(f"gyro_saturation_{power}_{axis}", "deg/s", 40.0, 2000.0)
            for power in ("third", "fifth")
            for axis in "xyz"
        ),
        _odd,
        channel="angular_rate",
        scan=True,
    ),
)
