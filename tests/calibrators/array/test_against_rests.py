"""Rests speak against a name that they would have shown."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.calibrators.array.against_rests import _contradicted
from imucalib.calibrators.array.loop.motion import motion_at_rest
from imucalib.calibrators.array.loop.terms import Term
from imucalib.effects import catalogue
from imucalib.units import DEG

IMUS = ("imu0", "imu1")


@pytest.mark.parametrize(("share", "contradicted"), [(1.0, False), (0.8, False), (0.0, True)])
def test_an_effect_of_the_force_must_show_in_gravity(share: float, contradicted: bool) -> None:
    rng = np.random.default_rng(4)
    ways = rng.normal(size=(12, 3))
    force = 9.8 * np.repeat((ways / np.linalg.norm(ways, axis=1)[:, None])[:, None], 2, axis=1)
    motion = motion_at_rest(IMUS, np.tile(np.eye(3), (2, 1, 1)), force, np.arange(12.0))
    effect = catalogue()["gyro_g_sensitivity"]
    count = len(effect.parameters(motion.context))
    term = Term("gyro_g_sensitivity", effect, None, np.eye(count), 0.1 * rng.normal(size=count),
                np.ones(count))  # fmt: skip
    made = term.reading(term.columns(motion))
    assert np.abs(made).max() > 0.05 * DEG
    rate = share * made + 0.01 * DEG * rng.normal(size=made.shape)
    assert _contradicted(term, motion, rate) == contradicted


def test_what_needs_the_spin_shows_in_no_rest() -> None:
    effect = catalogue()["gyro_delay"]
    term = Term("gyro_delay", effect, None, np.eye(1), np.ones(1), np.ones(1))
    force = np.random.default_rng(0).normal(size=(6, 2, 3))
    motion = motion_at_rest(IMUS, np.tile(np.eye(3), (2, 1, 1)), force, np.arange(6.0))
    assert not _contradicted(term, motion, np.zeros((6, 2, 3)))
