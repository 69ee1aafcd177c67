"""Numbers inside the search that no story shows: how sure a record is foretold, when a model is too
large for its data, and what a dial's error does to a reading."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from imucalib.loop.faults.noise_grid import beside_rows

from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from imucalib.core.balance import Noise
from imucalib.core.model import Model
from imucalib.effects import named
from imucalib.estimators.least_squares import fit
from imucalib.loop.closed_loop import close_loop
from imucalib.loop.evidence_gram import gram_evidence
from imucalib.loop.faults.angles import apart
from imucalib.loop.noise.shared import _without
from imucalib.loop.record_errors import predict_record
from imucalib.loop.records import set_aside
from imucalib.loop.search import objection
from worlds.bench import base_model, bench, draw, ordinary_theta, tumble
from worlds.sheets import Sheet, direction


@pytest.mark.parametrize("declared", [0.2, 5.0])
def test_a_record_is_foretold_as_well_as_is_said(declared: float) -> None:
    """Squared distances of 60 clean records are chi-square with 3 degrees of freedom, whatever
    noise was declared: mean 3, standard error sqrt(6/60)."""
    base, data = base_model(), bench(3, 60)
    made = draw(base, ordinary_theta(base, data, 3), data, 4)
    found = fit(base, replace(made, sigma=declared * made.sigma))
    assert found.noise.factor == pytest.approx(1.0 / declared, rel=0.3)
    away = [predict_record(set_aside(found, k), k).distance(made.reading[k, 0]) for k in range(60)]
    assert abs(np.mean(away) - 3.0) < 4.0 * np.sqrt(6.0 / 60.0)


def test_a_record_is_off_by_what_its_ring_tells(tmp_path: Path) -> None:
    """Eight rows at one inclination that is 0.4 deg off in each of four rings: the others of the
    ring tell y of a row to half a mg, where the dial's scatter alone leaves 7 mg."""
    rng = np.random.default_rng(4)
    i, t = np.repeat([0.0, 30.0, 50.0, 70.0], 8), np.tile(np.arange(0.0, 360.0, 45.0), 4)
    stood = direction(i + np.repeat([0.4, -0.4, 0.3, -0.5], 8), t + 0.05 * rng.standard_normal(32))
    reading = 1000.0 * stood + [12.0, -7.0, 5.0] + 0.3 * rng.standard_normal((32, 3))
    reading[16, 1] += 8.0
    table = read_position_table(Sheet(i, t, reading).write(tmp_path / "sheet.csv"))
    loop = run_lab(table, LabRequest(unit="mg", seed=0)).result.loop
    assert loop is not None
    (wrong,) = loop.records
    assert (wrong.where, wrong.channel) == ("row 17", "y")
    assert wrong.sd < 1.0
    assert abs(wrong.size - 8.0) < 4.0 * wrong.sd
    assert "angle" not in wrong.likely


@pytest.mark.parametrize(("count", "few"), [(17, True), (19, False), (24, False)])
def test_twelve_parameters_need_eighteen_numbers(count: int, few: bool) -> None:
    nine = base_model(("bias", "scale", "non_orthogonality"))
    data = tumble(2, count)
    made = draw(nine, ordinary_theta(nine, data, 2), data, 5)
    before = fit(nine, made)
    after = fit(Model((*nine.effects, named("cubic"))), made)
    assert len(after.theta) == 12
    found = objection(before, after, -1e9, 1e9)
    assert (found is not None and "too few numbers" in found.reason) == few


@pytest.mark.parametrize(("off", "word"), [(6.5, "suspected"), (40.0, "explained")])
def test_a_record_is_explained_only_beyond_doubt(off: float, word: str) -> None:
    """Of a hundred clean tables one has a record that stands out by seven nats."""
    base, data = base_model(), bench(3, 60)
    made = draw(base, ordinary_theta(base, data, 3), data, 4)
    reading = made.reading.copy()
    reading[20, 0, 1] += off * made.sigma[20, 0, 1]
    loop = close_loop(base, made.with_reading(reading), {}, np.random.default_rng(0))
    assert [r.row for r in loop.records] == [20]
    assert loop.verdict == word


def test_a_dials_errors_turn_the_bench() -> None:
    """Columns 0-7 by differences: one degree of zero, scale at 90 deg, sine and cosine of each."""
    rng = np.random.default_rng(0)
    i, t = rng.uniform(-80.0, 80.0, 30), rng.uniform(0.0, 360.0, 30)
    a, b = np.deg2rad(i), np.deg2rad(t)
    columns = beside_rows(1000.0, a, b, np.eye(3))
    of_i = [np.ones(30), i / 90.0, np.sin(a), np.cos(a), np.sin(b), np.cos(b)]
    small = 1e-4
    for k, by in enumerate(of_i):
        step = 1000.0 * (direction(i + small * by, t) - direction(i, t)) / small
        np.testing.assert_allclose(columns[:, :, k], step, atol=1e-3)
    for k, by in enumerate([np.sin(b), np.cos(b)]):
        step = 1000.0 * (direction(i, t + small * by) - direction(i, t)) / small
        np.testing.assert_allclose(columns[:, :, 6 + k], step, atol=1e-3)
    # A square of the response is proportional to the square of the reading, axis by axis.
    force = direction(i, t)
    ratio = columns[:, [0, 1, 2], [8, 9, 10]] / force**2
    np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-9)


def test_each_block_is_judged_by_its_own_columns() -> None:
    """Blocks of one, three and two columns: what is left of each beside the base, and the share of
    the residual that it explains, by projections."""
    rng = np.random.default_rng(1)
    base = rng.normal(size=(80, 5))
    blocks = [rng.normal(size=(80, k)) + base[:, :1] for k in (1, 3, 2)]
    residual = rng.standard_normal(80) + 3.0 * blocks[2][:, 1]
    found = gram_evidence(residual, base, blocks, 10.0 ** np.arange(-2.0, 1.1), rng, 19)
    q = np.linalg.qr(base)[0]
    rest = residual - q @ (q.T @ residual)
    for k, block in enumerate(blocks):
        beside = block - q @ (q.T @ block)
        assert found.left[k] == pytest.approx(np.sum(beside**2) / np.sum(block**2), rel=1e-9)
        own = np.linalg.qr(beside)[0]
        gone = np.sum((own.T @ rest) ** 2) / np.sum(rest**2)
        share = max(0.0, 1.0 - (1.0 - gone) * 75.0 / (75.0 - block.shape[1]))
        assert found.share[k] == pytest.approx(share, abs=1e-9)
    assert np.argmax(found.evidence) == 2


def test_a_walk_is_taken_out_of_the_noise_alone() -> None:
    noise = Noise(1.5, ("inclination", "tool_face", "walk"), (0.1, 0.2, 0.3))
    assert _without(noise) == Noise(1.5, ("inclination", "tool_face"), (0.1, 0.2))


def test_tool_faces_are_apart_the_short_way_round() -> None:
    shown = np.array([350.0, 30.0, 190.0])
    np.testing.assert_allclose(apart(shown, 10.0, 1), [20.0, 20.0, 180.0])
    np.testing.assert_allclose(apart(np.array([-80.0]), 80.0, 0), [160.0])
