"""Where the postures of a worn sensor begin, among its still windows."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Index
from imucalib.rests.windows import Windows
from imucalib.units import MG

_CHANGE = 20.0 * MG  # between neighbouring windows of one posture, at most
_REACH = 30.0 * MG  # between any window of a run and its first


def postures_begin(w: Windows, chosen: Index) -> Index:
    """Positions in `chosen` where a run begins: a gap, a jump, or too far from its start."""
    reading = w.mean[chosen]
    apart = (np.diff(chosen) > 1) | (np.diff(w.run[chosen]) != 0)
    apart |= np.linalg.norm(np.diff(reading, axis=0), axis=1) > _CHANGE
    starts = np.concatenate([[0], np.flatnonzero(apart) + 1])
    while True:
        owner = np.repeat(starts, np.diff(np.append(starts, chosen.size)))
        far = np.linalg.norm(reading - reading[owner], axis=1) > _REACH
        if not far.any():
            return starts.astype(np.intp)
        # The first far window of each run begins a new one.
        first = np.unique(owner[far], return_index=True)[1]
        starts = np.union1d(starts, np.flatnonzero(far)[first])
