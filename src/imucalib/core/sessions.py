"""What changes from one power-up to the next: a bias, and where readings have known directions the
mounting too, as random errors that all readings of a session share.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.observations import Observations, SharedNoise

BIAS, MOUNTING = "session bias", "session mounting"


def with_sessions(data: Observations, session: Index) -> Observations:
    """The observations with the errors that sessions share as variance components (m/s² and rad).

    session : (n,) number of each observation's session, from 0; of one alone nothing can be told
    """
    one = np.eye(int(session.max()) + 1)[session]
    if one.shape[1] < 2:
        return data
    found = [SharedNoise(BIAS, one, math.inf)]
    if data.reference.directed:
        found.append(SharedNoise(MOUNTING, one, math.inf, basis=turned(data.reading[:, 0])))
    return replace(data, shared=(*found, *data.shared))


def session_of(data: Observations) -> Index | None:
    """(n,) number of each observation's session, or None where there is only one."""
    of = data.of_sessions
    return np.argmax(of[0].factor, axis=1).astype(np.intp) if of else None


def turned(reading: Array) -> Array:
    """(n, 3, 3) what a small turn φ (rad) does to readings (n, 3): φ × reading."""
    x, y, z = reading.T
    zero = np.zeros_like(x)
    rows = ((zero, z, -y), (-z, zero, x), (y, -x, zero))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)
