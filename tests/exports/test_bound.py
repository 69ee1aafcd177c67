"""What a form may lose before it is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.core.effect import Context
from imucalib.effects import named
from imucalib.errors import LimitBroken
from imucalib.exports import exported
from imucalib.exports.bound import demand_carried
from imucalib.exports.imus import with_walks
from worlds.rigid_board import board
from worlds.rigid_board import calibration as board_calibration

VALUES = {"bias": (20.0, -15.0, 30.0), "scale": (0.01, -0.02, 0.005), "quadratic": (8.0, -6.0, 8.0)}


def bent(left: float | None) -> Calibration:
    """A sensor with a square, and the error that its calibration leaves, mg."""
    parameters = tuple(
        StoredParameter(p.name, name, "sensor", value, 0.1, p.unit)
        for name, values in VALUES.items()
        for p, value in zip(named(name).parameters(Context(1)), values, strict=True)
    )
    error = {"unit": "mg", "raw": 40.0, "final": left, "held_out": {"final": left}}
    return Calibration("lab", parameters, 0.01 * np.eye(len(parameters)), "ug", 9.8e-6, 9.80665,
                       "ok", facts={"errors": [error]})  # fmt: skip


@pytest.mark.parametrize("form", ["px4", "ardupilot", "omconvert", "ggir-csv", "c-header",
                                  "matlab", "iscwsa-csv"])  # fmt: skip
def test_a_form_is_refused_beyond_three_times_what_is_left(form: str) -> None:
    made = exported(bent(1.0), "x.csv", form)
    loss = made.made.loss
    assert 0.5 < loss < 20.0
    demand_carried(made, form, bent(loss / 2.9), None)
    with pytest.raises(LimitBroken, match=r"quadratic.*--force.*--largest-loss") as refused:
        demand_carried(made, form, bent(loss / 3.1), None)
    assert refused.value.exit_code == 1
    assert f"{loss:.3g} mg" in str(refused.value)
    # The bound that the message names passes.
    named_bound = float(str(refused.value).split("--largest-loss ")[1].split("`")[0])
    demand_carried(made, form, bent(0.0), named_bound)
    with pytest.raises(LimitBroken):
        demand_carried(made, form, bent(100.0), 0.9 * loss)


def test_of_an_array_the_forces_of_motion_count() -> None:
    whole = board_calibration(board(np.random.default_rng(0), chips=3))
    facts = {"not_undone": [{"effect": "sensing_elements", "rms": 0.3, "unit": "m/s²"},
                            {"effect": "gyro_cubic", "rms": 9.0, "unit": "deg/s"}],
             "errors": [{"unit": "m/s²", "final": 0.05, "held_out": {"final": 0.05}}]}  # fmt: skip
    facts = {**whole.facts, "sample_interval_s": 0.01, **facts}
    known = with_walks(replace(whole, facts=facts), 1e-3, 2e-5)
    loss = {f: exported(known, "x", f).made.loss for f in ("kalibr", "urdf", "c-header", "matlab")}
    # Kalibr has a place for the elements, a frame none for any of it.
    assert loss["kalibr"] == loss["urdf"] == 0.0
    assert loss["c-header"] == loss["matlab"] == pytest.approx(0.3 / 9.80665e-3)
    with pytest.raises(LimitBroken, match="sensing_elements"):
        demand_carried(exported(known, "x", "c-header"), "c-header", known, None)
