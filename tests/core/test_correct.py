"""Readings undone: where the response jumps no force gives some of them, and none is lost."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.core.effect import Context, Truth
from imucalib.core.model import Model
from imucalib.effects import named
from imucalib.errors import NotConverged
from imucalib.units import MG


@pytest.mark.parametrize("jump", [4.0, -4.0])
def test_a_reading_inside_a_jump_is_undone_to_within_it(jump: float) -> None:
    effect = named("shape@response:x:step:0.5")
    model = Model((effect,))
    x = np.zeros((400, 1, 3))
    x[:, 0, 0] = np.linspace(0.49, 0.51, 400) * 1000.0 * MG
    known = Context(400)
    theta = np.full(len(model.parameters(known)), jump)
    reading = x + effect.act(theta, Truth(x), known).delta
    reading += np.random.default_rng(1).normal(0.0, 1.0 * MG, reading.shape)
    found = model.correct(theta, reading, known)
    assert np.abs(found[:, 0, 0] - x[:, 0, 0]).max() < 8.0 * MG


def test_a_reading_beyond_the_model_is_refused() -> None:
    effect = named("quadratic")
    model, known = Model((effect,)), Context(1)
    theta = np.full(len(model.parameters(known)), -40.0)
    with pytest.raises(NotConverged, match="cannot be inverted"):
        model.correct(theta, np.full((1, 1, 3), 10_000.0 * MG), known)
