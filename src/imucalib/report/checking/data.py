"""A check as plain types."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from imucalib.calibration.checking.check import POWER, Check, SensorCheck
from imucalib.calibration.checking.e_value import ALPHA
from imucalib.calibration.checking.misfit import FAMILIES
from imucalib.calibration.plain import plain
from imucalib.report.checking.words import attitude_words, causes_in_words
from imucalib.units import MG

SCHEMA = "imucal/check/1"


def check_dict(check: Check, log: str, calibration: str, sha256: str) -> dict[str, Any]:
    """Plain types, ready for JSON."""
    following = check.following
    content: Mapping[str, Any] = {
        "schema": SCHEMA,
        "calibration": calibration,
        "calibration_sha256": sha256,
        "log": log,
        "verdict": check.verdict,
        "exit_code": check.exit_code,
        "p": check.p,
        "e_value": check.e,
        "looks": check.looks,
        "alpha": ALPHA,
        "power": POWER,
        "limits": {n: {"value": v, "unit": FAMILIES[n]} for n, v in check.limits.items()},
        "limits_stated": check.stated,
        "explanation": causes_in_words(check),
        "sensors": [_sensor_dict(s) for s in check.sensors],
        "next": None if following is None else {
            "enough": following.enough,
            "rests_all_round_that_would_do": following.many,
            "rests": [
                {"attitude": attitude_words(d), "direction": d} for d in following.direction
            ],
            "could_see": dict(following.seen),
        },
        "notes": [*check.noise.words, *check.notes],
    }  # fmt: skip
    found: dict[str, Any] = plain(content)
    return found


def _sensor_dict(sensor: SensorCheck) -> dict[str, Any]:
    misfits = sensor.misfits
    return {
        "name": sensor.name,
        "p": sensor.p,
        "causes": list(sensor.causes),
        "one_reading_alone": None if sensor.alone is None else misfits.label[sensor.alone],
        "dof": misfits.dof,
        "readings": misfits.n,
        "directions_known": misfits.directed,
        "changes": [
            {"kind": name, "unit": FAMILIES.get(name, ""), "f": test.f, "p": test.p,
             "rank": test.rank, "p_of_what_is_left": test.rest, "estimate": test.size,
             "sd": test.sd, "could_see": sensor.seen.get(name)}
            for name, test in sensor.tests.items()
        ],
        "misfits": [
            {"reading": misfits.label[o], "mg": v / MG, "sd_mg": s / MG}
            for o, v, s in zip(misfits.owner, misfits.value,
                               np.sqrt(np.diag(misfits.covariance)), strict=True)
        ],
        "gyroscope": None if sensor.gyro is None else {
            "bias_deg_per_s": sensor.gyro.bias, "sd_deg_per_s": sensor.gyro.sd, "p": sensor.gyro.p,
        },
    }  # fmt: skip
