"""Plans that separate rivals: their angles by plain least squares, and what they promise."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.linalg import null_space

from imucalib.core.context import Context
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.effects import catalogue
from imucalib.loop.asked import Searched
from imucalib.loop.found import FitLoop
from imucalib.loop.posterior.closed import close_loop
from imucalib.loop.separation import plan, repeated
from imucalib.loop.separation.ambiguities import ambiguities
from imucalib.loop.separation.angle import Pair, apart, pairs_of
from imucalib.loop.separation.choice import Pool, separating, total_of
from imucalib.loop.separation.plan import FEWEST, separation
from imucalib.loop.separation.products import TAU, Ambiguity, Products
from imucalib.loop.separation.prospect import Added, Drawn, alone, ends, taken_out, weights
from imucalib.loop.separation.soon import in_order, soon
from imucalib.units import MG
from worlds.bench import base_model

G = 9.80665
NAMES = ("quadratic", "asymmetry", "cross_axis")


@cache
def searched(seed: int = 3, noise: float = 0.3) -> FitLoop:
    """Twenty-four attitudes of a sensor with squares, by the size of gravity."""
    rng = np.random.default_rng(seed)
    z = 1.0 - (2.0 * np.arange(24) + 1.0) / 24
    turn = 2.399963 * np.arange(24)
    u = np.column_stack([np.sqrt(1.0 - z**2) * np.cos(turn), np.sqrt(1.0 - z**2) * np.sin(turn), z])
    reading = 1000.0 * u + np.array([12.0, -9.0, 20.0]) + np.array([3.0, -2.5, 3.5]) * u**2
    reading = (reading + noise * rng.standard_normal((24, 3)))[:, None] * MG
    context = Context(24, {"order": np.linspace(0.0, 1.0, 24)})
    label = tuple(f"row {k + 1}" for k in range(24))
    data = Observations(
        reading, np.full((24, 1, 3), MG), KnownNorm(24, G), context, np.arange(24), label
    )
    model = base_model(("bias", "scale", "non_orthogonality"))
    effects = {name: catalogue()[name] for name in NAMES}
    return close_loop(model, data, Searched(effects, ())).loop


def ambiguity() -> Ambiguity:
    found = ambiguities(searched())
    assert len(found) == 1
    return found[0]


def columns(u: np.ndarray) -> dict[str, np.ndarray]:
    """What parameters do to the size of the reading, in mg at typical sizes: by hand."""
    cross = [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)]
    own = [u[:, i] * u[:, j] for i, j in ((1, 0), (2, 0), (2, 1))]
    return {
        "base": np.column_stack([50.0 * u, 30.0 * u**2, *(20.0 * c for c in own)]),
        "quadratic": 3.0 * u**3,
        "asymmetry": 2.0 * u * np.abs(u),
        "cross_axis": 3.0 * np.column_stack([u[:, i] ** 2 * u[:, j] for i, j in cross]),
    }


def pool(directions: np.ndarray, one: Ambiguity) -> Pool:
    """Rests by hand, in the units of the recording's noise."""
    scale = searched().final.noise.factor
    parts = columns(directions)
    names = ["base", *one.blocks]
    rows = np.column_stack([parts[name] for name in names]) / scale
    return Pool(rows[:, :, None] * rows[:, None], 1.0)


def grid() -> np.ndarray:
    rng = np.random.default_rng(1)
    u = rng.standard_normal((150, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True)


def test_products_are_those_of_columns_by_hand() -> None:
    one, u = ambiguity(), searched().final.observations.reading[:, 0]
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    parts = columns(u)
    rows = np.column_stack([parts[name] for name in ("base", *one.blocks)])
    rows = rows / searched().final.noise.factor
    size = np.sqrt(np.diag(rows.T @ rows))
    away = (one.products.gram - rows.T @ rows) / np.outer(size, size)
    assert np.abs(away).max() < 0.12  # the bias of some 25 mg turns what is along the reading


def test_the_angle_is_that_of_least_squares() -> None:
    one = ambiguity()
    rows, theta = np.random.default_rng(2).standard_normal((60, len(one.columns))), np.ones(3)
    at, other = one.blocks["quadratic"], one.blocks["asymmetry"]
    rest = np.concatenate([one.own, other])
    pair = Pair("quadratic", "asymmetry", at, other, one.own, theta[:, None])
    signal = rows[:, at] @ theta
    left = signal - rows[:, rest] @ np.linalg.lstsq(rows[:, rest], signal, rcond=None)[0]
    found = apart(rows.T @ rows, (pair,))
    assert found[0] == pytest.approx(np.linalg.norm(left), rel=1e-6)


def test_squares_are_products_of_axes_by_gravity_alone() -> None:
    """x³ = x - x y² - x z² where x² + y² + z² = 1."""
    one = ambiguity()
    made = separation(one, pool(grid(), one), np.random.default_rng(0), most=6)
    assert ("quadratic", "cross_axis") in made.never
    assert ("asymmetry", "cross_axis") not in made.never
    assert not made.enough


def test_a_plan_beats_random_and_informative_rests() -> None:
    one = ambiguity()
    seen = pool(grid(), one)
    made = separation(one, seen, np.random.default_rng(0), most=8)
    assert made.informative is not None
    assert made.random is not None
    assert made.least > 1.1 * max(made.informative.apart, made.random.apart)
    for other in (made.informative, made.random):
        assert other.needed is None or other.needed >= 2 * len(made.plan)


def test_no_exchange_would_make_a_plan_better() -> None:
    one = ambiguity()
    seen = pool(grid(), one)
    made = separation(one, seen, np.random.default_rng(0), most=5)
    pairs = tuple(p for p in pairs_of(one) if (p.truth, p.other) in made.pairs)
    worth = separating(one.products.gram, pairs)
    now = float(worth(total_of(seen, made.plan)[None])[0])
    for place in range(len(made.plan)):
        rest = (*made.plan[:place], *made.plan[place + 1 :])
        assert float(worth(total_of(seen, rest) + seen.gram).max()) <= now * (1.0 + 2e-3)


def test_a_plan_has_several_rests_that_none_carries_alone() -> None:
    one = ambiguity()
    seen = pool(grid(), one)
    strong = Pool(seen.gram[:149] + 10.0 * seen.gram.sum(axis=0), 150.0)
    assert len(separation(one, strong, np.random.default_rng(0)).plan) == FEWEST


def test_the_first_of_a_plan_are_enough_most_of_the_time() -> None:
    """In order of what each adds; the chance is the mean over rivals, as likely as they are."""
    one = ambiguity()
    seen = pool(grid(), one)
    against = {"quadratic": ("asymmetry",), "asymmetry": ("quadratic",)}
    pairs = tuple(p for p in pairs_of(one) if p.other in against.get(p.truth, ()))
    worth = separating(one.products.gram, pairs)
    plan = tuple(np.random.default_rng(2).integers(0, len(seen.gram), 40).tolist())
    ordered = in_order(seen, plan, worth)
    assert sorted(ordered) == sorted(plan)
    alone_best = max(plan, key=lambda k: float(worth(seen.gram[k][None])[0]))
    assert ordered[0] == alone_best
    rng = np.random.default_rng(1)
    found = soon(one, seen, ordered, against, rng, fewest=4, enough=0.5, draws=300)
    assert found is not None
    assert found.count < 40
    mean = sum(found.likely[name] * found.ended[name] for name in against)
    assert found.chance == pytest.approx(mean)
    assert found.chance >= 0.5
    assert soon(one, seen, (), {}, rng, fewest=4, enough=0.5, draws=300) is None


def test_rivals_are_as_likely_as_their_evidence() -> None:
    """Against the restricted likelihood of the rows, written out, at the best of the sizes."""
    one, products = ambiguity(), ambiguity().products
    root = np.linalg.cholesky(products.gram + 1e-9 * np.diag(np.diag(products.gram)))
    rows = root.T
    data = np.linalg.solve(root, products.along)
    rest = products.power - data @ data
    contrasts = null_space(rows[:, one.own].T)
    y, freedom = contrasts.T @ data, products.numbers - one.first

    def nats(name: str) -> float:
        block = contrasts.T @ rows[:, one.blocks[name]]
        values, turn = np.linalg.eigh(block @ block.T)
        along = (turn.T @ y) ** 2
        return max(
            -0.5 * np.log1p(t**2 * np.maximum(values, 0.0)).sum()
            - 0.5 * freedom * np.log(rest + (along / (1.0 + t**2 * np.maximum(values, 0.0))).sum())
            for t in TAU
        )

    each = np.array([nats(name) for name in one.rivals])
    share = np.exp(each - each.max())
    assert list(weights(one).values()) == pytest.approx(list(share / share.sum()), rel=0.02)


@pytest.mark.parametrize(
    ("truth", "other"), [("asymmetry", "quadratic"), ("quadratic", "asymmetry")]
)
def test_more_of_the_same_ends_more_often(truth: str, other: str) -> None:
    one = ambiguity()
    seen = pool(grid(), one)
    shares = [
        ends(one, Added(times * seen.gram.sum(axis=0), 150.0 * times), np.random.default_rng(0),
             400, {truth: (other,)})[truth]
        for times in (0.03, 0.3, 3.0)
    ]  # fmt: skip
    assert shares == sorted(shares)
    assert shares[0] < 0.6
    assert shares[-1] > 0.98


def judged(rows: np.ndarray, y: np.ndarray, found: list[np.ndarray]) -> bool:
    """Whether the first block is alone for one draw of the data: by covariances and least squares
    on contrasts that the base (two columns) leaves nothing in."""
    away = null_space(rows[:, :2].T)
    data, freedom = away.T @ y, len(rows) - 2
    blocks = [away.T @ rows[:, at] for at in found]

    def nats(block: np.ndarray) -> float:
        def one(tau: float) -> float:
            covariance = np.eye(freedom) + tau**2 * block @ block.T
            power = data @ np.linalg.solve(covariance, data)
            change = np.log(power) - np.log(data @ data)
            return float(-0.5 * np.linalg.slogdet(covariance)[1] - 0.5 * freedom * change)

        return max(one(tau) for tau in TAU)

    first, *others = blocks
    best = nats(first)
    theta, (rest,) = np.linalg.lstsq(first, data, rcond=None)[:2]
    noise = np.sqrt(rest / (freedom - first.shape[1]))
    for other in others:
        signal = first @ theta
        left = signal - other @ np.linalg.lstsq(other, signal, rcond=None)[0]
        close = np.linalg.norm(left) < 2.0 * noise
        own = nats(other)
        if own >= max(best - 3.0, 0.5 * best) or (own >= 0.5 * best and close):
            return False
    return True


@pytest.mark.parametrize("size", [0.3, 0.5, 0.8])
def test_a_rival_is_alone_by_evidence_and_by_what_the_others_cannot_explain(size: float) -> None:
    rng = np.random.default_rng(7)
    rows = rng.standard_normal((11, 7))
    rows[:, 4:6] = 0.6 * rows[:, 2:4] + rows[:, 4:6]
    found = [np.array([2, 3]), np.array([4, 5]), np.array([6])]
    names = ("true", "near", "far")
    y = (size * rows[:, 2:4] @ np.array([2.0, -1.0]))[:, None] + rng.standard_normal((11, 300))
    one = Ambiguity(
        "true", ("base",), tuple("abcdefg"), names, dict(zip(names, found, strict=True)), {},
        Products(rows.T @ rows, rows.T @ y[:, 0], 1.0, 11.0), 9.0,
    )  # fmt: skip
    data = Drawn(rows.T @ y, np.sum(y**2, axis=0), 11.0)
    share = alone(one, taken_out(one, rows.T @ rows), data, "true", names[1:])
    assert 0.03 < share.mean() < 0.97
    expected = [judged(rows, y[:, k], found) for k in range(300)]
    np.testing.assert_array_equal(share, expected)


@pytest.mark.parametrize("goal", [0.0, 1.7, 2.0, 9.0])
def test_how_many_of_another_choice_is_found_by_looking_at_a_few(goal: float) -> None:
    every = np.sqrt(0.05 * np.arange(1, 193))
    looked = []

    def reached(k: int) -> float:
        looked.append(k)
        return float(every[k - 1])

    assert repeated._beside(reached, 24, goal) == plan.beside(every, 24, goal)
    assert len(looked) < 12


@pytest.mark.parametrize("least", [*range(1, 25), 99])
def test_how_often_is_the_fewest_that_ends_it(least: int) -> None:
    asked: list[int] = []

    def after(k: int) -> tuple[int, dict[str, float]]:
        asked.append(k)
        return -k, {"a": 1.0, "b": 1.0 if k >= least else 0.0}

    count, best, ended = repeated._fewest(after)
    assert count == min(least, repeated.MOST) == -best
    assert (ended["b"] == 1.0) == (least <= repeated.MOST)
    assert len(asked) <= 10


@pytest.mark.parametrize("hidden", [1e-3, 1e-8, 1e-13, 0.0])
def test_columns_that_the_data_hardly_show_end_no_calibration(hidden: float) -> None:
    """A gain of a gyroscope that the motion hardly turns, beside one that it turns a million times
    the noise: the products of both are one block, and rounding leaves it no square root."""
    rng = np.random.default_rng(7)
    shown = 1e7 * rng.standard_normal((400, 4))
    base = np.column_stack([shown, shown @ rng.standard_normal((4, 3)) + hidden * shown[:, :3]])
    rivals = 1e6 * rng.standard_normal((400, 2)) + base[:, :2]
    every = np.column_stack([base, rivals])
    data = rivals @ np.array([0.5, 0.0]) + rng.standard_normal(400)
    gram = every.T @ every
    gram -= 4e-16 * np.outer(np.diag(gram), np.diag(gram)) ** 0.5  # as sums over blocks leave it
    one = Ambiguity(
        effect="one", base=("base",), columns=tuple(f"c{k}" for k in range(9)),
        rivals=("one", "two"), blocks={"one": np.array([7]), "two": np.array([8])},
        nats={"one": 1.0, "two": 0.0}, dof=390.0,
        products=Products(gram, every.T @ data, float(data @ data), 400.0),
    )  # fmt: skip
    for name, size in one.sizes.items():
        drawn = size.drawn(np.random.default_rng(0), 100, np.ones(100))
        assert np.isfinite(size.mean).all(), name
        assert np.isfinite(drawn).all(), name
