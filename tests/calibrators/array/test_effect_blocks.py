"""Effects of an array in its file: their covariance as it was fitted, read back and put to use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibration.calibration import Calibration
from imucalib.calibrators.array.effect_blocks import covariance_of, triangle
from imucalib.calibrators.array.fused.instrument import doubt_of
from imucalib.errors import UnreadableInput
from worlds.rigid_board import board, calibration


def stated(covariance: np.ndarray | None) -> Calibration:
    truth = calibration(board(np.random.default_rng(1)))
    sd = np.full(24, 0.1)
    block = {
        "effect": "gyro_scale",
        "parameters": [{"value": 0.0, "sd": float(s)} for s in sd],
    }
    if covariance is not None:
        block["covariance"] = triangle(covariance)
    free = 1e-6 * np.eye(21)
    return replace(truth, covariance=free, facts={**truth.facts, "effects": [block]})


def test_a_fused_log_takes_the_covariance_and_else_the_sds() -> None:
    apart = np.eye(24) - np.full((24, 24), 1.0 / 24.0)
    apart *= 0.01 / apart[0, 0]
    for given, expected in ((apart, apart), (None, 0.01 * np.eye(24))):
        file = stated(given)
        doubt = doubt_of(file, np.zeros((8, 3)))
        assert doubt is not None
        root = doubt.effects[0][1]
        assert root @ root.T == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("spoilt", ["short", "other"])
def test_a_covariance_that_does_not_fit_is_refused(spoilt: str) -> None:
    block = dict(stated(0.01 * np.eye(24)).facts["effects"][0])
    rows = block["covariance"]
    block["covariance"] = rows[:-1] if spoilt == "short" else [[4 * x for x in r] for r in rows]
    with pytest.raises(UnreadableInput, match="gyro_scale"):
        covariance_of(block)
