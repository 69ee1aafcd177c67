"""Gyros that read more of one direction of turning than of the other."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Response, Truth, own_axis, three


def _sizes(truth: Truth, context: Context) -> Array:
    return own_axis(0.01 * np.abs(truth.turning.rate))


EFFECTS = (
    Response(
        "gyro_asymmetry",
        "The gyros' scale differs between the two directions of turning.",
        "y_i = ω_i + k_i |ω_i|",
        "IEEE Std 528, asymmetry error",
        "Turn both ways about each axis, slowly and fast.",
        ("rate",),
        three("gyro_asymmetry", "%", 0.2, 5.0),
        _sizes,
        channel="angular_rate",
        scan=True,
    ),
)
