"""Where a fused sample begins when no gyro is whole: axes in range speak, the others stand back."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.array.fused.start import _guessed


def turned(deg: float) -> np.ndarray:
    """Axes of a chip turned about z, one in a row."""
    c, s = np.cos(np.radians(deg)), np.sin(np.radians(deg))
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def test_axes_in_range_give_the_rate_that_no_chip_sees_whole() -> None:
    """x of one chip is clipped and y of another, turned by 30 deg: the others suffice."""
    axes = np.stack([np.eye(3), turned(30.0)])
    true = np.array([[40.0, 5.0, -3.0], [-38.0, 7.0, 2.0]])
    reading = np.einsum("kij,tj->tki", axes, true)
    clipped = np.zeros((2, 2, 3), bool)
    clipped[:, 0, 0] = clipped[:, 1, 1] = True
    said = np.where(clipped, np.sign(reading) * 35.0, reading)
    # What `said` holds is in the board's axes, as all of a start.
    board = np.einsum("kij,tki->tkj", axes, said)
    first, alone = _guessed(axes, board, ~clipped, clipped)
    np.testing.assert_allclose(first, true, rtol=1e-4)
    assert not alone.any()


def test_what_no_gyro_sees_lies_a_little_beyond_the_range() -> None:
    axes = np.stack([np.eye(3), np.eye(3)])
    clipped = np.zeros((1, 2, 3), bool)
    clipped[..., 0] = True
    board = np.tile([35.0, 5.0, -3.0], (1, 2, 1))
    first, alone = _guessed(axes, board, ~clipped, clipped)
    np.testing.assert_allclose(first, [[1.15 * 35.0, 5.0, -3.0]], rtol=1e-4)
    assert alone.all()
