"""A converter that is coarser than its noise repeats itself at rest: that hides no rest, and what
is held of a sensor whose noise shows is none."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.inspection.inspection import inspect_recording
from imucalib.units import MG
from worlds.recordings import recording_of
from worlds.turned import RATE, REST, TURN, turned

TURNS = 12


def _rests(step: float, noise: float, seed: int, held: range = range(0)) -> NDArray[np.float64]:
    """Where rests begin (s) of a sensor whose readings are held in some of its TURNS + 1 rests."""
    t, acc, rate = turned(TURNS, noise=noise, seed=seed)
    acc = np.round(acc / step) * step
    for k in held:
        first = round(k * (REST + TURN) * RATE)
        rest = slice(first, first + round(REST * RATE))
        acc[rest] = acc[rest.start]
    found = inspect_recording(iter([recording_of(t, acc, rate)])).still
    return np.empty(0) if found is None else found.start


@pytest.mark.parametrize("step", [8 * MG, 16 * MG, 32 * MG])
@pytest.mark.parametrize("share", [0.02, 0.03, 0.06, 0.1])
def test_every_rest_of_a_coarse_converter_is_found(step: float, share: float) -> None:
    """share : of the noise in a step"""
    for seed in range(6):
        assert len(_rests(step, share * step, seed)) == TURNS + 1, seed


@pytest.mark.parametrize("share", [0.4, 0.6, 1.0])
@pytest.mark.parametrize("held", [range(6), range(10)])
def test_what_is_held_of_a_live_sensor_is_no_rest(share: float, held: range) -> None:
    for seed in range(3):
        assert len(_rests(4 * MG, share * 4 * MG, seed, held)) == TURNS + 1 - len(held), seed
