"""A calibration file as it could be: values and a covariance, made by nobody."""

from __future__ import annotations

import numpy as np

from imucalib.calibration.calibration import Calibration, StoredParameter
from worlds.instrument import Array, G

KINDS = (("bias", "mg"), ("scale", "1"), ("mounting", "deg"))


def made(
    theta: Array, covariance: Array, dof: float = 1e5, *, mounted: bool = False
) -> Calibration:
    """Bias (mg), scale (1) and on request mounting (deg), three each."""
    kinds = KINDS if mounted else KINDS[:2]
    names = [(f"{kind}_{axis}", kind, unit) for kind, unit in kinds for axis in "xyz"]
    stages = {"mounting": "mounting"}
    sd = np.sqrt(np.diag(covariance))
    return Calibration(
        calibrator="lab",
        parameters=tuple(
            StoredParameter(n, kind, stages.get(kind, "sensor"), float(v), float(s), unit)
            for (n, kind, unit), v, s in zip(names, theta, sd, strict=True)
        ),
        covariance=covariance, raw_unit="g", raw_to_si=9.80665, gravity=G, status="ok",
        facts={"noise": {"reading_mg": 1.0, "reading_sd_mg": 1.0 / np.sqrt(2.0 * dof)}},
    )  # fmt: skip
