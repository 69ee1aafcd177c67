"""What the angle columns of a whole sheet mean, under every convention of the trade."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.core.angle_conventions import Conventions
from imucalib.posterior.sheet.conventions import AngleMeaning, misread_angles
from imucalib.posterior.sheet.sheet import Sheet
from worlds import sheets

ZEROS = ("+x", "-x", "+y", "-y")


def columns(*, rings: int, zero: str, vertical: bool, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles (n,), deg, of rings of six tool-faces, and what a sensor with an ordinary warm-up
    reads, when tool-face counts from one of the axes."""
    rng = np.random.default_rng(seed)
    i = np.repeat(np.linspace(-80.0, 80.0, rings), 6)
    t = np.tile(np.arange(0.0, 360.0, 60.0), rings)
    turn = {"+y": 0.0, "+x": 90.0, "-y": 180.0, "-x": 270.0}[zero]
    truth = sheets.direction(
        i + rng.normal(0.0, 0.03, i.size), t + turn + rng.normal(0.0, 0.03, i.size)
    )
    order = np.linspace(0.0, 1.0, i.size)[:, None]
    reading = 1000.0 * truth + 3.0 * order * [1.0, -1.0, 0.5] + rng.normal(0.0, 0.4, (i.size, 3))
    return np.column_stack([90.0 - i if vertical else i, t]), reading


def sheet_of(angles: np.ndarray, reading: np.ndarray) -> Sheet:
    every = np.arange(len(reading))
    i, t = angles.T
    return Sheet(
        reading, i, t, every + 1, every, 1000.0, i, t, inside=Conventions().inside, ordered=True
    )


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("zero", ZEROS)
@pytest.mark.parametrize("rings", [4, 8])
def test_where_tool_face_counts_from_is_no_row_that_slipped(
    rings: int, zero: str, seed: int
) -> None:
    """A ring of equal steps reads the same a step on: a column that moved by a row is the same
    sheet as one that counts from elsewhere, and fewer things went wrong in the latter."""
    for vertical in (False, True):
        found = misread_angles(
            sheet_of(*columns(rings=rings, zero=zero, vertical=vertical, seed=seed))
        )
        meaning = AngleMeaning() if found is None else found.meaning
        assert meaning == AngleMeaning(vertical=vertical)


@pytest.mark.parametrize("seed", range(5))
def test_a_blunder_in_the_last_row_moves_no_column(seed: int) -> None:
    angles, reading = columns(rings=6, zero="+y", vertical=False, seed=seed)
    reading[-1] *= -1.0
    assert misread_angles(sheet_of(angles, reading)) is None


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("zero", ZEROS)
def test_a_false_row_does_not_hide_where_inclination_counts_from(zero: str, seed: int) -> None:
    angles, reading = columns(rings=4, zero=zero, vertical=True, seed=seed)
    k = int(np.argmax(np.abs(reading[:, 1])))
    reading[k, 1] *= -1.0
    found = misread_angles(sheet_of(angles, reading))
    assert found is not None
    assert found.meaning == AngleMeaning(vertical=True)
