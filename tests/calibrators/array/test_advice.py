"""What the noise in motion asks of the user: which chip shakes, and which is bad at rest too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.array.findings import advice
from imucalib.recording.recording import Recording
from worlds.array_stories import PLAN, closed, moving_of, planted_log


def _shaking(recording: Recording, *, at_rest: bool) -> Recording:
    """The accelerometer of the fourth IMU with noise of 0.12 m/s² more, in motion or always."""
    name = [n for n, c in recording.channels.items() if c.quantity == "acceleration"][3]
    channel = recording.channels[name]
    where = at_rest | (channel.t > PLAN.poses * PLAN.pose_seconds)
    more = 0.12 * np.random.default_rng(1).normal(size=channel.values.shape) * where[:, None]
    channels = {**recording.channels, name: replace(channel, values=channel.values + more)}
    return replace(recording, channels=channels)


@pytest.mark.slow
@pytest.mark.parametrize("at_rest", [False, True])
def test_the_chip_that_shakes_is_named(at_rest: bool) -> None:
    recording = _shaking(planted_log("clean", 5)[0], at_rest=at_rest)
    told = advice(closed(recording, 150), moving_of(recording)[1])
    assert len(told) == 1
    assert "accelerometer of imu3 is " in told[0]
    assert ("exchange the chip" if at_rest else "loose mount") in told[0]
