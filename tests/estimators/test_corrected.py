"""Objectives on the corrected reading by their definition, and their slopes."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.core.references import KnownVector
from imucalib.estimators.corrected import OBJECTIVES
from imucalib.units import DEG
from worlds.sheets import direction

G = 9.8


def world() -> tuple[np.ndarray, KnownVector, np.ndarray, np.ndarray]:
    """Corrected readings (n, 3) near their reference; two rows near +y, one of +z, none of +x."""
    rng = np.random.default_rng(1)
    i = np.array([0.1, 89.8, 0.0, 30.0, -45.0, 70.0, -10.0])
    t = np.array([0.2, 40.0, 359.9, 100.0, 200.0, 300.0, 359.0])
    setting = np.arange(len(i))
    reference = KnownVector(i * DEG, t * DEG, G, setting, setting)
    return G * direction(i, t) + 0.05 * rng.normal(size=(len(i), 3)), reference, i, t


def test_the_papers_is_its_equation_5() -> None:
    """The first row within half a degree of an axis as a vector, every row by its norm."""
    corrected, reference, *_ = world()
    found, _ = OBJECTIVES["paper"](corrected, reference)
    size = np.sqrt(np.sum(corrected**2, axis=1)) / G - 1.0
    y, z = corrected[0] / G - [0.0, 1.0, 0.0], corrected[1] / G - [0.0, 0.0, 1.0]
    np.testing.assert_allclose(found, [*size, *y, *z], atol=1e-14)


def test_that_of_angles_weighs_the_tool_face_by_the_cosine_of_the_inclination() -> None:
    """In rad, the tool-face by the shorter way round."""
    corrected, reference, i, t = world()
    found, _ = OBJECTIVES["angles"](corrected, reference)
    norm = np.sqrt(np.sum(corrected**2, axis=1))
    inclined = np.degrees(np.arcsin(corrected[:, 2] / norm)) - i
    turned = np.degrees(np.arctan2(corrected[:, 0], corrected[:, 1])) - t
    turned = (turned + 540.0) % 360.0 - 180.0
    expected = [DEG * inclined, DEG * turned * np.cos(DEG * i), norm / G - 1.0]
    np.testing.assert_allclose(found, np.concatenate(expected), atol=1e-12)


@pytest.mark.parametrize("name", OBJECTIVES)
def test_slopes_are_differences(name: str) -> None:
    corrected, reference, *_ = world()
    _, slope = OBJECTIVES[name](corrected, reference)
    for row, axis in np.ndindex(corrected.shape):
        step = np.zeros_like(corrected)
        step[row, axis] = 1e-6
        up, down = (OBJECTIVES[name](corrected + s, reference)[0] for s in (step, -step))
        np.testing.assert_allclose(slope[:, row, axis], (up - down) / 2e-6, atol=1e-7)
