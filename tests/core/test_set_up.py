"""What gravity says of a gyroscope's axes, against turns that were made by quaternions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib.core.set_up import DOUBT, SIGNED, axes_in_words, misfits, weigh


def turns_by(signed: np.ndarray, noise: float, seed: int) -> tuple[np.ndarray, ...]:
    """Nine turns of a body, and what a gyroscope in other axes makes of them, in two units."""
    rng = np.random.default_rng(seed)
    before = rng.normal(size=(9, 3))
    before /= np.linalg.norm(before, axis=1)[:, None]
    vectors = rng.normal(size=(9, 20, 3)) * 0.15
    after, turned = [], []
    for up, steps in zip(before, vectors, strict=True):
        whole = Rotation.identity()
        for step in steps:
            whole = whole * Rotation.from_rotvec(step)
        found = whole.inv().apply(up) + rng.normal(scale=noise, size=3)
        after.append(found / np.linalg.norm(found))
        own = steps @ signed  # what is read, so that signed @ reading is the body's
        both = []
        for factor in (1.0, 3.0):
            for sign in (1.0, -1.0):
                total = Rotation.identity()
                for step in own:
                    total = total * Rotation.from_rotvec(factor * sign * step)
                both.append(total.as_matrix())
        turned.append(np.array(both).reshape(2, 2, 3, 3))
    return before, np.array(after), np.array(turned)


@pytest.mark.parametrize("which", range(0, 48, 5))
def test_the_axes_and_the_unit_that_were_planted_are_found(which: int) -> None:
    off = misfits(*turns_by(SIGNED[which], 0.01, which))
    assert np.median(off[:, 0, which]) < 0.03
    chance = weigh(off)
    assert chance[0, which] > 1.0 - DOUBT
    assert chance.sum() == pytest.approx(1.0)


def test_what_is_stated_stands_where_turns_say_little() -> None:
    before, after, _ = turns_by(SIGNED[0], 0.01, 1)
    alike = misfits(before[:1], after[:1], np.broadcast_to(np.eye(3), (1, 2, 2, 3, 3)))
    assert np.argmax(weigh(alike).sum(axis=1)) == 0
    assert weigh(alike)[0, 0] > 0.8


def test_words_of_axes_are_those_of_mappings() -> None:
    assert axes_in_words(np.array([[0, -1, 0], [0, 0, 1], [-1, 0, 0]])) == "-y,z,-x"
