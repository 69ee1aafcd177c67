"""What a worn recording has shown: time, rests, range of each axis, temperature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.actigraph.calibrate import ActigraphResult, unseen
from imucalib.calibrators.actigraph.errors import norm_sd
from imucalib.calibrators.actigraph.observations import quantisation
from imucalib.core.sphere import even_directions
from imucalib.rests.runs import Scan
from imucalib.units import MG


@dataclass(frozen=True)
class Coverage:
    """hours; rate : Hz; windows, still, runs, light : windows, those at rest, posture runs, and
    those that count less; window : s; noise, resolution : (3,) mg; quantisation : mg
    span : (2, 3) least and largest reading of each axis, local g; temperature : °C, or None
    mean_sd, worst_sd : mg, of the corrected |a| over all directions
    unseen : ends of the axes that gravity never came near, in words
    """

    hours: float
    rate: float
    windows: int
    still: int
    runs: int
    light: int
    window: float
    noise: Array
    resolution: Array
    quantisation: float
    span: Array
    mean_sd: float
    worst_sd: float
    temperature: tuple[float, float] | None
    unseen: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """The block of calibration.yaml and report.json."""
        block: dict[str, Any] = {
            "hours": self.hours,
            "rate_hz": self.rate,
            "windows": self.windows,
            "still_windows": self.still,
            "still_hours": self.still * self.window / 3600.0,
            "posture_runs": self.runs,
            "runs_that_count_less": self.light,
            "noise_of_a_sample_mg": self.noise.tolist(),
            "resolution_mg": self.resolution.tolist(),
            "quantisation_mg": self.quantisation,
            "axis_range_g": {a: self.span[:, k].tolist() for k, a in enumerate("xyz")},
            "norm_sd_mean_mg": self.mean_sd,
            "norm_sd_largest_mg": self.worst_sd,
        }
        if self.temperature is not None:
            block["temperature_degC"] = list(self.temperature)
            block["temperature_reference_degC"] = 25.0
        return block


def coverage_of(
    result: ActigraphResult, scanned: Scan, *, gravity: float, window: float
) -> Coverage:
    """What was recorded, and how well |a| is known by it. gravity : m/s²; window : s"""
    runs = result.runs
    reading = runs.mean / gravity
    sd = norm_sd(result.final, even_directions()) / MG
    warm = runs.temperature[np.isfinite(runs.temperature)]
    return Coverage(
        hours=scanned.stop / 3600.0,
        rate=scanned.rate,
        windows=runs.total,
        still=runs.still,
        runs=runs.n,
        light=result.light,
        window=window,
        noise=runs.noise / MG,
        resolution=runs.resolution / MG,
        quantisation=quantisation(runs) / MG,
        span=np.array([reading.min(axis=0), reading.max(axis=0)]),
        mean_sd=float(sd.mean()),
        worst_sd=float(sd.max()),
        temperature=(float(warm.min()), float(warm.max())) if warm.size else None,
        unseen=tuple(e for e in unseen(runs) if e[0] in "xyz"),
    )
