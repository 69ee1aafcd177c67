"""Columns of candidate effects, and errors of observations that are left out."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.arrays import Index
from imucalib.core.fit import Fit
from imucalib.effects import named
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop import held_out as held_out_module
from imucalib.loop.candidates import (
    effect_columns,
)
from imucalib.loop.held_out import errors, fitted, held_out
from worlds.bench import (
    base_model,
    bench,
    draw,
    ordinary_theta,
)

Array = NDArray[np.float64]


def _clean(seed: int, n: int = 24) -> Fit:
    base, data = base_model(), bench(seed, n)
    return fit_model(base, draw(base, ordinary_theta(base, data, seed), data, 1000 + seed))


@cache
def _one_clean() -> Fit:
    return _clean(0)


def test_columns_are_what_the_effect_does_to_the_balance() -> None:
    """A candidate's columns against the change of the residual that a small effect makes."""
    fit = _one_clean()
    for name in ("cubic", "temperature_scale", "inclination_zero", "tool_face_eccentricity"):
        effect = named(name)
        columns = effect_columns(fit, effect)
        model, context = fit.model.plus(effect), fit.observations.context
        typical = np.array([p.typical for p in effect.parameters(context)])
        theta = model.start(context)
        slices = model.slices(context)
        for own, part in fit.model.slices(context).items():
            theta[slices[own]] = fit.theta[part]
        truth = fit.observations.reference.truth(fit.eta)
        for k in range(typical.size):
            both = []
            for sign in (1.0, -1.0):
                moved = theta.copy()
                moved[slices[name].start + k] = sign * 1e-4 * typical[k]
                reading = model.predict(moved, truth, context).reading
                both.append((reading / fit.observations.sigma).ravel())
            slope = (both[0] - both[1]) / 2e-4
            assert np.allclose(slope, columns[:, k], atol=1e-4 * np.abs(columns).max())


def held_out_gap(fit: Fit) -> float:
    """Largest difference (m/s²) of held-out errors from those of literal refits, over the noise."""
    found, worst = held_out(fit).error, 0.0
    for row in range(fit.observations.n):
        rows = np.array([row])
        rest = fit_model(
            fit.model, fit.observations.without(rows), start=fit.theta, noise=fit.noise
        )
        literal = errors(rest, rest.theta, fit.observations.take(rows)).error[0]
        worst = max(worst, float(np.abs(found[row] - literal).max()))
    return worst / (fit.noise.factor * float(fit.observations.sigma.min()))


def test_held_out_errors_are_those_of_literal_refits() -> None:
    fit = _one_clean()
    assert held_out_gap(fit) < 0.01
    assert held_out(fit).rms() > fitted(fit).rms()


def test_in_sample_errors_passed_off_as_held_out_are_caught(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def none_left_out(fit: Fit, group: Index) -> Iterator[tuple[Index, Array]]:
        yield from ((np.flatnonzero(group == key), fit.theta) for key in np.unique(group))

    monkeypatch.setattr(held_out_module, "each_left_out", none_left_out)
    assert held_out_gap(_one_clean()) > 0.1
