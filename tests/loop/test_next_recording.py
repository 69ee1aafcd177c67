"""What is worth recording next: plans, later recordings, columns of what could be recorded."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.core.balance import Noise
from imucalib.core.context import Context
from imucalib.core.observations import Observations
from imucalib.core.references import KnownVector
from imucalib.effects import catalogue
from imucalib.loop.separation import repeated as again
from imucalib.loop.separation.ambiguities import columns_of
from imucalib.loop.separation.angle import pairs_of
from imucalib.loop.separation.choice import Pool, informative, separating
from imucalib.loop.separation.products import Ambiguity, Products
from imucalib.loop.separation.prospect import Added, ends
from worlds.bench import base_model

Array = NDArray[np.float64]


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
