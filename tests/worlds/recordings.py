"""Recordings of one triad, made of arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.recording.recording import Channel, Recording


def recording_of(
    t: Array, acc: Array | None = None, rate: Array | None = None,
    warm: Array | tuple[Array, Array] | None = None, *, hz: float | None = None, **more: Any,
) -> Recording:  # fmt: skip
    """t : (n,) s; acc, rate : (n, 3) m/s² and rad/s; warm : (n,) °C, or times and readings of a
    thermometer of its own; hz : as t says unless given; more : fields of the recording"""
    clock, degrees = warm if isinstance(warm, tuple) else (t, warm)
    channels = {}
    for quantity, unit, at, values in (
        ("acceleration", "m/s2", t, acc),
        ("angular_rate", "rad/s", t, rate),
        ("temperature", "degC", clock, None if degrees is None else degrees[:, None]),
    ):
        if values is not None:
            own = hz if hz and (at is t or len(at) < 2) else 1.0 / float(np.median(np.diff(at)))
            channels[f"imu0/{quantity}"] = Channel(at, values, unit, quantity, "imu0", own)
    return Recording(channels, "made", "made", "", **more)
