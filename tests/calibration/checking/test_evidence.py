"""Evidence that grows from look to look, and the history that keeps it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from imucalib.calibration.checking.e_value import (
    KAPPA,
    SCHEMA,
    Look,
    PastCheck,
    append_check,
    counted_once,
    e_value,
    mixture,
    paid,
    read_history,
)
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


def line(of: str = "abc", schema: str = SCHEMA, **other: Any) -> str:
    block = {
        "p": 0.4, "misfit_m_per_s2": [0.1, 0.2], "noise_covariance": [[1.0, 0.0], [0.0, 1.0]],
        "jacobian": [[1.0], [2.0]], "changes": {"bias": [[1.0], [0.5]]}, **other,
    }  # fmt: skip
    return json.dumps({"schema": schema, "calibration_sha256": of, "sensors": {"": block}})


def test_a_line_comes_back_as_numbers(tmp_path: Path) -> None:
    path = tmp_path / "h.jsonl"
    path.write_text(line() + "\n" + line(p=0.01) + "\n", encoding="utf-8")
    first, second = read_history(path, "abc")
    look = first.sensors[""]
    assert look.value.tolist() == [0.1, 0.2]
    assert look.changes["bias"].tolist() == [[1.0], [0.5]]
    assert (look.p, second.sensors[""].p) == (0.4, 0.01)


@pytest.mark.parametrize(
    "damaged",
    [
        line(misfit_m_per_s2=[[0.1, 0.2]]),
        line(misfit_m_per_s2=[0.1, math.nan]),
        line(noise_covariance=[1.0, 1.0]),
        line(jacobian=[[1.0], [math.inf]]),
        line(changes={"bias": [1.0, 0.5]}),
        line(p="likely"),
        line(schema="another/1"),
        "[]",
    ],
)
def test_a_damaged_line_is_told_by_its_number(tmp_path: Path, damaged: str) -> None:
    path = tmp_path / "h.jsonl"
    path.write_text(line() + "\n" + damaged + "\n", encoding="utf-8")
    with pytest.raises(UnreadableInput) as told:
        read_history(path, "abc")
    assert "line 2" in str(told.value)


def test_another_calibrations_history_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "h.jsonl"
    path.write_text(line(of="other") + "\n", encoding="utf-8")
    with pytest.raises(UsageError, match="another calibration"):
        read_history(path, "abc")
    assert read_history(tmp_path / "none.jsonl", "abc") == ()


def test_readings_that_come_again_count_once() -> None:
    """The same log checked twice, one that goes on, and another day's."""

    def look(*value: float) -> Look:
        n = len(value)
        return Look(np.array(value), np.eye(n), np.ones((n, 1)), {"bias": np.ones((n, 1))}, 0.5)

    monday, more, tuesday = look(0.1, 0.2), look(0.1, 0.2, 0.7), look(0.3, 0.2)
    assert counted_once([monday, monday], tuesday.value) == (monday,)
    assert counted_once([monday, tuesday], more.value) == (tuesday,)
    assert counted_once([monday, more, tuesday], look(0.9).value) == (more, tuesday)
    assert counted_once([tuesday], tuesday.value) == ()
