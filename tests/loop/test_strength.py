"""How strong a candidate is and what it explains, held against least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import sqrtm

from imucalib.estimators.least_squares import fit
from imucalib.loop.noise.strength import strengths
from worlds.bench import base_model, bench, draw, ordinary_theta


def test_strength_and_share_are_those_of_least_squares_under_the_noise() -> None:
    model, data = base_model(), bench(3, 40)
    found = fit(model, draw(model, ordinary_theta(model, data, 3), data, 4))
    rng = np.random.default_rng(5)
    size = found.at.residual.size
    blocks = [rng.standard_normal((size, m)) for m in (1, 3, 1, 2)]
    blocks += [found.at.jacobian[:, :2], np.repeat(blocks[0], 2, axis=1)]
    result = strengths(found, blocks)

    covariance = np.eye(size)
    for matrix, ratio in zip(found.at.settings, found.noise.ratio, strict=True):
        covariance += ratio**2 * matrix @ matrix.T
    white = np.linalg.inv(np.real(sqrtm(covariance)))
    jacobian, residual = white @ found.at.jacobian, white @ found.at.residual

    def left(of: np.ndarray, beside: np.ndarray) -> np.ndarray:
        return np.asarray(of - beside @ np.linalg.lstsq(beside, of, rcond=None)[0])

    rest = left(residual, jacobian)
    freedom = size - jacobian.shape[1]
    for k, (block, rank) in enumerate(zip(blocks[:4], (1, 3, 1, 2), strict=True)):
        columns = white @ block
        own = left(columns, jacobian)
        assert result.left[k] == pytest.approx(np.sum(own**2) / np.sum(columns**2), rel=1e-8)
        length = np.linalg.norm(own) / found.noise.factor
        assert result.strength[k] == pytest.approx(length, rel=1e-8)
        both = left(rest, own)
        share = 1.0 - (both @ both) / (rest @ rest) * freedom / (freedom - rank)
        assert result.share[k] == pytest.approx(max(share, 0.0), abs=1e-8)
    assert not result.live[4]
    assert result.strength[4] == 0.0
    assert result.share[5] == pytest.approx(result.share[0], abs=1e-8)  # twice the same is one
