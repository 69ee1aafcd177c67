"""Residuals of an array in motion against the speed of rotation, before and after the search."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.run import ArrayRun
from imucalib.report.document import Plot, Series
from imucalib.units import DEG, MG


def residual_plots(run: ArrayRun) -> tuple[Plot, ...]:
    """One plot of the gyros and one of the accelerometers; none where nothing was searched."""
    if run.loop is None:
        return ()
    speed = np.geomspace(*_ends(run.loop.final), 60)
    plots = []
    for k, (what, unit, size) in enumerate((("accelerometer", "mg", MG), ("gyro", "deg/s", DEG))):
        noise = run.loop.final.noise[k]
        sd = np.sqrt(noise.variance(speed).mean(axis=1)) / size
        series = [Series("noise that was fitted, 1 sd", speed / DEG, sd, "line")]
        for name, state in (("before", run.loop.base), ("after", run.loop.final)):
            x, y = _scatter(state, k)
            series.append(Series(name, x / DEG, y / size, "points"))
        plots.append(Plot(
            f"{what.capitalize()} residual against the rate", "speed of rotation (deg/s)",
            f"{what} residual ({unit} rms of an axis)", tuple(series),
            "One point a moving sample, rms over all sensors, its own motion taken out.",
            log_y=True,
        ))  # fmt: skip
    return tuple(plots[::-1])


def _ends(state: ArrayState) -> tuple[float, float]:
    speed = np.linalg.norm(state.sampled.rate, axis=1)[state.setup.inner]
    return max(float(speed.min()), 1e-3), float(speed.max())


def _scatter(state: ArrayState, sensor: int) -> tuple[Array, Array]:
    """Speed (n,) rad/s, and the residual's rms over triads and axes (n,), SI."""
    inner, off = state.setup.inner, state.sampled.off
    residual = (off.acceleration, off.rate)[sensor][inner]
    rms = np.asarray(np.sqrt(np.mean(residual**2, axis=(1, 2))), np.float64)
    return np.linalg.norm(state.sampled.rate, axis=1)[inner], rms
