"""The next of a few that are alike, by their number, their noise and one more that is drawn."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.estimators.power_ups import predict_next

WORLDS = 200


@pytest.mark.parametrize("devices", [4, 5, 20])
@pytest.mark.parametrize("noise", [0.1, 1.0])
def test_stated_is_had_of_the_next_one(devices: int, noise: float) -> None:
    """Of five the next was off by 1.2 to 1.3 stated deviations: their scatter was taken as known.
    Axes scatter within a factor of each other, and are read with deviations of their own."""
    rng, z, chance = np.random.default_rng(devices), list[float](), list[float]()
    for _ in range(WORLDS):
        size = np.exp(0.4 * rng.standard_normal(3))
        sds = noise * np.exp(0.2 * rng.standard_normal((devices, 3)))
        values = 3.0 + size * rng.standard_normal((devices, 3))
        said = predict_next(values + sds * rng.standard_normal(sds.shape), sds)
        following = 3.0 + size * rng.standard_normal(3)
        z += list((following - said.mean) / said.sd)
        chance += list(said.chance(following, np.zeros(3)))
    # .92 to .97 of many; 600 numbers know it to .01.
    assert 0.91 < np.mean(np.abs(z) < 1.96) < 0.98
    assert 0.02 < np.mean(np.array(chance) < 0.05) < 0.09


def test_devices_without_noise_are_a_sample_of_a_normal_law() -> None:
    """Many of them: mean, scatter and Student's next one, which is their sd."""
    values = 5.0 + 2.0 * np.random.default_rng(1).standard_normal((400, 3))
    said = predict_next(values, np.full((400, 3), 1e-3))
    assert said.mean == pytest.approx(values.mean(axis=0), abs=0.01)
    assert said.scatter(0.5) == pytest.approx(values.std(axis=0, ddof=1), rel=0.02)
    assert said.sd == pytest.approx(values.std(axis=0, ddof=1), rel=0.02)
    assert said.mean_sd == pytest.approx(values.std(axis=0, ddof=1) / 20.0, rel=0.03)


def test_devices_that_are_equal_have_a_scatter_within_their_noise() -> None:
    said = predict_next(np.zeros((6, 2)), np.ones((6, 2)))
    assert np.all(said.scatter(0.5) < 1.0)
    assert np.all(said.sd > said.scatter(0.5))


def test_numbers_that_nobody_doubts_end_no_fleet() -> None:
    """A gain that is one by definition, in all devices; and one that is read without noise."""
    values = np.column_stack([np.ones(5), np.arange(5.0)])
    said = predict_next(values[:, :1], np.zeros((5, 1)))
    assert (said.mean, said.sd) == (pytest.approx([1.0]), pytest.approx([0.0], abs=1e-50))
    said = predict_next(values[:, 1:], np.zeros((5, 1)))
    assert said.mean == pytest.approx([2.0])
    assert 1.6 < said.sd[0] < 3.5
