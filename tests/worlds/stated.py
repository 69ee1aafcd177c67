"""Calibration files as they could be: values and a covariance, made by nobody."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from imucalib.calibration.calibration import Calibration
from imucalib.core.effect import Context
from imucalib.core.fit import StoredParameter
from imucalib.effects import named
from worlds.instrument import Array, G


def stated(
    values: Mapping[str, ArrayLike], covariance: Array | None = None, **changes: Any
) -> Calibration:
    """Of effects with their values in printed units; covariance : else a tenth of each unit as its
    standard deviation; changes : of fields of the calibration"""
    found = [
        (named(effect), p, float(v))
        for effect, own in values.items()
        for p, v in zip(named(effect).parameters(Context(1)), np.asarray(own), strict=True)
    ]
    spread = 0.01 * np.eye(len(found)) if covariance is None else covariance
    parameters = tuple(
        StoredParameter(p.name, effect.name, effect.stage, v, float(sd), p.unit)
        for (effect, p, v), sd in zip(found, np.sqrt(np.diag(spread)), strict=True)
    )
    return replace(Calibration("lab", parameters, spread, "m/s2", 1.0, G, "ok"), **changes)


def made(theta: Array, covariance: Array, dof: float = 1e5, *, noise: float = 1.0) -> Calibration:
    """Bias (mg), scale (1) and, of nine numbers, mounting (deg); readings scatter by noise mg."""
    values = dict(zip(("bias", "scale", "mounting"), theta.reshape(-1, 3), strict=False))
    facts = {"noise": {"reading_mg": noise, "reading_sd_mg": noise / np.sqrt(2.0 * dof)}}
    return stated(values, covariance, raw_unit="g", raw_to_si=9.80665, facts=facts)
