"""The e-value of a step: its formula written a second time, its level while a table grows."""

from __future__ import annotations

import json
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.linalg import null_space

from imucalib import cli
from imucalib.core.observations import Observations
from imucalib.effects import catalogue
from imucalib.estimators.least_squares import fit
from imucalib.loop.anytime.e_value import e_value, log_e_value
from imucalib.loop.anytime.looks import FIRST, LOOKS_SOON, SOON, Table, passed, schedule
from imucalib.loop.anytime.ratio import Rows
from imucalib.loop.candidates import effect_candidates
from worlds.bench import NINE, base_model, bench, draw, ordinary_theta, tumble

DEG = np.pi / 180.0
# Laid down before the data: deg of a setting at a noise of one, sizes over an effect's typical one.
SCATTER = (0.0, 0.03, 0.1, 0.3)
SIZES = (0.05, 0.2, 0.8)


def _clean(seed: int, n: int, *, angles: bool) -> Observations:
    names = ("mounting", *NINE) if angles else NINE
    data = (bench if angles else tumble)(seed, n)
    model = base_model(names)
    return draw(model, ordinary_theta(model, data, seed), data, seed)


def test_it_is_the_ratio_of_restricted_likelihoods() -> None:
    data = _clean(1, 20, angles=True)
    found = fit(base_model(), data)
    block = effect_candidates(found, [catalogue()["quadratic"]])[0][0].columns
    at = found.at
    contrasts = null_space(at.jacobian.T)
    r = contrasts.T @ at.residual

    def log_q(covariance: np.ndarray) -> float:
        own = contrasts.T @ covariance @ contrasts
        _, det = np.linalg.slogdet(own)
        return float(-0.5 * det - 0.5 * r.size * np.log(r @ np.linalg.solve(own, r)))

    nothing, something = [], []
    for pair in product(SCATTER, repeat=2):
        noise = np.eye(at.residual.size)
        for scatter, matrix in zip(pair, at.settings, strict=True):
            noise += (scatter * DEG) ** 2 * matrix @ matrix.T
        nothing.append(log_q(noise))
        something += [log_q(noise + size**2 * block @ block.T) for size in SIZES]
    expected = np.log(np.mean(np.exp(np.array(something) - nothing[0]))) - np.log(
        np.mean(np.exp(np.array(nothing) - nothing[0]))
    )
    assert log_e_value(found, [block])[0] == pytest.approx(expected, abs=1e-6)


def test_clean_tables_are_hardly_ever_alarmed_however_often_one_looks() -> None:
    largest = []
    for seed in range(40):
        data = _clean(seed, 32, angles=False)
        looks = []
        for n in range(16, 33, 8):
            found = fit(base_model(NINE), data.take(np.arange(n)))
            live, _ = effect_candidates(found, list(catalogue().values()))
            looks.append(e_value(found, [c.columns for c in live], len(live)))
        largest.append(max(looks))
    assert np.mean(np.array(largest) >= 20.0) <= 0.05
    assert np.median(largest) < 2.0


def test_columns_that_were_not_kept_give_none() -> None:
    found = fit(base_model(NINE), _clean(3, 20, angles=False))
    assert np.isnan(e_value(found, [], 1))
    assert np.isnan(e_value(found, [np.zeros((0, 3))], 1))


def test_a_step_of_lab_states_it(tmp_path: Path) -> None:
    rows = tmp_path / "bench.csv"
    run = CliRunner().invoke
    made = run(cli.cli, ["simulate", "lab", str(rows), "--plant", "inclination_zero=0.8", "-q"])
    assert made.exit_code == 0, made.output
    done = run(
        cli.cli, ["lab", str(rows), "--json", "-q", "--draws", "59", "--only", "inclination_zero"]
    )
    (step,) = json.loads(done.stdout)["loop"]["steps"]
    assert step["effect"] == "inclination_zero"
    assert step["e_value"] > 1e3


def test_shares_of_looks_sum_to_one() -> None:
    looks = schedule(10**9)
    assert looks[0][0] == FIRST
    assert all(b > a for (a, _), (b, _) in pairwise(looks))
    # What is left after the last of k looks: a fifth of the chance times 14 / k.
    left = (1.0 - SOON) * LOOKS_SOON / len(looks)
    assert sum(share for _, share in looks) == pytest.approx(1.0 - left)
    assert schedule(40) == looks[: len(schedule(40))]


def _table(data: np.ndarray, effect: np.ndarray) -> Table:
    """One effect beside a mean, rows of one number."""
    n = data.size
    rows = Rows(np.ones((n, 1)), (), (effect[:, None],))
    return Table(rows, n, data, (), [()])


def test_looks_are_passed_by_chance_as_often_as_is_spent() -> None:
    """Ever, in tables that grow to 48 rows; and by an effect of λ 5 in most."""
    rng = np.random.default_rng(3)
    effect = 30.0 * rng.standard_normal(48)
    size = 5.0 / np.linalg.norm(effect - effect.mean())
    spent = 0.2 * sum(share for _, share in schedule(48))
    clean = [passed(_table(rng.standard_normal(48), effect), 0.2) for _ in range(150)]
    found = [
        passed(_table(size * effect + rng.standard_normal(48), effect), 0.045) for _ in range(20)
    ]
    sd = (spent * (1.0 - spent) / len(clean)) ** 0.5
    assert abs(np.mean(clean) - spent) < 3.0 * sd
    assert np.mean(found) > 0.8


def test_a_table_that_grows_keeps_its_looks() -> None:
    """What was passed at 20 rows stays so, whatever comes after."""
    rng = np.random.default_rng(4)
    effect = rng.standard_normal(60)
    strong = 3.0 * effect[:20] + rng.standard_normal(20)
    assert passed(_table(strong, effect[:20]), 0.045)
    for _ in range(5):
        later = np.concatenate([strong, 50.0 * rng.standard_normal(40)])
        assert passed(_table(later, effect), 0.045)
