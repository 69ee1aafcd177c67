"""What an array's accelerometers drifted by while they were calibrated: undone in that recording.

A later recording has its own drift, and keeps the biases of the end of the rests.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.recording.recording import Recording

#: What it is called among the effects that a calibration does not undo.
DRIFT = "drift of the rests"


@dataclass(frozen=True)
class RestDrift:
    """t : (m,) s of the calibrated recording; offset : (m, K, 3) m/s² of readings in the sensors'
    own axes, beyond that of the last; straight between, and beyond the ends as there"""

    t: Array
    offset: Array

    def at(self, t: Array, imu: int) -> Array:
        """(n, 3) m/s² at times (n,) s."""
        own = self.offset[:, imu]
        return np.stack([np.interp(t, self.t, own[:, axis]) for axis in range(3)], axis=1)


def drift_block(t: Array, offset: Array) -> dict[str, Any]:
    """The drift as calibration.yaml has it, below `rests`; see `RestDrift`."""
    return {"t_s": t.tolist(), "m_per_s2": np.round(offset, 7).tolist()}


def rest_drift(calibration: Calibration, recording: Recording) -> RestDrift | None:
    """What is to be undone in a recording: None unless it is the one that was calibrated."""
    made_of = (calibration.facts.get("provenance") or {}).get("sha256")
    block = (calibration.facts.get("rests") or {}).get("drift")
    if block is None or made_of is None or made_of != recording.sha256:
        return None
    return RestDrift(np.array(block["t_s"], float), np.array(block["m_per_s2"], float))


def without_drift(
    recording: Recording, partner: Mapping[str, int], drift: RestDrift | None
) -> Recording:
    """The recording with its accelerations as they would read without the drift."""
    if drift is None:
        return recording
    channels = dict(recording.channels)
    for name, channel in recording.channels.items():
        if channel.quantity == "acceleration" and channel.triad in partner:
            more = drift.at(channel.t, partner[channel.triad])
            channels[name] = replace(channel, values=channel.values - more)
    return replace(recording, channels=channels)
