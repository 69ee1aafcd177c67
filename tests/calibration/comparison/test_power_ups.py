"""What a power-up changes is no change of the sensor: one day beside several."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.limits import Limits, sessions_of
from imucalib.calibration.comparison.agreement import agreement
from imucalib.calibration.comparison.basis import basis_of
from imucalib.calibration.comparison.compare import compared, with_power_ups
from worlds.stated import made

#: mg: scatter of the bias between power-ups, and of a calibration's own.
SCATTER, OWN = 0.5, 0.1


def several(rng: np.random.Generator, days: int) -> Calibration:
    """A mean of so many power-ups, whose scatter it knows from as many."""
    theta, stated = np.zeros(6), SCATTER * (rng.chisquare(3 * (days - 1)) / 3 / (days - 1)) ** 0.5
    theta[:3] = np.hypot(SCATTER / days**0.5, OWN) * rng.standard_normal(3)
    theta[3:] = 1e-4 * rng.standard_normal(3)
    covariance = np.diag([stated**2 / days + OWN**2] * 3 + [1e-8] * 3)
    block = {
        "sessions": [str(k) for k in range(days)],
        "scatter": [{"what": "session bias", "sd": stated}],
    }
    one = made(theta, covariance, 60.0)
    return replace(one, facts={**one.facts, "between_sessions": block})


def one_day(rng: np.random.Generator) -> Calibration:
    theta = np.concatenate([
        np.hypot(SCATTER, OWN) * rng.standard_normal(3), 1e-4 * rng.standard_normal(3),
    ])  # fmt: skip
    return made(theta, np.diag([OWN**2] * 3 + [1e-8] * 3), 60.0)


@pytest.mark.parametrize("days", [2, 5])
def test_another_days_calibration_differs_by_chance_in_5_of_100(days: int) -> None:
    """Without the scatter it was 40 to 60."""
    rng, p = np.random.default_rng(days), []
    for _ in range(25):
        found = with_power_ups([several(rng, days), one_day(rng)], {})
        dof = np.full(2, 60.0)
        basis = basis_of(found.calibrations, dof, framed=False, power_ups=found.power_ups)
        p.append(agreement(basis).p)
    # 6 or more of 25 by chance: 0.1 %.
    assert np.sum(np.array(p) <= 0.05) <= 5


def test_a_scatter_that_is_given_is_in_every_sd_of_one_power_up() -> None:
    rng = np.random.default_rng(4)
    files = [one_day(rng), one_day(rng)]
    plain = compared(files, ["a", "b"], Limits())
    found = compared(files, ["a", "b"], Limits(), between=sessions_of(["0.7mg"]))
    bias = np.einsum("kii->ki", found.basis.covariance)[:, :3]
    np.testing.assert_allclose(bias, OWN**2 + 0.7**2)
    np.testing.assert_allclose(found.basis.covariance[:, 3:], plain.basis.covariance[:, 3:])
    assert found.agreement.p > plain.agreement.p
    assert any("0.7 mg of bias, as given" in note for note in found.notes)
    assert any("--between-sessions" in note for note in plain.notes)
