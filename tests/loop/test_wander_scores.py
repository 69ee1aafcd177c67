"""Evidence beside a walk: ratios of likelihoods of whole covariance matrices."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.loop.wander import forms, scores
from imucalib.loop.wander.bank import bank_of, walks_of
from imucalib.loop.wander.chance import null_of
from imucalib.loop.wander.forms import Rival, leads, rival_form
from imucalib.loop.wander.likelihood import Terms, levels
from imucalib.loop.wander.noise import likely_walks
from imucalib.loop.wander.scores import Entry, Scored, beside, scored
from imucalib.loop.wander.walk import Course, Walk, drawn

N, BASE = 40, 3
KEEP = np.array([True, False, True])
PART = np.repeat([0, 1, 2], [16, 6, 18])
TERMS = Terms(np.arange(BASE), np.full(BASE, 0.25), BASE)


def bank(seed: int, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Three columns of a base, seven of candidates, the data; one walk, which is white."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((N, 11))
    columns[:, 10] += 0.8 * columns[:, 3] - 0.5 * columns[:, 5] + 0.6 * columns[:, 0]
    monkeypatch.setattr(scores, "whitened", lambda _, __, x, ___: (x[None], None))
    sums = np.array([columns[k == PART].T @ columns[k == PART] for k in range(3)])

    def over(*_: object) -> tuple[np.ndarray, np.ndarray]:
        return columns.T @ columns, columns[~KEEP[PART]]

    def by_part(_: int, at: np.ndarray) -> np.ndarray:
        return sums[:, at][:, :, at]

    return SimpleNamespace(
        columns=columns, data=10, white=lambda _, at: columns[:, at],
        course=SimpleNamespace(part=PART), walks=("white",), count=np.bincount(PART),
        log_det=np.zeros((1, 3)), by_part=by_part,
        over=over, plus=lambda more: more, made={},
        products=lambda at, keep: by_part(0, at)[keep].sum(axis=0)[None],
    )  # fmt: skip


def nats(made: SimpleNamespace, block: np.ndarray, size: float) -> float:
    rows = KEEP[PART]
    y, freedom = made.columns[rows, 10], rows.sum() - BASE
    nothing = np.eye(rows.sum()) + made.columns[rows, :BASE] @ made.columns[rows, :BASE].T / 0.25
    whole = nothing + size**2 * block[rows] @ block[rows].T
    dets = np.linalg.slogdet(whole)[1] - np.linalg.slogdet(nothing)[1]
    power = np.log((y @ np.linalg.solve(whole, y)) / (y @ np.linalg.solve(nothing, y)))
    return float(-0.5 * dets - 0.5 * freedom * power)


def test_columns_beside_a_bank_gain_their_likelihood_ratio(monkeypatch: pytest.MonkeyPatch) -> None:
    made = bank(1, monkeypatch)
    blocks, sizes = [made.columns[:, 3:5], made.columns[:, 5:6]], (0.3, 2.0)
    found = beside(made, TERMS, KEEP, 0, blocks, sizes)  # type: ignore[arg-type]
    expected = [[nats(made, block, size) for size in sizes] for block in blocks]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_candidates_are_scored_at_their_best_size(monkeypatch: pytest.MonkeyPatch) -> None:
    made = bank(2, monkeypatch)
    entries = [
        Entry("pair", "", "effect", np.array([3, 4])), Entry("one", "", "time", np.array([5])),
        Entry("none", "", "effect", np.array([6, 7])),
    ]  # fmt: skip
    found, chance = scored(made, TERMS, KEEP, entries, (0,))  # type: ignore[arg-type]
    assert chance.shape == (2, 0)
    sizes = (0.1, 0.3, 1.0, 3.0, 10.0)
    rows = KEEP[PART]
    base, y = made.columns[rows, :BASE], made.columns[rows, 10]
    away = np.eye(rows.sum()) - base @ np.linalg.solve(base.T @ base + 0.25 * np.eye(3), base.T)
    for s in found:
        block = made.columns[:, s.entry.columns]
        each = [nats(made, block, size) for size in sizes]
        assert s.evidence == pytest.approx(max(*each, 0.0), abs=1e-9)
        assert s.size == sizes[int(np.argmax(each))]
        own = block[rows]
        kept = float(np.trace(own.T @ away @ own))
        assert s.left == pytest.approx(kept / np.sum(own**2))
        assert s.strength == pytest.approx(np.sqrt(kept))
        fitted = own.T @ away @ y
        explained = fitted @ np.linalg.solve(own.T @ away @ own, fitted)
        assert s.share == pytest.approx(explained / (y @ away @ y))
    assert [s.evidence for s in found] == sorted((s.evidence for s in found), reverse=True)


@pytest.mark.parametrize(("terms", "widest"), [(6, 10.0), (7, 3.0)])
def test_a_curve_of_seven_terms_is_held_to_three_typical_sizes(
    monkeypatch: pytest.MonkeyPatch, terms: int, widest: float
) -> None:
    made = bank(3, monkeypatch)
    at = np.arange(3, 3 + terms)
    made.columns[:, 10] = 50.0 * made.columns[:, at].sum(axis=1) + made.columns[:, 10]
    sums = np.array([made.columns[k == PART].T @ made.columns[k == PART] for k in range(3)])
    made.products = lambda at, keep: sums[:, at][:, :, at][keep].sum(axis=0)[None]
    (found,), _ = scored(made, TERMS, KEEP, [Entry("c", "", "curve", at)], (0,))  # type: ignore[arg-type]
    assert found.size == widest


COLUMN = np.array([3])
FOUR = ("x:r:sine:1", "x:r:power:1", "x:r:power:2", "x:r:power:3")


def beside_forms(
    monkeypatch: pytest.MonkeyPatch, gains: np.ndarray, kind: str = "shape", count: int = 4
) -> tuple[Scored, Rival | None]:
    """A name of 20 nats beside forms; gains : (1 + forms, 2) nats of the name and of each form."""
    made = bank(4, monkeypatch)
    monkeypatch.setattr(forms, "beside", lambda *_: gains)
    monkeypatch.setattr(forms, "SIZES", (0.3, 3.0))
    monkeypatch.setattr(forms, "joined", lambda _, found, name, columns: (name, found))
    tried = [(f"shape@{name}", made.columns[:, :1]) for name in FOUR[:count]]
    own = Scored(Entry("cubic", "", kind, COLUMN), 20.0, 0, 1.0, 0.9, 3.0, 0.1)
    return own, rival_form(made, TERMS, KEEP, own, tried)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("kind", "lead", "taken"),
    [("shape", 3.1, True), ("shape", 2.9, False), ("temperature", 10.1, True),
     ("temperature", 9.9, False)],
)  # fmt: skip
def test_a_form_outdoes_a_response_by_three_nats_of_the_mean_over_its_values(
    monkeypatch: pytest.MonkeyPatch, kind: str, lead: float, taken: bool
) -> None:
    # The mean over a scan of three values, and of one.
    scan = np.array([9.0, 8.0, 2.0])
    mean = float(np.log(np.mean(np.exp(scan))))
    named = mean - lead
    gains = np.array([[named - 1.0, named], [mean - 0.1, 0.0], [8.0, 7.0], [3.0, 9.0], [2.0, 1.0]])
    own, found = beside_forms(monkeypatch, gains, kind)
    assert found is not None
    assert found.bank == "shape@x:r:power:2"  # type: ignore[comparison-overlap]
    assert found.score.evidence == pytest.approx(20.0 + lead)
    assert found.score.size == 3.0
    assert found.score.entry.family == "shape"
    assert leads(found.score, own) == taken
    assert beside_forms(monkeypatch, gains, count=0)[1] is None


@pytest.mark.parametrize(
    ("kind", "lead", "rival"),
    [("shape", 3.6, True), ("shape", 3.8, False), ("temperature", -0.1, True),
     ("temperature", 0.1, False)],
)  # fmt: skip
def test_a_certain_response_leads_all_forms_together_by_three_nats(
    monkeypatch: pytest.MonkeyPatch, kind: str, lead: float, rival: bool
) -> None:
    """Two kinds alike are 0.7 nats more than one; a form of the same covariate has to lead."""
    gains = np.array([[lead, lead], [0.0, 0.0], [0.0, 0.0]])
    own, found = beside_forms(monkeypatch, gains, kind, count=2)
    assert (found is not None) == rival
    assert found is None or not leads(found.score, own)


def test_a_form_that_is_the_name_itself_is_no_rival(monkeypatch: pytest.MonkeyPatch) -> None:
    made = bank(4, monkeypatch)
    own = Scored(Entry("cubic", "", "shape", COLUMN), 20.0, 0, 1.0, 0.9, 3.0, 0.1)
    itself = [("shape@x:r:power:3", -2.0 * made.columns[:, COLUMN])]
    assert rival_form(made, TERMS, KEEP, own, itself) is None  # type: ignore[arg-type]


def test_a_walk_that_no_candidate_comes_near_with_decides_nothing() -> None:
    """Of data that wander by far more than a run scatters: neither a score nor chance changes
    without the walks that are out of the question."""
    rng = np.random.default_rng(5)
    time = np.sort(rng.uniform(0.0, 86400.0, 400))
    at = Course(time, np.ones((400, 1)), np.ones(400), (np.arange(400) // 100).astype(np.intp))
    x = np.column_stack([np.ones(400), rng.standard_normal((400, 4))])
    bank = bank_of(at, walks_of(time), np.column_stack([x, drawn(at, Walk(10.0, 3600.0), rng, 1)]))
    terms, keep = Terms(np.array([0]), np.array([1e-2]), 1), np.ones(4, dtype=bool)
    entries = [Entry(f"e{k}", "", f"kind {k}", np.array([k])) for k in range(1, 5)]
    every = range(len(bank.walks))
    found, _ = scored(bank, terms, keep, entries, every)
    near = sorted({walk for one in found for walk in one.near})
    assert all(one.walk in one.near for one in found)
    assert 0 not in near
    assert len(near) < len(bank.walks)
    again, _ = scored(bank, terms, keep, entries, near)
    assert [(s.entry, s.evidence, s.walk) for s in again] == [
        (s.entry, s.evidence, s.walk) for s in found
    ]
    likely = levels(bank, terms, keep)
    some = likely_walks(likely)
    assert len(some) < len(bank.walks)
    chances = []
    for walks in (every, some):
        null = null_of(bank, likely, np.random.default_rng(1), 50, walks)
        chances.append(scored(bank, terms, keep, entries, every, null)[1])
    assert np.allclose(*chances, atol=1e-3)
