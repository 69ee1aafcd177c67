"""Laws of the closed loop, and proof that a broken engine breaks them.

Each fault that would make the loop lie is planted and must be seen: a correction of the wrong sign,
a forgotten projection, an error in the sample that is passed off as held out.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.core.balance import Whitener
from imucalib.core.context import Context
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.effects import catalogue, named
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop import cross_fit
from imucalib.loop.candidates import effect_candidates
from imucalib.loop.closed_loop import close_loop
from imucalib.loop.cross_fit import CrossFit, by_folds, cross_fitted, judged
from imucalib.loop.design import Fold, folds_of
from imucalib.loop.evidence import score
from imucalib.loop.foretold import foretold
from imucalib.loop.found import FitLoop, LoopSettings, Step
from imucalib.loop.held_out import Held, errors
from imucalib.loop.noise import grid as evidence_grid
from imucalib.loop.noise.doubts import beyond_declared, heavy_tails, noise_doubts
from imucalib.loop.records import extended
from worlds.bench import GRAVITY, base_model, bench, draw, ordinary_theta

Array = NDArray[np.float64]
RULES = LoopSettings(draws=59, alpha=0.1)
JUNK = ("quadratic", "cubic", "cross_axis", "temperature_scale", "warm_up")


def planted(name: str, size: float, seed: int = 5, n: int = 40) -> Observations:
    base, data = base_model(), bench(seed, n)
    model = base.plus(named(name))
    theta, part = ordinary_theta(model, data, seed), model.slices(data.context)[name]
    theta[part] = size * np.array([p.typical for p in named(name).parameters(data.context)])
    return draw(model, theta, data, seed + 1)


def clean(seed: int, n: int = 40) -> Observations:
    base, data = base_model(), bench(seed, n)
    return draw(base, ordinary_theta(base, data, seed), data, seed + 100)


def searched(data: Observations, names: tuple[str, ...], rules: LoopSettings = RULES) -> FitLoop:
    effects: dict[str, Effect] = {name: named(name) for name in names}
    return close_loop(base_model(), data, effects, np.random.default_rng(0), rules)


def test_a_correction_of_the_wrong_sign_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    data = planted("cubic", 3.0)
    assert [s.effect for s in searched(data, ("cubic",)).steps] == ["cubic"]
    right = Model.correct

    def wrong(self: Model, theta: Array, reading: Array, context: Context) -> Array:
        turned, slices = theta.copy(), self.slices(context)
        if "cubic" in slices:
            turned[slices["cubic"]] *= -1.0
        return right(self, turned, reading, context)

    monkeypatch.setattr(Model, "correct", wrong)
    loop = searched(data, ("cubic",), replace(RULES, curves=False))
    assert not loop.steps
    assert "does not hold out" in dict(loop.rejected)["cubic"]


def silent(fit: Fit) -> float:
    """Evidence for an effect that the fitted parameters absorb: nothing, whatever the data."""
    candidates, _ = effect_candidates(fit, [named("tool_face_zero")])
    return score(fit, candidates, np.random.default_rng(0), draws=19)[0].evidence


def test_a_forgotten_projection_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    fit = fit_model(base_model(), planted("tool_face_zero", 3.0))
    assert silent(fit) == 0.0
    base, taken_out = Fit.white_basis, evidence_grid.restricted

    def without(found: Fit) -> tuple[Whitener, Array]:
        white, basis = base(found)
        return white, np.zeros_like(basis)

    monkeypatch.setattr(Fit, "white_basis", without)
    monkeypatch.setattr(evidence_grid, "restricted", lambda j, found: taken_out(0.0 * j, found))
    candidates, _ = effect_candidates(fit, [named("tool_face_zero")])
    assert not score(fit, candidates, np.random.default_rng(0), draws=19)[0].absorbed


def claimed_gain(seed: int) -> float:
    """Held-out error after over before, where an effect was taken that the data lack."""
    data = clean(seed)
    plain = fit_model(base_model(), data)
    final = plain
    for name in JUNK:
        final = extended(final, named(name))
    loop = FitLoop(plain, final, plain=plain, as_recorded=final, bar=-1e9)
    effects = {name: named(name) for name in JUNK}
    folds = folds_of(data)
    held = cross_fitted(loop, folds, effects, np.random.default_rng(seed), RULES)
    return held.after.rms() / held.before.rms()


def test_what_the_data_lack_gains_nothing_on_data_that_took_no_part() -> None:
    assert np.mean([claimed_gain(seed) for seed in (1, 2, 3)]) >= 1.0


def test_an_error_in_the_sample_passed_off_as_held_out_is_seen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def in_sample(loop: FitLoop, *rest: object, **more: object) -> Fit:
        return loop.final

    monkeypatch.setattr(cross_fit, "_searched", in_sample)
    assert np.mean([claimed_gain(seed) for seed in (1, 2, 3)]) < 0.97


def test_an_effect_gains_on_data_that_took_no_part() -> None:
    loop = searched(planted("cubic", 2.0), ("cubic", "cross_axis"))
    effects = {name: named(name) for name in ("cubic", "cross_axis")}
    folds = folds_of(loop.plain.observations)
    held = cross_fitted(loop, folds, effects, np.random.default_rng(0), RULES)
    before, after = held.before, held.after
    assert after.rms() < 0.7 * before.rms()
    assert before.error.shape == after.error.shape == (40, 1, 3)
    rows = np.array([3, 11])
    alone = errors(loop.final, loop.final.theta, loop.plain.observations.take(rows))
    assert not np.allclose(alone.error, after.error[rows])  # fitted with them, so not held out


def crossed(folds: tuple[Fold, ...], before: Held, after: Held, nats: float = -2.0) -> CrossFit:
    return CrossFit(folds, before, after, before, after, nats * np.resize([-3.0, 4.0], len(folds)))


def judged_loop(data: Observations, names: tuple[str, ...]) -> FitLoop:
    loop = searched(data, names)
    effects = {name: named(name) for name in names}
    folds = folds_of(data)
    held = cross_fitted(loop, folds, effects, np.random.default_rng(0), RULES)
    return judged(loop, held, "rms")


def test_what_held_out_data_prove_is_explained() -> None:
    loop = judged_loop(planted("cubic", 2.0), ("cubic", "cross_axis"))
    assert loop.verdict == "explained"
    assert loop.difference is not None
    assert loop.difference.low > 0.0


def test_what_held_out_data_refuse_is_not_taken() -> None:
    """Junk that was forced in: the base model is what comes out, with the reason."""
    data = clean(4)
    plain = fit_model(base_model(), data)
    step = Step("cubic", 0.02, 999, 3.0, (), ())
    final = extended(plain, named("cubic"))
    loop = FitLoop(plain, final, steps=(step,), plain=plain, as_recorded=final, bar=-1e9)
    folds = folds_of(data)
    base = by_folds(plain, folds)
    worse = replace(base, error=1.2 * base.error)
    found = judged(loop, crossed(folds, base, worse), "rms")
    assert found.steps == ()
    assert found.as_recorded is plain
    assert found.verdict == "nothing missing"
    assert found.rejected[-1][0] == "cubic"
    assert "took no part" in found.rejected[-1][1]
    for standing_out in (replace(step, evidence=50.0), replace(step, p=0.001)):
        strong = replace(loop, steps=(standing_out,))
        again = judged(strong, crossed(folds, base, worse), "rms")
        assert again.verdict == "unexplained"


def test_a_gain_within_chance_is_suspected() -> None:
    data = clean(5)
    plain = fit_model(base_model(), data)
    final = extended(plain, named("cubic"))
    step = Step("cubic", 0.02, 999, 3.0, (), ())
    loop = FitLoop(plain, final, steps=(step,), plain=plain, as_recorded=final, bar=-1e9)
    folds = folds_of(data)
    base = by_folds(plain, folds)
    sign = np.where(np.arange(data.n) % 2, 1.15, 0.8)[:, None, None]  # better here, worse there
    after = replace(base, error=base.error * sign)
    found = judged(loop, crossed(folds, base, after, 1.0), "rms")
    assert found.difference is not None
    assert found.difference.gain > 0.0
    assert found.verdict == "suspected"
    assert found.steps == (step,)


def test_the_density_of_a_fold_is_that_of_the_joint_distribution() -> None:
    """log p(F | R) of a linear model with settings, θ flat, by dense conditioning."""
    fit = fit_model(base_model(), clean(6))
    data, at = fit.observations, fit.at
    fold = folds_of(data)[0]
    wide = 1e4  # a prior so wide that it is flat
    typical = np.array([p.typical for p in fit.parameters])
    columns = at.jacobian * typical
    covariance = np.eye(at.residual.size) * fit.noise.factor**2
    for matrix, sd in zip(at.settings, fit.noise.sd, strict=True):
        covariance += sd**2 * matrix @ matrix.T
    covariance += wide**2 * columns @ columns.T
    inside, rest = np.isin(at.owner, fold.rows), np.isin(at.owner, fold.rest)
    gain = np.linalg.solve(covariance[np.ix_(rest, rest)], covariance[np.ix_(rest, inside)]).T
    left = at.residual[inside] - gain @ at.residual[rest]
    own = covariance[np.ix_(inside, inside)] - gain @ covariance[np.ix_(rest, inside)]
    expected = -0.5 * (np.linalg.slogdet(own)[1] + left @ np.linalg.solve(own, left))
    assert foretold(fit, fit.theta, data, fold) == pytest.approx(expected, abs=0.05)


def test_heavy_tails_are_said_and_normal_ones_are_not() -> None:
    base, data = base_model(), bench(3, 120, exact=True)
    theta = ordinary_theta(base, data, 3)
    normal = fit_model(base, draw(base, theta, data, 1))
    clean_reading = draw(base, theta, data, 1).reading
    wild = np.random.default_rng(2).standard_t(2.5, clean_reading.shape) * data.sigma
    heavy = fit_model(base, data.with_reading(clean_reading + wild))
    assert heavy_tails(normal, np.random.default_rng(0), 400) > 0.01
    assert heavy_tails(heavy, np.random.default_rng(0), 400) < 0.005
    names = [u.name for u in noise_doubts(heavy, np.random.default_rng(0), LoopSettings())]
    assert names == ["heavy tails"]


def test_more_scatter_than_declared_is_said() -> None:
    base, data = base_model(), bench(3, 60, exact=True)
    drawn = draw(base, ordinary_theta(base, data, 3), data, 1)
    as_declared = fit_model(base, drawn)
    small = fit_model(base, replace(drawn, sigma=drawn.sigma / 1.6))
    assert beyond_declared(as_declared) > 0.01
    assert beyond_declared(small) < 1e-4
    rng = np.random.default_rng(0)
    assert not noise_doubts(small, rng, LoopSettings())  # nobody stands for that sigma
    said = noise_doubts(small, rng, LoopSettings(declared=True))
    assert re.fullmatch(r"scatter 1\.[4-8] times the declared noise", said[0].name)


def test_a_record_that_an_effect_explains_comes_back() -> None:
    """Positions that carry an effect look like wrong records: none may be lost to one."""
    for seed in (5, 6):
        data = planted("cubic", 6.0, seed=seed)
        loop = searched(data, ("cubic", "quadratic"))
        assert [s.effect for s in loop.steps] == ["cubic"]
        assert not loop.records


def test_a_curve_corrects_without_a_name() -> None:
    base, data = base_model(), bench(5, 60)
    drawn = draw(base, ordinary_theta(base, data, 5), data, 6)
    order = data.context["order"]
    bumps = np.exp(-(((order - 0.2) / 0.06) ** 2)) - 0.8 * np.exp(-(((order - 0.55) / 0.12) ** 2))
    wave = 0.05 * bumps[:, None, None] * np.array([1.0, -0.5, 0.8])
    bent = drawn.with_reading(drawn.reading + wave)
    effects = {"cubic": named("cubic")}
    rng = np.random.default_rng(0)
    plain = close_loop(base, bent, effects, rng, replace(RULES, curves=False))
    assert plain.verdict == "unexplained"
    loop = close_loop(base, bent, effects, rng, RULES)
    assert [s.effect.split(":")[:2] for s in loop.curves] == [["curve@bias", "order"]]
    assert loop.verdict == "unexplained"
    assert not loop.named
    checked = loop.curves[0].checked[0]
    assert checked.after < 0.4 * checked.before
    assert set(catalogue()).isdisjoint(s.effect for s in loop.steps)


FORMS = {
    "shape@bias:order:sine": lambda order: np.sin(2.0 * np.pi * order / 0.4 + 0.7),
    "shape@bias:order:kink": lambda order: 3.0 * np.abs(order - 0.4),
    "shape@bias:temperature:power": lambda warm: ((warm - 25.0) / 12.0) ** 3,
}


#: The period and the place that were planted, between those of the scan.
NUMBERS = {"shape@bias:order:sine": 0.4, "shape@bias:order:kink": 0.4}


@pytest.mark.parametrize("name", FORMS)
def test_a_curve_with_a_form_gets_its_formula(name: str) -> None:
    base, data = base_model(), bench(5, 60)
    drawn = draw(base, ordinary_theta(base, data, 5), data, 6)
    driver = data.context[name.split(":")[1]]
    wave = 0.04 * FORMS[name](driver)[:, None, None] * np.array([1.0, -0.5, 0.8])
    loop = close_loop(base, drawn.with_reading(drawn.reading + wave), {}, np.random.default_rng(0))
    (step,) = loop.steps
    forms = [f.rsplit(":", len(f.split(":")) - 3)[0] for f in (step.effect, *step.aliases)]
    assert name in forms
    if name in NUMBERS:
        of_form = next(f for f in (step.effect, *step.aliases) if f.startswith(name))
        assert float(of_form.split(":")[3]) == pytest.approx(NUMBERS[name], abs=0.008)
    assert not step.curve
    assert loop.verdict.startswith("explained")


def test_noise_that_neighbours_share_is_part_of_the_model() -> None:
    """It speaks against no effect, and it is not taken for one."""
    base, data = base_model(), bench(5, 60)
    rng = np.random.default_rng(3)
    walk = np.zeros((60, 3))
    for k in range(1, 60):
        walk[k] = 0.6 * walk[k - 1] + 0.03 * rng.standard_normal(3)
    alone = draw(base, ordinary_theta(base, data, 5), data, 6)
    loop = close_loop(base, alone.with_reading(alone.reading + walk[:, None]), {}, rng, RULES)
    assert loop.final.observations.shared
    assert not loop.named
    planted_ = planted("quadratic", 3.0, n=60)
    found = close_loop(
        base, planted_.with_reading(planted_.reading + walk[:, None]),
        {n: named(n) for n in ("quadratic", "warm_up", "bias_drift")}, rng, RULES,
    )  # fmt: skip
    assert [s.effect for s in found.named] == ["quadratic"]
    size = found.final.noise.sd[-1]
    assert 0.5 * 0.0375 < size < 2.0 * 0.0375  # 0.03 / sqrt(1 - 0.36)


def test_an_effect_that_noise_imitates_is_told_beside_it() -> None:
    base, data = base_model(), bench(5, 40)
    drawn = draw(base, ordinary_theta(base, data, 5), data, 6)
    rise = 0.02 * data.context["order"][:, None, None] * np.array([1.0, -0.5, 0.8])
    wiggle = np.zeros((40, 3))
    rng = np.random.default_rng(8)
    for k in range(1, 40):
        wiggle[k] = 0.9 * wiggle[k - 1] + 0.008 * rng.standard_normal(3)
    mixed = drawn.with_reading(drawn.reading + rise + wiggle[:, None])
    effects = {"bias_drift": named("bias_drift")}
    loop = close_loop(base, mixed, effects, np.random.default_rng(0), replace(RULES, curves=False))
    words = " ".join(u.name for u in loop.unexplained)
    rivals = [name for s in loop.steps for name in s.aliases]
    assert "bias_drift would do as well" in words or "wandering_bias" in rivals


def test_a_name_is_not_certain_where_a_form_explains_more() -> None:
    """Readings that stop growing at 0.6 g look like a cubic response."""
    base, data = base_model(), bench(5, 60)
    drawn = draw(base, ordinary_theta(base, data, 5), data, 6)
    u = data.reference.truth(np.zeros(data.reference.eta_size)) / GRAVITY
    limit = -0.1 * np.sign(u) * np.maximum(np.abs(u) - 0.6, 0.0) / 0.4
    effects = {"cubic": named("cubic")}
    bent = drawn.with_reading(drawn.reading + limit)
    loop = close_loop(base, bent, effects, np.random.default_rng(0), RULES)
    assert loop.steps
    assert not any(step.certain for step in loop.steps)
    told = " ".join(name for s in loop.steps for name in (s.effect, *s.aliases))
    assert "saturation" in told
    right = searched(planted("cubic", 3.0, n=60), ("cubic",))
    assert [(s.effect, s.aliases) for s in right.steps] == [("cubic", ())]
