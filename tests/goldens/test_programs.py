"""Variance components, chains, gravity, angles and messages against other programs' numbers."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from goldens.programs import (
    FOLDER,
    LOGS,
    MADE,
    SAMPLES,
    chains,
    crossed,
    forces,
    places,
    summary,
)
from imucalib.arrays import Array
from imucalib.core.balance import Balanced, Noise
from imucalib.core.references import angles_of
from imucalib.estimators.markov import convergence
from imucalib.estimators.variance import estimate_noise
from imucalib.readers import read
from imucalib.units import local_gravity


def golden(name: str) -> dict[str, Array]:
    """Column -> numbers; the first line is the certificate."""
    certificate, *rows = (FOLDER / f"{name}.csv").read_text(encoding="utf-8").splitlines()
    assert certificate.startswith("# 20")
    assert MADE[name][0] in certificate
    table = list(csv.DictReader(rows))
    return {k: np.array([float(row[k]) for row in table]) for k in table[0]}


def test_variance_components_are_those_of_statsmodels() -> None:
    y, x, a, b = crossed()
    levels = tuple((which[:, None] == np.arange(which.max() + 1)).astype(float) for which in (a, b))
    at = Balanced(
        residual=y,
        jacobian=x,
        settings=levels,
        component=("a", "b"),
        keep=np.ones((72, 1, 1)),
        owner=np.arange(72),
        sigma=np.ones((72, 1)),
    )
    found = estimate_noise(at, Noise(1.0, ("a", "b"), (1.0, 1.0)), fixed=False)
    want = golden("reml")
    assert found.noise.factor**2 == pytest.approx(want["s2"][0], rel=1e-4)
    np.testing.assert_allclose(np.square(found.noise.sd), [want["a2"][0], want["b2"][0]], rtol=1e-3)
    whole = want["s2"][0] * np.eye(72)
    for share, z in zip((want["a2"][0], want["b2"][0]), levels, strict=True):
        whole += share * z @ z.T
    generalised = np.linalg.inv(x.T @ np.linalg.solve(whole, x))
    np.testing.assert_allclose(found.covariance, generalised, rtol=2e-3, atol=1e-5)


def test_chains_are_judged_as_by_arviz() -> None:
    """To the last digits where chains mix. The autocorrelation of chains that do not never falls to
    zero, and the two programs end its sum some lags apart: 1 % of a size that is refused anyway."""
    found, want = convergence(chains()), golden("diagnostics")
    np.testing.assert_allclose(found.rhat, want["rhat"], rtol=1e-9)
    assert want["rhat"][2] > 1.05
    for name, mine in (("bulk", found.bulk), ("tail", found.tail), ("mcse", found.mcse)):
        np.testing.assert_allclose(mine[:2], want[name][:2], rtol=1e-9)
        np.testing.assert_allclose(mine[2], want[name][2], rtol=0.02)


def test_gravity_is_that_of_ahrs() -> None:
    """Both have WGS 84's formula of the second order in height: a height in m matters to 1e-9."""
    want = golden("gravity")
    np.testing.assert_allclose(places(), np.column_stack([want["latitude"], want["height"]]))
    found = [local_gravity(*place) for place in places()]
    np.testing.assert_allclose(found, want["gravity"], rtol=2e-8)


def test_angles_are_those_of_ahrs() -> None:
    want = golden("angles")
    inclination, tool_face = angles_of(forces())
    np.testing.assert_allclose(inclination, want["pitch"], atol=1e-12)
    away = np.mod(tool_face - want["roll"] + np.pi, 2.0 * np.pi) - np.pi
    np.testing.assert_allclose(away, 0.0, atol=1e-12)


def test_messages_are_those_of_the_official_decoders() -> None:
    """Of every topic of the sample logs: stamps, count, and sums that any other sample changes."""
    want = golden("messages")
    rows = []
    for number, name in enumerate(LOGS):
        recording = read(SAMPLES / name)
        triads = sorted({c.triad for c in recording.channels.values()})
        start = min(float(c.t[0]) for c in recording.channels.values())
        for triad in triads:
            force = recording.channels[f"{triad}/acceleration"]
            turning = recording.channels.get(f"{triad}/angular_rate")
            rate = np.zeros_like(force.values) if turning is None else turning.values
            rows.append([number, *summary(force.t - start, force.values, rate)])
    for name, column in zip(want, np.array(rows).T, strict=True):
        np.testing.assert_allclose(column, want[name], rtol=1e-12, atol=1e-9, err_msg=name)
