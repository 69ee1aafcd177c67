"""Curves of the actigraph report: errors against time, temperature, each axis and direction."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.actigraph.errors import raw_errors, sphere_cells
from imucalib.calibrators.actigraph.run import ActigraphRun
from imucalib.loop.held_out import fitted
from imucalib.report.document import Block, Plot, Series, Table
from imucalib.units import DEG, MG

_BANDS = ((1.0, "below 1 mg"), (3.0, "1 to 3 mg"), (np.inf, "above 3 mg"))
_BINS = 60


def residual_plots(run: ActigraphRun) -> tuple[Plot, ...]:
    """Error of |a| of every posture run, raw, and before and after the search."""
    result = run.result
    before = fitted(result.base).error[:, 0, 0] / MG if result.loop and result.added else None
    after = run.result.fitted.error[:, 0, 0] / MG
    runs = run.runs
    unit, seconds = ("d", 86400.0) if runs.time[-1] > 3.0 * 86400.0 else ("h", 3600.0)
    when = runs.time / seconds
    drivers = [("time", f"time ({unit})", when)]
    if np.isfinite(runs.temperature).all() and np.ptp(runs.temperature) > 0.0:
        drivers.append(("temperature", "temperature (°C)", runs.temperature))
    drivers += [
        (f"the reading of {a}", f"{a} (g)", runs.mean[:, k] / run.request.gravity)
        for k, a in enumerate("xyz")
    ]
    raw = raw_errors(result.base).error[:, 0, 0] / MG
    first = Plot(
        "Error of |a| raw and corrected",
        f"time ({unit})",
        "mg",
        (Series("raw reading", when, raw, "points"), Series("final model", when, after, "points")),
        "One point a posture run; the figures below show the corrected ones alone.",
    )
    return (first, *(_residuals(name, label, x, before, after) for name, label, x in drivers))


def _residuals(name: str, label: str, x: Array, before: Array | None, after: Array) -> Plot:
    centre, mean = _binned(x, after)
    series: tuple[Series, ...] = (
        Series("final model", x, after, "points"),
        Series("mean of the final error", centre, mean, "line"),
    )
    if before is not None:
        series = (Series("nine parameters", x, before, "points"), *series)
    caption = "One point a posture run; a line that leaves zero is what no effect explains."
    return Plot(f"Error of |a| against {name}", label, "mg", series, caption)


def _binned(x: Array, y: Array) -> tuple[Array, Array]:
    """Means over stretches of equally many points."""
    parts = np.array_split(np.argsort(x), min(_BINS, max(1, x.size // 5)))
    return np.array([x[p].mean() for p in parts]), np.array([y[p].mean() for p in parts])


def sphere_blocks(run: ActigraphRun) -> tuple[Block, ...]:
    """The error over the sphere as a map of the runs and as a table of its parts."""
    held = run.result.final_held
    direction = run.result.fitted.corrected[:, 0]
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    azimuth = np.arctan2(direction[:, 1], direction[:, 0]) / DEG
    height = np.arcsin(np.clip(direction[:, 2], -1.0, 1.0)) / DEG
    size = np.abs(held.error[:, 0, 0]) / MG
    series, low = [], 0.0
    for high, words in _BANDS:
        inside = (size >= low) & (size < high)
        series.append(Series(words, azimuth[inside], height[inside], "points"))
        low = high
    map_ = Plot(
        "Held-out error over the sphere",
        "azimuth of gravity, from x to y (deg)",
        "elevation to z (deg)",
        tuple(s for s in series if s.x.size),
        "One point a posture run, predicted without its block of time.",
    )
    rows = tuple(
        (c.name, str(c.runs), *(_number(v) for v in (c.raw, c.base, c.final, c.held_out, c.sd)))
        for c in sphere_cells(run.result.base, run.result.final, held)
    )
    table = Table(
        "Mean error of |a| by direction (mg)",
        ("towards", "runs", "raw", "nine", "final", "held out", "sd"),
        rows,
        "lrrrrrr",
        "sd: what the parameters' uncertainty leaves there, with or without postures.",
    )
    return map_, table


def _number(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.2f}"
