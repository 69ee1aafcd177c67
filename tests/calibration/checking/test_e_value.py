"""Evidence under repeated looks: the mean of a stake, the formula, and what a history keeps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from imucalib.calibration.checking.e_value import KAPPA, Look, e_value, mixture, paid
from imucalib.calibration.checking.history import PastCheck, append_check, read_history
from imucalib.errors import UnreadableInput, UsageError
from worlds.instrument import MG

G, NU, S = 9.80665, 8.0, 0.3 * MG


def look(rng: np.random.Generator, value: np.ndarray | None = None) -> Look:
    direction = rng.standard_normal((4, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    jacobian = MG * np.column_stack([direction, direction**2])
    changes = {"bias": MG * direction, "scale": 1e-3 * G * direction**2}
    given = S * rng.standard_normal(4) if value is None else value
    return Look(given, S**2 * np.eye(4), jacobian, changes, 0.5)


def test_the_mixture_is_a_ratio_of_multivariate_t_densities() -> None:
    rng = np.random.default_rng(1)
    one = look(rng)
    parameters = 0.05 * np.eye(6)
    plain = one.noise + one.jacobian @ parameters @ one.jacobian.T
    null = stats.multivariate_t(np.zeros(4), plain, NU)
    ratios = []
    for name, unit in (("bias", S / MG), ("scale", S / G * 1e3)):
        for kappa in KAPPA:
            columns = kappa * unit * one.changes[name]
            other = stats.multivariate_t(np.zeros(4), plain + columns @ columns.T, NU)
            ratios.append(np.exp(other.logpdf(one.value) - null.logpdf(one.value)))
    found = mixture([one], parameters, reading=S, dof=NU, gravity=G)
    assert found == pytest.approx(0.5 + 0.5 * np.mean(ratios))


@pytest.mark.slow
def test_its_mean_is_one_at_every_look_though_the_calibration_errs_alike_in_all() -> None:
    rng = np.random.default_rng(2)
    parameters = 0.05 * np.eye(6)
    totals = np.zeros((700, 2))
    first, second = look(rng), look(rng)
    for run in range(len(totals)):
        scale = 1.0 / np.sqrt(rng.chisquare(NU) / NU)  # true noise over the estimated one
        theta = rng.multivariate_normal(np.zeros(6), parameters)
        looks = [
            Look(scale * (one.jacobian @ theta + S * rng.standard_normal(4)), one.noise,
                 one.jacobian, one.changes, 0.5)
            for one in (first, second)
        ]  # fmt: skip
        for k in (1, 2):
            totals[run, k - 1] = mixture(looks[:k], parameters, reading=S, dof=NU, gravity=G)
    # Heavy-tailed: the mean of a capped e-value may only be below one.
    assert (np.minimum(totals, 100.0).mean(axis=0) < 1.15).all()
    assert (totals.max(axis=1) >= 20.0).mean() <= 0.05


def test_looks_at_a_level_pay_what_they_stake() -> None:
    rng = np.random.default_rng(3)
    p = rng.random((20000, 12))
    payments = np.array([paid(row) for row in p])
    assert payments.mean() <= 1.1
    assert (0.7 * payments >= 20.0).mean() <= 0.05
    assert paid([0.02]) == pytest.approx(1.0 / 0.035)
    assert paid([0.03]) == 0.0


def test_a_change_gathers_evidence_and_a_late_one_too() -> None:
    rng = np.random.default_rng(4)
    parameters = 0.01 * np.eye(6)
    shift = np.array([1.2, 0.0, 0.0])
    quiet = [look(rng) for _ in range(3)]
    moved = []
    for _ in range(3):
        one = look(rng)
        moved.append(Look(one.value + one.changes["bias"] @ shift, one.noise, one.jacobian,
                          one.changes, 0.5))  # fmt: skip
    both = (
        e_value(looks, parameters, reading=S, dof=NU, gravity=G)
        for looks in (quiet, quiet + moved, moved)
    )
    still, late, early = both
    assert still < 1.0
    assert min(late, early) > 20.0


def test_a_history_keeps_what_evidence_needs(tmp_path: Path) -> None:
    path, rng = tmp_path / "h.jsonl", np.random.default_rng(5)
    assert read_history(path, "abc") == ()
    first, second = look(rng), look(rng)
    told = {"calibration_sha256": "abc", "verdict": "still good"}
    append_check(path, (), PastCheck({"": first}, told))
    past = read_history(path, "abc")
    append_check(path, past, PastCheck({"": second}, told))
    again = read_history(path, "abc")
    for kept, given in zip(again, (first, second), strict=True):
        for name in ("value", "noise", "jacobian"):
            assert np.array_equal(getattr(kept.sensors[""], name), getattr(given, name))
        assert kept.sensors[""].p == given.p
    with pytest.raises(UsageError, match="another calibration"):
        read_history(path, "other")
    lines = path.read_text().splitlines()
    for bad in ("{", json.dumps({"schema": "else"}), lines[0].replace("jacobian", "j")):
        path.write_text(lines[0] + "\n" + bad + "\n")
        with pytest.raises(UnreadableInput) as error:
            read_history(path, "abc")
        assert "line 2" in error.value.where
