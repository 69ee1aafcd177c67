"""One of a kind: θ and the noise beside what others of it tell."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.core.model import Model
from imucalib.core.prior import Prior
from imucalib.effects import named
from imucalib.estimators.in_a_population import strangeness
from imucalib.estimators.least_squares import fit
from worlds.bench import base_model, bench, draw, ordinary_theta, tumble

NINE = base_model(("bias", "scale", "non_orthogonality"))


def _prior(model: Model, context, share: float, logs: tuple[tuple[float, float], ...]) -> Prior:  # type: ignore[no-untyped-def]
    """About the usual, each parameter with a share of its typical size."""
    sd = share * np.array([p.typical for p in model.parameters(context)])
    return Prior(model.start(context), np.diag(1.0 / sd), np.array(logs))


@pytest.mark.parametrize("width", [100.0, 1e4])
@pytest.mark.parametrize("known", [True, False])
def test_a_kind_that_says_nothing_changes_nothing(known: bool, width: float) -> None:
    """With wide priors the estimate is that of restricted maximum likelihood, settings and all."""
    model, data = (base_model(), bench(4, 60)) if known else (NINE, tumble(4, 60))
    made = draw(model, ordinary_theta(model, data, 4), data, 5)
    plain = fit(model, made)
    count = 1 + len(plain.noise.component)
    wide = fit(model, made, prior=_prior(model, made.context, width, ((-3.0, 50.0),) * count))
    assert wide.converged
    assert np.all(np.abs(wide.theta - plain.theta) < 0.02 * plain.sd)
    assert wide.sd == pytest.approx(plain.sd, rel=0.01)
    assert wide.noise.factor == pytest.approx(plain.noise.factor, rel=0.01)
    assert wide.noise.sd == pytest.approx(plain.noise.sd, rel=0.03)
    assert wide.noise_sd == pytest.approx(plain.noise_sd, rel=0.05)


@pytest.mark.slow
def test_few_rests_of_one_of_a_kind_have_honest_sds() -> None:
    """Sixty devices drawn from their kind, six rests each by the size of gravity: nine parameters
    from six numbers, by normal theory z is standard normal."""
    z, strange = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        data, known = tumble(seed, 6), bench(seed, 6, exact=True)
        prior = _prior(NINE, data.context, 0.2, ((0.0, 0.2),))
        theta = prior.mean + np.diag(1.0 / np.diag(prior.root)) @ rng.standard_normal(9)
        made = data.with_reading(draw(NINE, theta, known, seed + 1000).reading)
        found = fit(NINE, made, prior=prior)
        assert found.converged
        z.append((found.theta - theta) / found.sd)
        strange.append(strangeness(found))
    assert 0.9 < float(np.std(z)) < 1.1
    assert 0.3 < np.mean(np.array(strange) < 0.5) < 0.7  # uniform; five standard errors are 0.32
    assert min(strange) > 1e-4


def test_one_of_another_kind_is_strange() -> None:
    data, known = tumble(3, 12), bench(3, 12, exact=True)
    prior = _prior(NINE, data.context, 0.1, ((0.0, 0.2),))
    theta = prior.mean.copy()
    theta[0] += 8.0 / prior.root[0, 0]
    made = data.with_reading(draw(NINE, theta, known, 7).reading)
    assert strangeness(fit(NINE, made, prior=prior)) < 1e-6


def test_what_the_fleet_knows_of_the_noise_is_weighed() -> None:
    """Of eight numbers the noise is told by the kind; of two hundred by the data."""
    wrong = ((np.log(3.0), 0.1),)
    for count, low, high in ((8, 2.0, 3.5), (200, 0.9, 1.8)):
        data, known = tumble(9, count), bench(9, count, exact=True)
        prior = _prior(NINE, data.context, 1.0, wrong)
        made = data.with_reading(draw(NINE, ordinary_theta(NINE, known, 9), known, 10).reading)
        assert low < fit(NINE, made, prior=prior).noise.factor < high


def test_a_prior_moves_an_effect_that_the_rows_cannot_show() -> None:
    """Squares beside nine parameters from nine rests: nothing to tell, the prior stands."""
    model = Model((*NINE.effects, named("quadratic")))
    data, known = tumble(2, 9), bench(2, 9, exact=True)
    prior = _prior(model, data.context, 0.5, ((0.0, 0.2),))
    theta = prior.mean.copy()
    made = data.with_reading(draw(NINE, theta[:9], known, 3).reading)
    found = fit(model, made, prior=prior)
    own = found.model.slices(data.context)["quadratic"]
    assert np.all(found.sd[own] <= 1.0 / np.diag(prior.root)[own] * (1.0 + 1e-9))
    assert found.null_directions == ()
