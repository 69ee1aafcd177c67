"""Laws that every effect of the catalogue keeps; a new effect is tested by being there."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucalib.arrays import Array
from imucalib.core.effect import MOTION, Context, Effect, Motion, Response, Truth
from imucalib.core.model import Model
from imucalib.effects import catalogue, named
from imucalib.effects.record_error import is_record_error, record_error
from imucalib.estimators.least_squares import fit
from imucalib.posterior.candidates import effect_columns
from worlds.bench import GRAVITY, base_model, bench, draw, ordinary_theta
from worlds.places import ROOT

EFFECTS: dict[str, Effect] = {
    **catalogue(),
    "record_error": record_error(7, "row 8"),
    "record_error_y": record_error(7, "row 8", "y"),
    **{
        name: named(name)
        for name in (
            "bias_step@2000s",
            "scale_step@record12",
            "inclination_step@record12",
            "slip@record12",
            "slip@record12:z",
            "temperature_square@22C",
            "curve@bias:order:0.2:0.8:4",
            "curve@bias:tool_face:0:6.2832:4",
            "curve@response:y:-1:1:6",
            "curve@response:xz:-1:1:4",
            "shape@response:xyz:sine:0.7",
            "shape@response:y:power:4:0:1",
            "shape@response:x:soft_saturation:0.6",
            "shape@response:z:saturation:0.6",
            "shape@response:z:exponential:0.3:-1",
            "shape@tool_face:tool_face:sine:120",
            "shape@bias:order:saw_tooth:0.3:0.1",
            "shape@scale:temperature:kink:22",
            "curve@scale:order:0.2:0.8:3",
            "curve@inclination:temperature:18:32:3",
            "curve@tool_face:tool_face:0:6.2832:4",
        )
    },
}
#: Units that the page maps to the standard's codes.
UNITS = re.findall(r"`([^`]+)`", (ROOT / "docs/terms.md").read_text("utf-8").split("## Units")[1])
#: What a sensor at rest can show; the others need an array's motion.
AT_REST = {
    n: e for n, e in EFFECTS.items() if e.channel == "acceleration" and not {*e.needs} & {*MOTION}
}
each_effect = pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
each_at_rest = pytest.mark.parametrize("effect", AT_REST.values(), ids=AT_REST)
each_of_force = pytest.mark.parametrize(
    "effect", [e for e in EFFECTS.values() if e.channel == "acceleration"], ids=lambda e: e.name
)
each_context = pytest.mark.parametrize("triads", [("imu0",), ("a", "b")], ids=["one", "two"])


def _context(triads: tuple[str, ...] = ("imu0",)) -> Context:
    """All that an effect may need, at rest and in motion."""
    known, rng = bench(1, 12).context, np.random.default_rng(8)
    age = rng.uniform(-0.5, 0.5, (known.n, len(triads)))
    turns = np.array([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in triads])
    covariates = {**known.covariates, "sample_age": age}
    return replace(known, covariates=covariates, triads=triads, attitude=turns, moving=True)


def _force(context: Context) -> Array:
    rng = np.random.default_rng(3)
    return GRAVITY * rng.standard_normal((context.n, len(context.triads), 3))


def _truth(context: Context, force: Array | None = None) -> Truth:
    x = _force(context) if force is None else force
    rng = np.random.default_rng(9)
    return Truth(x, Motion(*(size * rng.standard_normal(x.shape) for size in (10.0, 100.0, 50.0))))


def _typical(effect: Effect, context: Context) -> Array:
    return np.array([p.typical for p in effect.parameters(context)])


def _mid_theta(effect: Effect, context: Context) -> Array:
    typical = _typical(effect, context)
    return typical * np.random.default_rng(4).uniform(-2.0, 2.0, typical.size)


@each_effect
@each_context
def test_absent_at_the_start(effect: Effect, triads: tuple[str, ...]) -> None:
    context = _context(triads)
    start = np.array([p.start for p in effect.parameters(context)])
    assert start.size > 0
    action = effect.act(start, _truth(context), context)
    assert np.array_equal(action.delta, np.zeros_like(action.delta))
    assert np.array_equal(action.d_x, np.zeros((*action.delta.shape, 3)))


@each_effect
@each_context
def test_slope_by_parameters(effect: Effect, triads: tuple[str, ...]) -> None:
    """Central differences, per typical size, in m/s²."""
    context = _context(triads)
    theta, typical = _mid_theta(effect, context), _typical(effect, context)
    analytic = effect.act(theta, _truth(context), context).d_theta
    worst = 0.0
    for k, size in enumerate(typical):
        step = np.zeros_like(theta)
        step[k] = 1e-3 * size
        up, down = (effect.act(theta + s, _truth(context), context).delta for s in (step, -step))
        numeric = (up - down) / (2.0 * step[k])
        worst = max(worst, float(np.abs(numeric - analytic[..., k]).max()) * size)
    assert worst < 1e-7


@each_of_force
@each_context
def test_slope_by_force(effect: Effect, triads: tuple[str, ...]) -> None:
    context = _context(triads)
    x, theta = _force(context), _mid_theta(effect, context)
    analytic = effect.act(theta, _truth(context), context).d_x
    worst = 0.0
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-4
        up, down = (effect.act(theta, _truth(context, x + s), context).delta for s in (step, -step))
        worst = max(worst, float(np.abs((up - down) / 2e-4 - analytic[..., axis]).max()))
    assert worst < 1e-8


@each_effect
@each_context
def test_every_parameter_acts(effect: Effect, triads: tuple[str, ...]) -> None:
    context = _context(triads)
    slope = effect.act(_mid_theta(effect, context), _truth(context), context).d_theta
    assert slope.shape == (context.n, len(triads), 3, len(effect.parameters(context)))
    assert np.all(np.abs(slope).max(axis=(0, 1, 2)) > 0.0)


@each_effect
def test_words_and_sizes(effect: Effect) -> None:
    for text in (effect.sentence, effect.equation, effect.source, effect.identify):
        assert len(text) > 5
    assert "=" in effect.equation
    assert effect.stage in ("fixture", "mounting", "sensor")
    parameters = effect.parameters(_context())
    assert len({p.name for p in parameters}) == len(parameters)
    for p in parameters:
        assert p.unit in UNITS, "give it a code in docs/terms.md"
        assert 0.0 < 5.0 * p.typical <= p.plausible
        assert p.plausible <= 300.0 * p.typical or is_record_error(effect.name)


def test_twins_have_the_same_columns_and_lag_each_in_its_way() -> None:
    every = {n: e for n, e in catalogue().items() if isinstance(e, Response)}
    late = {n: e for n, e in every.items() if e.twin}
    assert late
    for name, effect in late.items():
        twin = every[effect.twin]
        assert effect.lagged is not twin.lagged is not None, name
        assert not twin.twin, "a search has it for others: it needs no twin itself"
        if effect.channel == twin.channel:
            context = _context()
            truth = _truth(context)
            np.testing.assert_array_equal(effect.basis(truth, context), twin.basis(truth, context))


def test_parameter_names_are_unique_over_the_catalogue() -> None:
    names = [p.name for effect in catalogue().values() for p in effect.parameters(_context())]
    assert len(names) == len(set(names))


@each_effect
def test_says_what_is_missing(effect: Effect) -> None:
    context = _context()
    assert effect.missing(context) == ""
    if set(effect.needs) & set(MOTION):
        assert effect.missing(replace(context, moving=False)).startswith("no ")
    for need in set(effect.needs) - {*MOTION, "sample_age"}:
        rest = {name: v for name, v in context.covariates.items() if name != need}
        assert need.replace("_", " ") in effect.missing(replace(context, covariates=rest))
        still = {**context.covariates, need: np.ones(context.n)}
        assert "does not vary" in effect.missing(replace(context, covariates=still))


@each_effect
def test_reads_only_what_it_needs(effect: Effect) -> None:
    context = _context()
    own = {name: context[name] for name in effect.needs if name not in MOTION}
    bare = replace(context, covariates=own)
    theta = _mid_theta(effect, context)
    a, b = (effect.act(theta, _truth(context), c).delta for c in (context, bare))
    assert np.array_equal(a, b)


@each_effect
def test_subset_keeps_the_meaning(effect: Effect) -> None:
    context, rows = _context(), np.array([2, 7, 9])
    theta, truth = _mid_theta(effect, context), _truth(context)
    assert truth.motion is not None
    part = Truth(
        truth.force[rows],
        Motion(truth.motion.rate[rows], truth.motion.spin[rows], truth.motion.jerk[rows]),
    )
    whole = effect.act(theta, truth, context).delta[rows]
    assert np.allclose(effect.act(theta, part, context.take(rows)).delta, whole, atol=1e-13)


@pytest.mark.parametrize(
    "effect", [pytest.param(e, id=e.name) for e in EFFECTS.values() if e.stage != "sensor"]
)
def test_fixture_and_mounting_keep_the_norm(effect: Effect) -> None:
    context = _context()
    x = _force(context)
    turned = x + effect.act(_mid_theta(effect, context), Truth(x), context).delta
    assert np.allclose(np.linalg.norm(turned, axis=-1), np.linalg.norm(x, axis=-1), rtol=1e-13)


INVERTIBLE = [e for e in AT_REST.values() if e.stage != "fixture"]


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.sampled_from(INVERTIBLE), min_size=1, max_size=6, unique_by=lambda e: e.name),
    st.integers(0, 2**31),
)
def test_correct_inverts_predict(effects: list[Effect], seed: int) -> None:
    rng = np.random.default_rng(seed)
    context, model = _context(), Model(tuple(effects))
    truth = GRAVITY * rng.uniform(-1.0, 1.0, (context.n, 1, 3))
    typical = np.array([p.typical for p in model.parameters(context)])
    theta = np.where(typical < 50.0, typical, 20.0) * rng.uniform(-1.0, 1.0, typical.size)
    reading = model.predict(theta, truth, context).reading
    assert np.allclose(model.correct(theta, reading, context), truth, rtol=0.0, atol=1e-11)


@pytest.mark.slow
@each_at_rest
def test_recovered_within_its_uncertainty(effect: Effect) -> None:
    data = bench(11)
    base = base_model()
    model = base if effect.name in base.names else base.plus(effect)
    theta, part = ordinary_theta(model, data, 12), model.slices(data.context)[effect.name]
    typical = _typical(effect, data.context)
    theta[part] = 5.0 * typical * np.where(np.arange(typical.size) % 2, -1.0, 1.0)
    found = fit(model, draw(model, theta, data, 13))
    assert found.converged
    if "Absorbed" in effect.identify:
        assert any(effect.name in words for words in found.null_directions)
        alone = fit(base, draw(base, ordinary_theta(base, data, 12), data, 13))
        columns = effect_columns(alone, effect)
        absorbed = alone.at.jacobian @ np.linalg.lstsq(alone.at.jacobian, columns)[0]
        np.testing.assert_allclose(absorbed, columns, atol=1e-5 * np.abs(columns).max())
    else:
        assert not found.null_directions
        sd = found.sd[part]
        assert np.all(np.abs(found.theta[part] - theta[part]) < 4.5 * sd)
        # Determined at all: what was planted stands out of its own uncertainty.
        assert np.all(sd < typical)
