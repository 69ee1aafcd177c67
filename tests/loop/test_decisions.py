"""What a search decides by, rule by rule: numbers just on either side of each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibrators.array.loop.subject import MotionSubject
from imucalib.calibrators.array.loop.worth import not_held_out, why_not
from imucalib.core.balance import Noise
from imucalib.core.context import Context
from imucalib.core.observations import Observations
from imucalib.core.references import KnownVector
from imucalib.effects import catalogue
from imucalib.loop import candidates, search, shapes
from imucalib.loop.design import Fold
from imucalib.loop.evidence import Candidate, Score
from imucalib.loop.found import LoopSettings, Wander
from imucalib.loop.noise import shared
from imucalib.loop.separation import repeated as again
from imucalib.loop.separation.ambiguities import columns_of
from imucalib.loop.separation.angle import pairs_of
from imucalib.loop.separation.choice import Pool, informative, separating
from imucalib.loop.separation.products import Ambiguity, Products
from imucalib.loop.separation.prospect import Added, ends
from imucalib.loop.separation.worn import _products as worn_products
from imucalib.loop.wander import choice as wander_choice
from imucalib.loop.wander import noise as wander_noise
from imucalib.loop.wander import scores as wander_scores
from imucalib.loop.wander.bank import parts_of as parts_in_time
from imucalib.loop.wander.bank import walks_of
from imucalib.loop.wander.beside import ahead
from imucalib.loop.wander.likelihood import Level, Terms
from imucalib.loop.wander.walk import Walk
from worlds.bench import base_model

Array = NDArray[np.float64]


def score(name: str = "a", evidence: float = 9.0, **more: object) -> Score:
    kind, family = str(more.pop("kind", "effect")), str(more.pop("family", ""))
    curve = str(more.pop("curve", ""))
    bare = Candidate(name, kind, np.zeros((0, 1)), "t", family, curve)  # type: ignore[arg-type]
    made: dict[str, object] = {"p": 0.001, "draws": 999, "left": 1.0, "strength": 5.0, "share": 0.1}
    return Score(candidate=bare, evidence=evidence, **{**made, **more})  # type: ignore[arg-type]


def test_a_candidate_passes_by_its_p_or_by_an_earlier_bar() -> None:
    rules = LoopSettings(alpha=0.035)
    assert search.passes(score(p=0.035), rules)
    assert not search.passes(score(p=0.036), rules)
    held = replace(rules, bar=9.0)
    assert search.passes(score(evidence=9.0, p=0.9), held)
    assert not search.passes(score(evidence=8.9, p=0.0), held)


def test_a_curve_is_clear_three_nats_beyond_chance() -> None:
    rules = LoopSettings()
    assert search.clear(score(evidence=9.0, bar=6.0), rules)
    assert not search.clear(score(evidence=8.9, bar=6.0), rules)
    assert not search.clear(score(evidence=99.0, bar=6.0, p=0.9), rules)
    assert search.clear(score(evidence=10.0, bar=99.0), replace(rules, bar=7.0))


def test_beside_structure_without_a_cause_a_name_has_to_be_certain() -> None:
    """A third harmonic of the tool-face with a product of forces at p 0.034 beside it: the true
    error was 0.80 mg with the product and 0.43 without."""
    rules, name = LoopSettings(), "product_across"
    found = (score(name, p=0.034, evidence=5.0, bar=4.5),)
    form = ("bias", "shape@tool_face:tool_face:sine:120")
    assert search.choose(found, rules, ("bias", "quadratic")) == found[0]
    assert search.choose(found, rules, form) is None
    assert search.choose(found, rules, ("bias", "curve@response:x:-1:1:3")) is None
    assert search.choose(found, rules, ("bias", "curve@bias:order:0:1:3")) == found[0]
    assert search.choose((score("bias_drift", p=0.034),), rules, form) is not None
    assert search.choose((score(name, p=0.01),), rules, form) is not None
    held = replace(rules, bar=4.5)
    assert search.choose(found, held) == found[0]
    assert search.choose(found, held, form) is None
    assert search.choose((score(name, evidence=4.5 + np.log(3.5) + 1e-9),), held, form) is not None


def test_a_scan_is_worth_the_mean_of_its_values() -> None:
    nats = [3.0, 9.0, 8.0, -1.0]
    members = [score(str(k), v, family="scan") for k, v in enumerate(nats)]
    assert search.scan_evidence(members) == pytest.approx(np.log(np.mean(np.exp(nats))))
    rest = (score("plain", 5.0), score("low", -30.0, family="other"))
    found = search._one_a_scan((*sorted(members, key=lambda s: -s.evidence), *rest))
    assert [s.name for s in found] == ["1", "plain", "low"]
    assert found[0].evidence == pytest.approx(np.log(np.mean(np.exp(nats))))
    assert found[2].evidence == 0.0


def fit_of(theta: float = 1.0, *, nats: float, rms: float, **more: object) -> SimpleNamespace:
    one = SimpleNamespace(name="p", unit="mg", plausible=10.0)
    made: dict[str, object] = {
        "converged": True, "null_directions": (), "parameters": (one,), "theta": np.array([theta]),
        "at": SimpleNamespace(residual=np.zeros(30)), "nats": nats, "rms": rms, "own": rms,
        "settings": -np.inf, "chance": False,
    }  # fmt: skip
    return SimpleNamespace(**{**made, **more})


@pytest.mark.parametrize(
    ("after", "reason"),
    [
        ({"nats": 11.0, "rms": 0.99}, ""),
        ({"nats": 10.99, "rms": 0.5}, "+1.0 nats"),
        ({"nats": 9.0, "rms": 0.5, "settings": 1.0}, ""),
        ({"nats": 9.0, "rms": 0.5, "settings": 0.99}, "+1.0 nats"),
        ({"nats": 99.0, "rms": 1.0}, "1 times the error"),
        ({"nats": 20.0, "rms": 1.1, "chance": True}, ""),
        ({"nats": 19.9, "rms": 1.1, "chance": True}, "1.1 times the error"),
        ({"nats": 99.0, "rms": 1.2, "own": 1.0, "chance": True}, "1.2 times the error"),
        ({"nats": 99.0, "rms": 0.9, "own": 1.19}, ""),
        ({"nats": 99.0, "rms": 0.9, "own": 1.21}, "corrected readings are 1.2 times as far off"),
        ({"nats": 99.0, "rms": 0.9, "theta": 10.1}, "implausible size (p = 10.1 mg)"),
        ({"nats": 99.0, "rms": 0.9, "theta": -10.1}, "implausible size"),
        ({"nats": 99.0, "rms": 0.9, "theta": 10.0}, ""),
        ({"nats": 99.0, "rms": 0.9, "converged": False}, "did not converge"),
        ({"nats": 99.0, "rms": 0.9, "null_directions": ("x + y",)}, "cannot determine it: x + y"),
    ],
)
def test_an_effect_must_hold_out(
    monkeypatch: pytest.MonkeyPatch, after: dict[str, float], reason: str
) -> None:
    """One nat at least, be it of rows or of whole settings; a smaller error, or one that the
    settings met by chance beside ten nats; and corrected readings that are not a fifth worse."""
    monkeypatch.setattr(search, "log_predictive", lambda fit: fit.nats)
    monkeypatch.setattr(search, "settings_left_out", lambda before, fit: fit.settings)
    monkeypatch.setattr(search, "_by_settings", lambda before, fit: fit.chance)
    monkeypatch.setattr(search, "held_out_rms", lambda fit: fit.rms)
    monkeypatch.setattr(search, "fitted", lambda fit: SimpleNamespace(rms=lambda: fit.own))
    found = search.objection(fit_of(nats=10.0, rms=1.0), fit_of(**after))  # type: ignore[arg-type]
    assert (found is None) == (not reason)
    if found is not None:
        assert reason in found.reason
        assert found.by_data == ("hold out" in found.reason)


def trial(density: float, value: float = 1.0, **more: object) -> SimpleNamespace:
    parameter = SimpleNamespace(name="p", unit="ms", plausible=5.0, least=-2.0)
    term = SimpleNamespace(name="t", value=np.array([value]), theta=np.array([value]),
                           parameters=lambda imus: (parameter,))  # fmt: skip
    made: dict[str, object] = {"terms": (term,), "converged": True, "density": density,
                               "setup": SimpleNamespace(imus=("a",)),
                               "sd_of": lambda term: np.array([0.1])}  # fmt: skip
    return SimpleNamespace(**{**made, **more})


@pytest.mark.parametrize(
    ("gains", "density", "value", "reason"),
    [
        ((4.0, -2.9), 1.1, 1.0, ""),
        ((9.0, -3.1), 1.1, 1.0, "does not hold out: +9.0 and -3.1 nats"),
        ((1.0, -1.9), 1.1, 1.0, ""),
        ((1.0, -2.1), 1.1, 1.0, "does not hold out"),
        ((9.0, 9.0), 1.0, 1.0, "not better"),
        ((9.0, 9.0), 1.1, -5.1, "implausible size (p = -5.1 ms)"),
        ((9.0, 9.0), 1.1, 5.1, "implausible size (p = 5.1 ms)"),
        ((9.0, 9.0), 1.1, -2.4, "implausible size (p = -2.4 ms)"),
        ((9.0, 9.0), 1.1, -2.2, ""),  # within three deviations of the least
    ],
)
def test_both_halves_of_a_motion_must_agree(
    gains: tuple[float, float], density: float, value: float, reason: str
) -> None:
    """Neither loses three nats, nor both together one."""
    found = not_held_out(gains) or why_not(
        trial(1.0),
        trial(density, value),  # type: ignore[arg-type]
    )
    assert (found == "") == (reason == "")
    assert reason in found
    nothing = trial(2.0)
    nothing.terms[0].value = np.zeros(0)
    assert "determine none" in why_not(trial(1.0), nothing)  # type: ignore[arg-type]


def test_walks_remember_from_three_minutes_to_a_sixth_of_the_recording() -> None:
    time = np.linspace(100.0, 100.0 + 6.0 * 12800.0, 50)
    white, *others = walks_of(time)
    assert white == Walk(0.0, 1.0)
    assert sorted({w.tau for w in others}) == [200.0, 800.0, 3200.0, 12800.0]
    assert sorted({w.rho for w in others}) == [0.1, 0.3, 1.0, 3.0, 10.0, 30.0]
    short = walks_of(np.linspace(0.0, 6.0 * 700.0, 50))
    assert {w.tau for w in short[1:]} == {700.0}
    every = np.arange(9)
    folds = (Fold(every[:3], every[4:]), Fold(every[5:], every[:4]))
    assert parts_in_time(folds, 9).tolist() == [0, 0, 0, 1, 2, 3, 3, 3, 3]


def test_a_walk_may_be_larger_unless_it_is_far_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to 3.5 times the fitted one, or within forty nats of the best."""
    walks = tuple(Walk(rho, 1e3) for rho in (0.0, 1.0, 3.4, 3.6, 30.0))
    nats = (0.0, 50.0, 1.0, 10.1, 9.9)
    every = [Level(k, v, 1.0, 20) for k, v in enumerate(nats)]
    n = 12
    fit = SimpleNamespace(
        theta=np.zeros(1), parameters=(SimpleNamespace(typical=1.0),),
        observations=SimpleNamespace(context={"time": np.arange(float(n))}),
    )  # fmt: skip
    rng = np.random.default_rng(0)
    seen = (rng.normal(size=n), rng.normal(size=(n, 1)), rng.normal(size=(n, 4)))
    monkeypatch.setattr(wander_noise, "natural", lambda fit: seen)
    monkeypatch.setattr(wander_noise, "walks_of", lambda time: walks)
    monkeypatch.setattr(wander_noise, "levels", lambda bank, terms, keep: every)
    found = wander_noise.noise_of(fit, np.zeros(n), np.zeros(n, np.intp))  # type: ignore[arg-type]
    assert found.walk == walks[1]
    assert found.evidence == 50.0
    assert found.walks == walks[:4]


def test_parameters_that_a_prior_holds_cost_the_scatter_no_freedom(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Fifty runs of white noise of 1 mg; one column is free, eighty are held to little."""
    n, p = 50, 81
    rng = np.random.default_rng(3)
    fit = SimpleNamespace(
        theta=np.zeros(p), parameters=[SimpleNamespace(typical=1.0)] * p,
        observations=SimpleNamespace(context={"time": np.arange(float(n))}),
    )  # fmt: skip
    seen = (rng.normal(size=n), rng.normal(size=(n, p)), rng.normal(size=(n, 4)))
    monkeypatch.setattr(wander_noise, "natural", lambda fit: seen)
    part, held = np.zeros(n, np.intp), np.append(0.01, np.full(p - 1, 1e6))
    found = wander_noise.noise_of(fit, np.zeros(n), part, held, 1)  # type: ignore[arg-type]
    assert found.scatter == pytest.approx(1.0, abs=0.3)


def test_the_bias_wanders_where_it_carries_more_than_the_scatter() -> None:
    assert Wander(2.0, 3.0, 1.9, 99.0).counts
    assert not Wander(2.0, 3.0, 2.1, 99.0).counts
    assert Wander(0.0, 3.0, 2.1, 99.0).words == "the bias does not wander"


def taken(gains: list[float], before: float = 2.0, after: float = 1.0) -> SimpleNamespace:
    return SimpleNamespace(gains=np.array(gains), before=before, after=after)


def test_blocks_of_time_must_gain_beyond_their_scatter() -> None:
    """In standard errors of the sum, more where time drives it; and the error must fall."""
    assert wander_choice._lead(np.array([1.0, 3.0])) == pytest.approx(4.0 / 2.0)
    assert wander_choice._lead(np.array([2.0, 2.0])) == np.inf
    assert wander_choice._lead(np.zeros(2)) == 0.0
    for kind, need in (("force", wander_choice._GAIN), ("time", wander_choice._GAIN_IN_TIME)):
        # A lead of λ: gains 1 ± √2/λ... of two blocks the sum's error is |a - b|.
        apart = 2.0 / need
        assert wander_choice._objection(taken([1.0 - 0.49 * apart, 1.0 + 0.49 * apart]), kind) == ""  # type: ignore[arg-type]
        assert "standard errors" in wander_choice._objection(
            taken([1.0 - 0.51 * apart, 1.0 + 0.51 * apart]), kind)  # type: ignore[arg-type]  # fmt: skip
    grown = wander_choice._objection(taken([5.0, 5.0], 2.0, 2.1), "force")  # type: ignore[arg-type]
    assert "grows by 5.0 %" in grown
    assert wander_choice._GAIN_IN_TIME > wander_choice._GAIN > 0.0


@pytest.mark.parametrize(
    ("gains", "kind", "stays"),
    [
        ([1198.0, 46.0, 41.0, 43.0, 28.0, 9.0, 14.0], "temperature", True),
        ([1198.0, 46.0, 41.0, 43.0, 28.0, 9.0, 14.0], "time", False),
        ([1198.0, 0.5, -0.5, 0.2, -0.3, 0.1, 0.0], "temperature", False),
        ([900.0, 1100.0, *([-0.5, 0.2, -0.3, 0.1, 0.0] * 2)], "temperature", False),
    ],
)
def test_what_every_block_foretells_is_not_refused_for_the_one_it_foretells_best(
    gains: list[float], kind: str, stays: bool
) -> None:
    """An hour of sauna foretold by the bias of all other hours; an offset of one or two blocks."""
    assert (wander_choice._objection(taken(gains), kind) == "") == stays  # type: ignore[arg-type]


def numbers(kind: str, u: Array, what: str = "bias", against: str = "order") -> list[tuple]:
    return list(shapes._numbers(kind, u, what, against))


def test_forms_are_scanned_over_the_range_of_their_driver() -> None:
    u = np.linspace(2.0, 10.0, 33)  # a span of 8
    assert [p for (p,) in numbers("sine", u, "bias", "tool_face")] == [
        360.0 / k for k in range(1, 13)
    ]
    (first,), *_, (last,) = numbers("sine", u)
    assert (first, last) == pytest.approx((4.0 * 8.0 / 33.0, 12.0))
    assert len(numbers("sine", u)) == 32
    (finest,) = numbers("sine", np.linspace(2.0, 10.0, 99))[0]
    assert finest == pytest.approx(0.5)
    assert numbers("power", u) == [(k, 6.0, 4.0) for k in (2.0, 3.0, 4.0, 5.0)]
    assert numbers("power", u, "response", "xyz")[0] == (2.0, 0.0, 1.0)
    kinks = [v for (v,) in numbers("kink", u)]
    np.testing.assert_allclose(kinks, 2.0 + 8.0 / 17.0 * np.arange(2, 16))
    steps = [v for (v,) in numbers("step", u)]
    between = 2.125 + 0.25 * np.arange(32)
    assert set(steps) <= set(between)
    assert (steps[0], steps[-1]) == (between[2], between[29])
    assert len(steps) == 24
    assert [v for (v,) in numbers("saturation", u, "response", "x")] == [
        0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]  # fmt: skip
    assert numbers("saturation", u) == []
    teeth = numbers("saw_tooth", u)
    assert len(teeth) == 32 * 8
    assert teeth[:3] == [(first, 0.0), (first, 0.125), (first, 0.25)]
    decays = numbers("exponential", u)
    np.testing.assert_allclose(decays[:4], [(0.4, 2.0), (-0.4, 10.0), (0.8, 2.0), (-0.8, 10.0)])
    assert len(decays) == 10
    assert numbers("kink", u[:7]) == []


def test_stretches_of_time_stand_for_noise_that_neighbours_share() -> None:
    """Forty-eight of them, in the order of recording, at a mg each."""
    n = 480
    order = np.random.default_rng(0).permutation(n).astype(float)
    at = SimpleNamespace(owner=np.arange(n), sigma=np.full((n, 3), 2e-3))
    fit = SimpleNamespace(at=at)
    columns = candidates._stretches(fit, order).columns  # type: ignore[arg-type]
    assert columns.shape == (n, 48)
    np.testing.assert_allclose(columns[columns != 0.0], 9.80665e-3 / 2e-3)
    assert np.argmax(columns, axis=1).tolist() == (order // 10).astype(int).tolist()


def test_smooth_curves_are_cosines_and_waves_of_less_and_less_size() -> None:
    x = np.array([2.0, 4.0, 10.0])
    k = np.arange(1, 4)
    due = np.sqrt(2.0) * np.cos(np.pi * k * ((x - 2.0) / 8.0)[:, None]) / k
    np.testing.assert_allclose(candidates._cosines(x, 3), due)
    angle = np.array([0.3, 1.0])
    waves = candidates._harmonics(angle, 4)
    due = [[np.sin(a), np.sin(2 * a) / 2, np.cos(a), np.cos(2 * a) / 2] for a in angle]
    np.testing.assert_allclose(waves, due)


def test_shared_noise_is_looked_for_in_a_dozen_rows_and_few_numbers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def looked(n: int, numbers: int, order: bool = True, dials: int = 0) -> bool:
        context = {"order": np.arange(float(n))} if order else {}
        own = SimpleNamespace(context=context, n=n, of_sessions=(), walk=None, shared=())
        at = SimpleNamespace(residual=np.zeros(numbers), free=dials)
        fit = SimpleNamespace(observations=own, at=at)
        asked = []
        monkeypatch.setattr(shared, "with_noisy_axes", lambda fit: fit)
        monkeypatch.setattr(shared, "_tried", lambda bare, memories: asked.append(memories) or [])
        try:
            shared.with_shared_noise(fit)  # type: ignore[arg-type]
        except ValueError:  # nothing was tried
            return bool(asked)
        return False

    assert looked(12, 36)
    assert not looked(11, 33)
    assert looked(110, 330)
    assert not looked(111, 331)
    assert looked(500, 1500, dials=2)
    assert not looked(501, 1503, dials=2)
    assert not looked(20, 60, order=False)


def bench(groups: Array) -> SimpleNamespace:
    n = len(groups)
    ids = np.arange(n)
    reference = KnownVector(np.zeros(n), np.zeros(n), 9.8, ids, ids)
    reading = np.random.default_rng(0).normal(size=(n, 1, 3))
    return SimpleNamespace(group=groups, n=n, reading=reading, reference=reference)


def rivals() -> Ambiguity:
    """A base of two columns, two rivals of one that are alike but for a tenth, as 40 data say."""
    rng = np.random.default_rng(0)
    base, one, other = rng.normal(size=(40, 2)), rng.normal(size=40), rng.normal(size=40)
    rows = np.column_stack([base, one, one + 0.1 * other])
    data = 1.5 * rows[:, 2] + rng.normal(size=40)
    products = Products(rows.T @ rows, rows.T @ data, float(data @ data), 40.0)
    return Ambiguity("a", ("base",), ("x", "y", "a", "b"), ("a", "b"),
                     {"a": np.array([2]), "b": np.array([3])}, {"a": 9.0, "b": 8.0}, products,
                     37.0)  # fmt: skip


def menu() -> Pool:
    """Three motions of twenty data: one tells the rivals apart, one the base, one nothing."""
    rng = np.random.default_rng(1)
    grams = []
    for apart, base in ((0.6, 1.0), (0.05, 4.0), (0.0, 1.0)):
        one = rng.normal(size=20)
        rows = np.column_stack([base * rng.normal(size=(20, 2)), one,
                                one + apart * rng.normal(size=20)])  # fmt: skip
        grams.append(rows.T @ rows)
    return Pool(np.stack(grams), 20.0)


def test_one_motion_is_repeated_until_nine_of_ten_outcomes_end_it() -> None:
    one, pool = rivals(), menu()
    made = again.repeated(one, pool, np.random.default_rng(0))
    count = len(made.plan)
    assert made.plan == (0,) * count
    assert 1 < count < again.MOST
    assert min(made.ended.values()) >= 0.9
    against = {"a": ("b",), "b": ("a",)}
    shares = [
        min(ends(one, Added(k * pool.gram[0], 20.0 * k), np.random.default_rng(5), 4000,
                 against).values())
        for k in (count - 1, count + 1)
    ]  # fmt: skip
    assert shares[0] < 0.93
    assert shares[1] > 0.88
    # Beside it: the one that tells most of the base model, and the median one.
    pairs = pairs_of(one)
    assert made.informative is not None
    assert made.random is not None
    worth = informative(one.products.gram, one.first)(count * pool.gram)
    assert int(np.argmax(worth)) == 1
    assert made.informative.apart < made.least
    assert made.random.followed == 8 * count
    assert float(separating(one.products.gram, pairs)(count * pool.gram[:1])[0]) == pytest.approx(
        float(made.apart.min() + 0.05 * made.apart.mean())
    )
    assert (made.apart > made.now).all()


def test_new_data_have_an_offset_of_their_own_after_a_power_up() -> None:
    one = rivals()
    later = one.after_a_power_up(25.0)
    assert later.columns[:4] == ("next_bias_x", "next_bias_y", "next_bias_z", "x")
    assert later.first == one.first + 3
    assert [at.tolist() for at in later.blocks.values()] == [[5], [6]]
    gram = later.products.gram
    np.testing.assert_allclose(gram[:3, :3], 25.0 * np.eye(3))
    np.testing.assert_allclose(gram[3:, 3:], one.products.gram)
    assert not gram[:3, 3:].any()
    np.testing.assert_allclose(later.products.along, [0.0] * 3 + one.products.along.tolist())


def test_columns_of_what_could_be_recorded_are_white_by_their_settings() -> None:
    """Each position's three numbers by themselves: V = 1 + Σ sd² n nᵀ, in units of the noise; an
    effect's own derivative at typical size."""
    rng = np.random.default_rng(0)
    n, sigma = 5, 3e-3
    i, t, ids = rng.uniform(-1.0, 1.0, n), rng.uniform(0.0, 6.0, n), np.arange(n)
    reference = KnownVector(i, t, 9.8, ids, ids)
    model = base_model(("bias", "scale"))
    theta = np.array([5.0, -3.0, 2.0, 0.01, -0.02, 0.005])
    truth = reference.truth(np.zeros(2 * n))
    reading = model.predict(theta, truth, Context(n)).reading
    data = Observations(reading, np.full((n, 1, 3), sigma), reference, Context(n), ids, ("",) * n)
    names, sds = KnownVector.COMPONENTS, (2e-3, 4e-3)
    quadratic = catalogue()["quadratic"]
    found = columns_of(model, theta, [quadratic], data, Noise(1.0, names, sds))

    def by(values: Array, own: Array, angles: tuple[Array, Array]) -> Array:
        """The reading of bias, scale and squares at angles, by their equations."""
        u = np.stack([np.cos(angles[0]) * np.sin(angles[1]), np.cos(angles[0]) * np.cos(angles[1]),
                      np.sin(angles[0])], axis=-1)  # fmt: skip
        mg = 9.80665e-3
        return 9.8 * u * (1.0 + values[3:6]) + mg * values[:3] + mg * own * (9.8 * u / 9.80665) ** 2

    step = 1e-6
    for k in range(n):
        at = (i[k : k + 1], t[k : k + 1])
        slopes = [(by(theta + step * e, np.zeros(3), at) - by(theta - step * e, np.zeros(3), at))[0]
                  for e in np.eye(6)]  # fmt: skip
        slopes += [(by(theta, step * e, at) - by(theta, -step * e, at))[0] for e in np.eye(3)]
        typical = [50.0] * 3 + [0.03] * 3 + [3.0] * 3
        rows = np.array(slopes).T / (2.0 * step) * typical / sigma
        v = np.eye(3)
        for sd, moved in zip(sds, ((step, 0.0), (0.0, step)), strict=True):
            up, down = (by(theta, np.zeros(3), (at[0] + s * moved[0], at[1] + s * moved[1]))[0]
                        for s in (1.0, -1.0))  # fmt: skip
            away = sd * (up - down) / (2.0 * step) / sigma
            v += np.outer(away, away)
        np.testing.assert_allclose(found[k].T @ found[k], rows.T @ np.linalg.solve(v, rows),
                                   rtol=1e-5)  # fmt: skip


def test_a_worn_recordings_products_count_for_all_of_its_rows() -> None:
    """Of the rows that were searched, white under the fitted walk."""
    rng = np.random.default_rng(0)
    white = rng.normal(size=(2, 40, 6))
    bank = SimpleNamespace(white=lambda walk, at: white[walk][:, at], data=5)
    found = SimpleNamespace(bank=bank, level=SimpleNamespace(walk=1, variance=2.5))
    problem = SimpleNamespace(fit=SimpleNamespace(observations=SimpleNamespace(n=120)))
    made = worn_products(problem, found, [0, 3])  # type: ignore[arg-type]
    rows = white[1][:, [0, 3]]
    np.testing.assert_allclose(made.gram, 3.0 / 2.5 * rows.T @ rows)
    np.testing.assert_allclose(made.along, 3.0 / 2.5 * rows.T @ white[1][:, 5])
    assert made.power == pytest.approx(1.2 * np.sum(white[1][:, 5] ** 2))
    assert made.numbers == 120.0


@dataclass(frozen=True)
class At:
    """Where a path is: its held-out density, nats."""

    density: float


def path(density: float, **more: object) -> MotionSubject:
    state = At(density)
    made: dict[str, object] = dict.fromkeys(("residuals", "moving", "rng", "ages", "earlier"))
    made.update(rules=LoopSettings(margin=3.0), left_out=frozenset())
    return MotionSubject(state=state, **{**made, **more})  # type: ignore[arg-type]


def test_effects_owe_what_a_leading_curve_has_explained() -> None:
    """Its evidence less the margin, until their refits have gained as much; three may try."""
    effect, curve = score("effect", 20.0), score("curve", 30.0, kind="probe")
    start = path(100.0)
    start.__dict__["searched"] = SimpleNamespace(scores=(curve, effect))
    grown = start._owing(path(112.0), effect, ())
    assert grown.debt == pytest.approx(27.0 - 12.0)
    assert (grown.safe, grown.taken) == (start, 1)
    assert grown.matched == (("curve", start),)
    grown.__dict__["searched"] = start.searched
    paid = grown._owing(replace(grown, state=At(127.0)), effect, ())
    assert (paid.debt, paid.safe, paid.taken) == (0.0, None, 0)
    owing = grown._owing(replace(grown, state=At(126.9)), effect, ())
    assert owing.debt == pytest.approx(0.1)
    assert owing.taken == 2
    # A lead of the margin is none, and an effect that leads owes nothing.
    near = path(100.0)
    near.__dict__["searched"] = SimpleNamespace(scores=(score("curve", 23.0, kind="probe"), effect))
    assert near._owing(path(101.0), effect, ()).safe is None
    leading = path(100.0)
    leading.__dict__["searched"] = SimpleNamespace(scores=(effect, curve))
    assert leading._owing(path(101.0), effect, ()).matched == ()
    assert start._owing(path(101.0), effect, ("curve",)).matched == ()


@pytest.mark.parametrize(
    ("own", "following", "led"), [(20.0, 20.0, True), (20.0, 19.9, False), (41.0, 0.0, True)]
)
def test_a_free_function_has_to_lead_a_name_with_the_next_one(
    monkeypatch: pytest.MonkeyPatch, own: float, following: float, led: bool
) -> None:
    def entry(name: str, kind: str) -> wander_scores.Entry:
        return wander_scores.Entry(name, "", kind, np.array([3]))

    def found(one: wander_scores.Entry, nats: float) -> wander_scores.Scored:
        return wander_scores.Scored(one, nats, 0, 1.0, 1.0, 5.0, 0.1)

    free, name = entry("posture@24", "posture"), entry("cross_axis", "shape")
    others = [entry("cubic", "shape"), entry("bias_drift", "time"), free, name]
    asked: list[str] = []

    def scored(bank: object, terms: object, keep: object, entries: list, *_: object, told: bool):  # type: ignore[no-untyped-def, type-arg]
        asked.extend(e.name for e in entries)
        return (found(entries[0], following),), None

    monkeypatch.setattr(ahead, "scored", scored)
    monkeypatch.setattr(ahead, "best_level", lambda *_: None)
    terms = Terms(np.array([0, 1]), np.ones(2), 2)
    best = found(name, own)
    drift = found(entry("bias_drift", "time"), 99.0)
    named = [(best, 1.0), (drift, 1.0), (found(free, 40.0), 1.0)]
    ahead_of = ahead.ahead_of
    walks = lambda bank, level: (0,)  # noqa: E731
    kept = np.ones(1, dtype=bool)
    more = {"named": named, "entries": others, "walks": walks}
    got = ahead_of(None, terms, kept, found(free, 40.0), **more)  # type: ignore[arg-type]
    assert got is (best if led else None)
    assert asked == ["cubic"]
    assert ahead_of(None, terms, kept, best, **more) is None  # type: ignore[arg-type]
