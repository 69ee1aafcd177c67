"""Evidence: planted physics scores highest, nothing scores nothing, and p means what it says."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.arrays import Index
from imucalib.core.balance import balance
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.effects import catalogue, named
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop import held_out as held_out_module
from imucalib.loop.asked import searched
from imucalib.loop.candidates import (
    correlated_noise,
    effect_candidates,
    effect_columns,
    probes,
    record_candidates,
)
from imucalib.loop.evidence import Candidate, Score, apart, score
from imucalib.loop.evidence_gram import gram_evidence
from imucalib.loop.held_out import errors, fitted, held_out, left_out_sizes
from imucalib.loop.noise import grid as evidence_grid
from imucalib.loop.record_errors import diagnose
from imucalib.loop.records import set_aside
from imucalib.units import MG
from worlds.bench import (
    BASE,
    NINE,
    base_model,
    bench,
    draw,
    ordinary_theta,
    tumble,
)

Array = NDArray[np.float64]
SEARCHED = [
    name
    for name, e in searched((), (), {}).effects.items()
    if name not in BASE and "Absorbed" not in e.identify
]


def _planted(name: str, seed: int, size: float = 5.0, n: int = 30) -> Fit:
    """A base fit of data that hold one effect more, `size` times its typical size."""
    base, data = base_model(), bench(seed, n)
    model = base.plus(named(name))
    theta = ordinary_theta(model, data, seed + 1)
    typical = [p.typical for p in named(name).parameters(data.context)]
    part = model.slices(data.context)[name]
    theta[part] = size * np.array(typical) * (-1.0) ** np.arange(len(typical))
    return fit_model(base, draw(model, theta, data, seed + 2))


def _clean(seed: int, n: int = 24) -> Fit:
    base, data = base_model(), bench(seed, n)
    return fit_model(base, draw(base, ordinary_theta(base, data, seed), data, 1000 + seed))


@cache
def _one_clean() -> Fit:
    return _clean(0)


def _everything(fit: Fit) -> tuple[Candidate, ...]:
    found, _ = effect_candidates(fit, catalogue().values())
    return found + probes(fit) + correlated_noise(fit)


def _scores(fit: Fit, draws: int = 99) -> tuple[Score, ...]:
    return score(fit, _everything(fit), np.random.default_rng(7), draws=draws)


@pytest.mark.parametrize("name", SEARCHED)
def test_what_was_planted_scores_highest(name: str) -> None:
    found = _scores(_planted(name, 61), draws=19)
    assert found[0].name == name
    assert found[0].p == 1 / 20  # the least that 19 draws can give
    assert found[0].evidence > found[1].evidence + 3.0
    assert found[0].share > 0.3
    assert not found[0].absorbed


def test_an_absorbed_effect_claims_nothing() -> None:
    fit = _planted("tool_face_zero", 62)
    mine = next(s for s in _scores(fit) if s.name == "tool_face_zero")
    assert mine.absorbed
    assert (mine.evidence, mine.p, mine.strength) == (0.0, 1.0, 0.0)


def _null_p_values(count: int = 60) -> Array:
    return np.array([_scores(_clean(seed, 16), draws=49)[0].p for seed in range(count)])


def test_p_values_of_clean_data_are_uniform() -> None:
    """Counts within the 0.2 % bounds of the binomial at each level."""
    p = _null_p_values()
    for level, low, high in ((0.1, 1, 13), (0.5, 18, 42), (0.9, 47, 59)):
        assert low <= int(np.sum(p <= level)) <= high, (level, np.sort(p))
    assert p.min() >= 1 / 50


def test_p_is_for_the_best_of_all_candidates() -> None:
    """The same evidence among more candidates has the larger p."""
    fit = _planted("cubic", 63, 0.4)
    every = _everything(fit)
    mine = tuple(c for c in every if c.name == "cubic")
    alone = score(fit, mine, np.random.default_rng(1), draws=199)[0]
    among = next(
        s for s in score(fit, every, np.random.default_rng(1), draws=199) if s.name == "cubic"
    )
    assert among.evidence == pytest.approx(alone.evidence, abs=1e-9)
    assert 0.005 < alone.p < among.p


SIZES = (0.1, 0.3, 1.0, 3.0, 10.0)


def _dense_evidence(fit: Fit, columns: Array, taus: tuple[float, ...] = SIZES) -> float:
    """The definition: four fifths for the whole block, a fifth for one number of it, whichever."""
    single = [_dense_block(fit, columns[:, [k]], taus) for k in range(columns.shape[1])]
    one = np.logaddexp.reduce(single) - np.log(len(single))
    return float(np.logaddexp(_dense_block(fit, columns, taus) + np.log(0.8), one + np.log(0.2)))


def _dense_block(fit: Fit, columns: Array, taus: tuple[float, ...]) -> float:
    """Restricted likelihood with V + τ² G Gᵀ, profiled over noise and grids."""
    at = fit.at
    n, p = at.jacobian.shape

    def log_density(ratio: tuple[float, ...], tau: float) -> float:
        v = np.eye(n) + tau**2 * columns @ columns.T / fit.noise.factor**2
        for matrix, rho in zip(at.settings, ratio, strict=True):
            v += rho**2 * matrix @ matrix.T
        inverse = np.linalg.inv(v)
        info = at.jacobian.T @ inverse @ at.jacobian
        right = inverse @ at.residual
        gain = at.jacobian.T @ right
        power = float(at.residual @ right - gain @ np.linalg.solve(info, gain))
        dets = np.linalg.slogdet(v)[1] + np.linalg.slogdet(info)[1]
        return float(-0.5 * (dets + (n - p) * np.log(power)))

    shrink = evidence_grid.SHRINK
    fitted_ratio = [sd / fit.noise.factor for sd in fit.noise.sd]
    grid = list(product(*(tuple(s * r for s in shrink) for r in fitted_ratio)))
    without = max(log_density(ratio, 0.0) for ratio in grid)
    return max(log_density(ratio, tau) for ratio in grid for tau in taus) - without


@pytest.mark.parametrize("name", ["cubic", "temperature_bias", "inclination_zero"])
def test_evidence_is_its_definition(name: str) -> None:
    fit = _planted("cubic", 64, 0.5, n=14)
    columns = effect_columns(fit, named(name))
    found = score(fit, (Candidate(name, "effect", columns),), np.random.default_rng(0), draws=1)
    assert found[0].evidence == pytest.approx(_dense_evidence(fit, columns), abs=1e-6)


def test_what_one_axis_alone_has_pays_for_one_number_and_not_for_six() -> None:
    """Only the first number of an effect is there: the evidence is within log(5 m) of its own."""
    fit = _planted("cubic", 64, 0.5, n=14)
    rng = np.random.default_rng(3)
    whole = rng.standard_normal((fit.at.residual.size, 6))
    whole[:, 0] = fit.at.residual
    evidence = {
        name: score(fit, (Candidate(name, "effect", columns),), rng, draws=1)[0].evidence
        for name, columns in {"one": whole[:, :1], "whole": whole}.items()
    }
    assert evidence["one"] - np.log(30.0) <= evidence["whole"] <= evidence["one"] + 1e-9


@pytest.mark.parametrize("others", [3, 400])
def test_thousands_of_observations_weigh_one_number_as_few_do(others: int) -> None:
    """By the blocks' own definition, with fewer and with more columns than observations."""
    rng = np.random.default_rng(2)
    base, block, more = (rng.standard_normal((300, m)) for m in (9, 3, others))
    residual, tau = 0.4 * block[:, 0] + rng.standard_normal(300), np.array([0.1, 1.0])

    def evidence(*blocks: Array, parts: tuple[int, ...] = ()) -> Array:
        return gram_evidence(residual, base, blocks, tau, rng, 1, parts=parts).evidence

    apart = evidence(block, *(block[:, [k]] for k in range(3)), more)
    both = evidence(block, more, parts=(0,))
    expected = np.log(0.8 * np.exp(apart[0]) + 0.2 * np.exp(apart[1:4]).mean())
    assert both == pytest.approx([expected, apart[4]], abs=1e-6)
    assert expected > apart[0] + 1.0


@cache
def _best_size() -> float:
    """The likeliest size of the effect in `_planted("cubic", 64, 1.0, n=14)`."""
    fit = _planted("cubic", 64, 1.0, n=14)
    columns = effect_columns(fit, named("cubic"))
    tried = [float(tau) for tau in np.geomspace(0.1, 30.0, 25)]
    return max(tried, key=lambda tau: _dense_block(fit, columns, (tau,)))


@pytest.mark.parametrize("size", SIZES)
def test_every_size_of_an_effect_is_tried(size: float) -> None:
    """Columns c times as large have their best size at 1 / c of what it was."""
    fit = _planted("cubic", 64, 1.0, n=14)
    columns = effect_columns(fit, named("cubic")) * _best_size() / size
    assert max(SIZES, key=lambda tau: _dense_block(fit, columns, (tau,))) == size
    found = score(fit, (Candidate("cubic", "effect", columns),), np.random.default_rng(0), draws=1)
    assert found[0].evidence == pytest.approx(_dense_evidence(fit, columns), abs=1e-6)


def test_evidence_by_the_norm_alone_is_its_definition() -> None:
    fit = _tumbled("cubic", 65)
    columns = effect_columns(fit, named("cubic"))
    found = score(fit, (Candidate("cubic", "effect", columns),), np.random.default_rng(0), draws=1)
    assert found[0].evidence == pytest.approx(_dense_evidence(fit, columns), abs=1e-6)


def _tumbled(name: str, seed: int, size: float = 5.0) -> Fit:
    base, data, known = base_model(NINE), tumble(seed, 40), bench(seed, 40, exact=True)
    model = base.plus(named(name))
    theta = ordinary_theta(model, data, seed + 1)
    part = model.slices(data.context)[name]
    theta[part] = size * np.array([p.typical for p in named(name).parameters(data.context)])
    return fit_model(base, data.with_reading(draw(model, theta, known, seed + 2).reading))


@pytest.mark.parametrize("name", ["temperature_bias", "quadratic", "bias_step", "scale_drift"])
def test_planted_physics_is_found_by_the_norm_alone(name: str) -> None:
    found = _scores(_tumbled(name, 66), draws=19)
    assert found[0].name == name
    assert found[0].p == 1 / 20


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


def test_effects_that_cannot_be_tested_say_why() -> None:
    fit = _one_clean()
    context = fit.observations.context
    kept = {n: v for n, v in context.covariates.items() if n not in ("temperature", "sweep")}
    bare = Observations(
        fit.observations.reading, fit.observations.sigma, fit.observations.reference,
        type(context)(context.n, kept), fit.observations.group, fit.observations.label,
    )  # fmt: skip
    found, missing = effect_candidates(fit_model(fit.model, bare), catalogue().values())
    assert missing["temperature_bias"] == "no temperature was recorded"
    assert missing["bias_step"] == "no sweep was recorded"
    names = {c.name for c in found}
    assert not names & set(missing)
    assert names | set(missing) | set(BASE) == set(catalogue())


def test_an_alias_is_not_apart_and_others_are() -> None:
    fit = _planted("bias_drift", 61)
    every = {c.name: c for c in _everything(fit)}
    drift, warm = every["bias_drift"], every["temperature_bias"]
    strength = apart(fit, drift, Candidate("nothing", "effect", 0.0 * drift.columns))
    assert strength > 5.0
    assert apart(fit, drift, drift) < 1e-6 * strength
    turned = Candidate("turned", "effect", drift.columns @ np.diag([2.0, -1.0, 0.5]))
    assert apart(fit, drift, turned) < 1e-6 * strength
    assert apart(fit, drift, warm) > 0.5 * strength
    # Half of one and half of the other: at an angle between.
    mixed = Candidate("mixed", "effect", drift.columns / 2.0 + warm.columns / 2.0)
    assert 0.05 * strength < apart(fit, drift, mixed) < apart(fit, drift, warm)


@pytest.mark.parametrize(("row", "axis"), [(5, "x"), (11, "z")])
def test_a_gross_error_of_one_record_is_found(row: int, axis: str) -> None:
    base, data = base_model(), bench(67, 30)
    noisy = draw(base, ordinary_theta(base, data, 68), data, 69)
    reading = noisy.reading.copy()
    reading[row, 0, "xyz".index(axis)] += 30.0 * MG
    fit = fit_model(base, noisy.with_reading(reading))
    best = score(fit, record_candidates(fit), np.random.default_rng(0), draws=99)[0]
    assert (best.name, best.p) == (f"{row}:{axis}", 1 / 100)
    found = diagnose(set_aside(fit, row), row, axis, best.p, best.evidence)
    assert abs(found.size - 30.0) < 4.5 * found.sd
    assert found.where == f"row {row + 1}"


def test_a_gross_error_is_found_by_the_norm_alone() -> None:
    base, data, known = base_model(NINE), tumble(70, 40), bench(70, 40, exact=True)
    reading = draw(base, ordinary_theta(base, data, 1), known, 2).reading.copy()
    reading[9, 0] *= 1.01
    fit = fit_model(base, data.with_reading(reading))
    best = score(fit, record_candidates(fit), np.random.default_rng(0), draws=99)[0]
    assert (best.name, best.p) == ("9:norm", 1 / 100)


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


def test_p_values_without_a_family_are_caught() -> None:
    """A search that trusts each candidate alone calls far too many clean data sets deficient."""
    small = 0
    for seed in range(6):
        fit = _clean(seed, 16)
        alone = [
            score(fit, (c,), np.random.default_rng(7), draws=19)[0].p
            for c in effect_candidates(fit, catalogue().values())[0]
        ]
        small += min(alone) <= 0.1
    # Above the 0.2 % bound of a Binomial(6, 0.1).
    assert small >= 4


def test_left_out_sizes_are_those_of_refits() -> None:
    """To first order: of the reading, which differs from the corrected one by the scale."""
    for shared in (False, True):
        base, data = base_model(), bench(5, 40, shared=shared)
        fit = fit_model(base, draw(base, ordinary_theta(base, data, 5), data, 6))
        np.testing.assert_allclose(left_out_sizes(fit), held_out(fit).size, rtol=0.05)


@pytest.mark.parametrize("candidates", [20, 120])
def test_p_holds_with_more_columns_than_observations(candidates: int) -> None:
    """Data that lack nothing, 300 of them, against junk of 80 and of 480 columns."""
    rng = np.random.default_rng(5)
    base = rng.normal(size=(300, 20))
    blocks = [rng.normal(size=(300, 4)) for _ in range(candidates)]
    tau = 10.0 ** np.arange(-2.0, 1.1, 0.5)
    p = []
    for _ in range(20):
        found = gram_evidence(rng.standard_normal(300), base, blocks, tau, rng, 99)
        p.append((1 + int((found.best >= found.evidence.max()).sum())) / 100)
    assert 0.25 < np.mean(p) < 0.75
    assert np.max(p) > 0.7


@pytest.mark.parametrize("large", [3e4, 1e5])
def test_what_chance_reaches_is_the_same_beside_settings_as_large_as_may_be(large: float) -> None:
    """Settings whose effect is 100,000 times the noise take their directions out and nothing else:
    evidence of 200 data sets that lack nothing, at the same random numbers, agrees."""
    model, data = base_model(), bench(3, 32, shared=True)
    at = balance(model, ordinary_theta(model, data, 3), np.zeros(data.reference.eta_size), data)
    size = at.residual.size
    rng = np.random.default_rng(0)
    blocks = [rng.standard_normal((size, m)) for m in (1, 3, 8, 24)]
    white = rng.standard_normal((size, 200))
    settings = [rng.standard_normal((m.shape[1], 200)) for m in at.settings]

    def chance(scale: float) -> np.ndarray:
        ratio = tuple(scale / float(np.abs(m).max()) for m in at.settings)
        pairs = zip(at.settings, ratio, settings, strict=True)
        drawn = white + sum((r * m @ z for m, r, z in pairs), np.zeros_like(white))
        return (
            evidence_grid.EvidenceGrid(at.jacobian, at.settings, ratio, blocks)
            .evidence(drawn)
            .max(axis=0)
        )

    assert chance(large) == pytest.approx(chance(3e3), abs=0.02)


def test_others_pay_nothing_for_a_scan_without_a_reason() -> None:
    """Twenty values that no physics prefers, beside a cubic: its p is as it was."""
    fit = _tumbled("cubic", 66, size=0.4)
    rng = np.random.default_rng(5)
    (cubic,), _ = effect_candidates(fit, [named("cubic")])
    shape = (cubic.columns.shape[0], 6)
    many = [Candidate(f"n{k}", "effect", 5.0 * rng.standard_normal(shape)) for k in range(20)]
    unfounded = [replace(c, unfounded=True) for c in many]

    def scored(candidates: list[Candidate]) -> dict[str, Score]:
        found = score(fit, (cubic, *candidates), np.random.default_rng(6), draws=499, alpha=0.999)
        return {s.name: s for s in found}

    alone, beside, among = scored([]), scored(unfounded), scored(many)
    assert beside["cubic"].p == alone["cubic"].p
    assert beside["cubic"].bar == alone["cubic"].bar < among["cubic"].bar
    assert beside["n0"].bar != beside["cubic"].bar
