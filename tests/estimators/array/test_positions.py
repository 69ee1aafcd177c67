"""What is said of an array's positions: by draws of a known covariance, and what is refused."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.errors import Undetermined
from imucalib.estimators.array.problem import ArrayPrior
from imucalib.estimators.array.sampler import (
    ArrayPositions,
    gaussian_positions,
    refuse_collapse,
    refuse_vague,
    scale_of,
)
from worlds.array import corners, data_of


def drawn(seed: int = 0) -> tuple[ArrayPositions, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    data, _ = data_of(corners(4), 5, rng)
    root = 1e-5 * rng.normal(size=(9, 9))
    mean = 1.002 * (corners(4)[1:] - corners(4)[0]).ravel()
    prior = ArrayPrior(corners(4))
    return gaussian_positions(data, prior, mean, root @ root.T, rng), mean, root @ root.T


def test_independent_draws_have_the_covariance_of_the_fit() -> None:
    found, mean, covariance = drawn()
    white = np.linalg.solve(np.linalg.cholesky(covariance), (found.free - mean).T)
    assert found.free.shape == (2000, 9)
    np.testing.assert_allclose(np.cov(white), np.eye(9), atol=0.12)
    assert np.abs(white.mean(axis=1)).max() < 0.12
    np.testing.assert_allclose(found.covariance, np.cov(found.free.T))
    np.testing.assert_allclose(found.mean[1:].ravel(), found.free.mean(axis=0))
    np.testing.assert_allclose(found.sd[1:].ravel(), found.free.std(axis=0), rtol=1e-3)
    assert not found.mean[0].any()
    own = (corners(4)[1:] - corners(4)[0]).ravel()
    scale, sd = found.scale
    assert scale == pytest.approx(1.002, abs=4.0 * sd)
    assert sd == pytest.approx(np.sqrt(own @ covariance @ own) / (own @ own), rel=0.07)
    assert scale_of(np.tile(2.0 * own, (3, 1)), corners(4)) == (pytest.approx(2.0), 0.0)


def test_the_noise_is_the_declared_one_times_the_factor() -> None:
    found, _, _ = drawn()
    sigma = np.array([0.3, 0.4, 0.3, 0.4])
    plain = SimpleNamespace(data=SimpleNamespace(sigma=sigma), unknowns=np.full((2, 3, 4), 0.7),
                            prior=SimpleNamespace(estimate_noise=False))  # fmt: skip
    own = ArrayPositions.noise.fget
    assert own is not None
    assert own(plain) == pytest.approx(np.sqrt(0.125))
    plain.prior.estimate_noise = True
    assert own(plain) == pytest.approx(np.exp(0.7) * np.sqrt(0.125))
    assert found.noise == pytest.approx(np.sqrt(np.mean(found.data.sigma**2)))


def test_half_the_drawing_is_a_collapse() -> None:
    drawing = 0.02 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], dtype=float)
    refuse_collapse(0.51 * drawing, drawing)
    with pytest.raises(Undetermined, match="along one direction 49 %"):
        refuse_collapse(drawing * [1.0, 0.49, 1.0], drawing)
    refuse_collapse(drawing + 0.5, drawing)  # flat as it is drawn, elsewhere


@pytest.mark.parametrize(
    ("scale", "sd", "each", "vague"),
    [(1.0, 0.049, 1e-4, False), (1.0, 0.051, 1e-4, True), (2.0, 0.099, 1e-4, False),
     (1.0, 0.01, 1.49e-3, False), (1.0, 0.01, 1.51e-3, True)],
)  # fmt: skip
def test_what_the_motion_leaves_open_is_refused(
    scale: float, sd: float, each: float, vague: bool
) -> None:
    """A size beyond 5 %, or a position beyond half of what was believed of it before."""
    spread = np.zeros((4, 3))
    spread[1:] = each
    made = SimpleNamespace(scale=(scale, sd), sd=spread, prior=SimpleNamespace(sd=3e-3),
                           covariance=np.diag(np.arange(1.0, 10.0)))  # fmt: skip
    told = pytest.raises(Undetermined, match="too little rotation") if vague else nullcontext()
    with told:
        refuse_vague(made)  # type: ignore[arg-type]
