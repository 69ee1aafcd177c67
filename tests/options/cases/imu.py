"""Cases of `imucal imu` alone."""

from __future__ import annotations

import numpy as np

from options.bench import Bench
from options.case import USUAL, Case, Of, ends, values
from options.outcome import Outcome

IMU = Of("imu")


def _as_in_order(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Exchanged axes named as what they are give what the right order gives."""
    assert without.code == 3
    right, found = values(bench.run(USUAL["imu"])), values(done)
    for name, value in right.items():
        assert np.isclose(found[name], value, rtol=1e-3, atol=1e-4), name


CASES: tuple[Case, ...] = (
    IMU("--gyro-axes y,x,z", _as_in_order, "imu", "<turned_axes.csv>", "--no-loop", "--json"),
    IMU("--gyro-axes y,y,z", ends(2, "once each")),
    IMU("--shortest-rest 100", ends(3, "too short")),
    IMU("--shortest-rest nan", ends(2)),
)
