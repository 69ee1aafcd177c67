"""Rests to add: when a few do not do, how many would, and when none do."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2, ncx2

from imucalib.calibration.checking.misfit import check_noise
from imucalib.calibration.checking.next_rests import MANY, next_rests
from worlds.stated import made

OWN, READING = 0.3, 1.0  # mg


def power(number: int, change: float) -> float:
    """Chance that `number` rests all round show a bias (mg): each sees a third of its square,
    beside the calibration's own doubt; by the bias alone at 5 %, the noise known."""
    var = READING**2 * 3.0 / number + OWN**2
    return float(ncx2.sf(chi2.isf(0.05, 3), 3, change**2 / var))


def test_how_many_rests_would_do() -> None:
    """More than a dozen, and as many as the bias alone says, or the next number: other kinds of
    change are asked for too."""
    calibration = made(np.zeros(6), np.diag([OWN**2] * 3 + [1e-8] * 3), 1e4)
    noise = check_noise(calibration)
    found = next_rests(calibration, None, noise, {"bias": 1.8}, directed=False)
    assert not found.enough
    least = next(n for n in MANY if power(n, 1.8) >= 0.9)
    assert found.many in MANY[MANY.index(least) : MANY.index(least) + 2]
