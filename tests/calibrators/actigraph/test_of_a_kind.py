"""A worn sensor beside its fleet: few postures, sensors of the kind and others, plain numpy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.actigraph.calibrate import ActigraphResult, calibrate
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.run import run_of
from imucalib.calibrators.population import (
    UNLIKELY,
    Population,
    PriorNoise,
    PriorParameter,
    to_yaml,
)
from imucalib.errors import UsageError
from imucalib.rests.runs import PostureRuns
from imucalib.units import MG
from worlds.command import run
from worlds.week import scan_of

NAMES = [
    *(f"bias_{a}" for a in "xyz"), *(f"scale_{a}" for a in "xyz"), "cross_yx", "cross_zx",
    "cross_zy",
]  # fmt: skip
MEAN = np.array([10.0, -5.0, 0.0, 0.01, 0.0, -0.01, 0.002, 0.0, 0.0])
SD = np.array([4.0] * 3 + [0.003] * 6)
KIND = Population(
    devices=9,
    reference="norm",
    effects=(),
    parameters=tuple(
        PriorParameter(n, "mg" if n.startswith("bias") else "1", float(m), float(s))
        for n, m, s in zip(NAMES, MEAN, SD, strict=True)
    ),
    covariance=np.diag(SD**2),
    noise=(PriorNoise("reading", 0.5 * MG, 0.2),),
)
REQUEST = replace(ActigraphRequest(), loop=False)


def sensor(theta: np.ndarray, postures: int, rng: np.random.Generator) -> PostureRuns:
    """Readings of gravity in random postures, 0.5 mg an axis."""
    u = rng.standard_normal((postures, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    matrix = np.diag(1.0 + theta[3:6])
    matrix[1, 0], matrix[2, 0], matrix[2, 1] = theta[6:]
    mean = 1000.0 * u @ matrix.T + theta[:3] + 0.5 * rng.standard_normal((postures, 3))
    return PostureRuns(
        mean=mean * MG, windows=np.full(postures, 6, np.intp),
        time=np.linspace(60.0, 3000.0, postures), temperature=np.full(postures, 25.0),
        window_noise=0.05 * MG, still=6 * postures, total=300, noise=np.full(3, 4.0 * MG),
    )  # fmt: skip


SCAN = scan_of(np.arange(5.0, 3060.0, 60.0), None, rate=100.0, seconds=3060.0)


def result(runs: PostureRuns, kind: Population | None) -> ActigraphResult:
    request = replace(REQUEST, kind=kind)
    return calibrate(runs, SCAN, request)


@pytest.mark.slow
def test_sensors_of_the_kind_are_within_their_sds_from_six_postures() -> None:
    """40 sensors: z rms of 360 numbers is 1 within 4.5 sd of χ²'s; at 1 in 100 each, more than four
    that are told strange have a chance of 6e-5."""
    z, strange = [], 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        theta = MEAN + SD * rng.standard_normal(9)
        found = result(sensor(theta, 6, rng), KIND)
        strange += found.of_a_kind.chance < UNLIKELY
        if found.with_fleet:
            z += list((found.final.theta - theta) / found.final.sd)
            assert np.all(found.final.sd <= SD * (1.0 + 1e-9))
            assert np.all(found.final.sd < found.of_a_kind.alone.sd)
            assert not found.weak
    assert len(z) >= 9 * 35
    assert 0.83 < np.sqrt(np.mean(np.square(z))) < 1.17
    assert strange <= 4


@pytest.mark.parametrize("off", [np.eye(9)[0] * 40.0, np.eye(9)[4] * 0.03])
def test_a_sensor_that_contradicts_its_fleet_is_calibrated_alone(off: np.ndarray) -> None:
    """Ten of the kind's sds off along what eight postures see."""
    runs = sensor(MEAN + off, 8, np.random.default_rng(3))
    found, alone = result(runs, KIND), result(runs, None)
    assert found.of_a_kind.chance < UNLIKELY
    assert not found.with_fleet
    np.testing.assert_array_equal(found.final.theta, alone.final.theta)
    np.testing.assert_array_equal(found.final.sd, alone.final.sd)
    told = run_of(runs, SCAN, replace(REQUEST, kind=KIND), lambda _: None).outcome
    assert "not of its fleet's kind" in str(told.undecided[0])
    assert told.exit_code == 4  # weak, as alone


def test_an_effect_of_the_fleet_needs_what_drives_it_and_no_more() -> None:
    """Six postures within a tenth of a degree show nothing of a temperature; the fleet does: at 35
    degC a device that drifts by 0.3 mg/degC is off by 3 mg."""
    drifts = (PriorParameter(f"temperature_bias_{a}", "mg/degC", 0.3, 0.01) for a in "xyz")
    every = (*KIND.parameters, *drifts)
    covariance = np.diag(np.r_[SD, 0.01, 0.01, 0.01] ** 2)
    warm = replace(
        KIND,
        effects=("temperature_bias",),
        parameters=every,
        covariance=covariance,
    )
    moved = MEAN + 3.0 * np.r_[1.0, 1.0, 1.0, np.zeros(6)]
    runs = sensor(moved, 6, np.random.default_rng(6))
    found = result(replace(runs, temperature=np.linspace(34.95, 35.05, 6)), warm).final
    names = [p.name for p in found.parameters]
    assert found.theta[names.index("temperature_bias_x")] == pytest.approx(0.3, abs=0.04)
    assert np.all(np.abs(found.theta[:9] - MEAN) < 4.0 * found.sd[:9])
    with pytest.raises(UsageError, match="and no temperature was recorded"):
        result(replace(runs, temperature=np.full(6, np.nan)), warm)


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        (("--every", "1h"), KIND, "--every knows no prior"),
        (("--as-published",), KIND, "--as-published knows no prior"),
        ((), replace(KIND, reference="vector"), "this device is by norm"),
    ],
)
def test_what_knows_no_prior_is_refused(
    options: tuple[str, ...], kind: Population, message: str, tmp_path: Path
) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text(to_yaml(kind))
    done = run("actigraph", "none.csv", "--fleet", file, *options)
    assert isinstance(done.exception, UsageError)
    assert message in str(done.exception)
