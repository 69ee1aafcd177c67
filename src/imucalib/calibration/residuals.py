"""What a recording's rests read before and after a calibration, against gravity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.apply import apply_to_recording
from imucalib.calibration.calibration import Calibration
from imucalib.errors import Undetermined
from imucalib.recording.recording import REST, Channel, Recording
from imucalib.rests.segments import Segments, still_segments
from imucalib.units import MG


def add_residuals(
    calibration: Calibration,
    recording: Recording,
    sensor: str = "",
    *,
    use: str | None = None,
    again: bool = False,
) -> Recording:
    """The corrected sensors of a recording, each with a channel "<triad>/rest" of its rests: t (n,)
    their middles, s, and values (n, 9) as in `REST_COLUMNS`.

    Options and errors as in `apply_to_recording`; Undetermined where the recording has no rest.
    """
    corrected = apply_to_recording(calibration, recording, sensor, use=use, again=again)
    rests = still_segments(recording)
    if rests.n == 0:
        raise Undetermined(
            "no rest, so there is no residual against gravity",
            where=recording.path,
            remedy="`imucal inspect FILE --rests` tells what refused them",
        )
    changed = {
        channel.triad
        for name, channel in corrected.channels.items()
        if channel.quantity == "acceleration" and channel is not recording.channels.get(name)
    }
    kept = {n: c for n, c in corrected.channels.items() if c.triad in changed}
    for name, channel in tuple(kept.items()):
        if channel.quantity != "acceleration":
            continue
        k = rests.triads.index(channel.triad)
        scale = 1.0 if recording.channels[name].unit == "m/s2" else calibration.raw_to_si
        after = rests.means(channel.values, k)
        values = _rows(rests, scale * rests.mean[:, k], after, calibration.gravity)
        made = Channel(rests.middle, values, "", REST, channel.triad, 0.0)
        kept[f"{channel.triad}/{REST}"] = made
    return replace(corrected, channels=kept)


def _rows(rests: Segments, before: Array, after: Array, gravity: float) -> Array:
    sizes = (np.linalg.norm(vector, axis=1) for vector in (before, after))
    residuals = [(size - gravity) / MG for size in sizes]
    return np.column_stack([rests.stop - rests.start, before, after, *residuals])
