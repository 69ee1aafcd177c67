"""Curves of the actigraph report: errors against time, temperature, each axis and direction."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.actigraph.errors import norm_sd, raw_errors, sphere_cells
from imucalib.calibrators.actigraph.run import ActigraphRun
from imucalib.core.sphere import even_directions
from imucalib.report.document import Block, Plot, Series, Table
from imucalib.report.sphere import sphere_map
from imucalib.units import MG

_BINS = 60
#: Two standard deviations of noise whose mean size is one.
_NOISE = 2.0 * float(np.sqrt(np.pi / 2.0))


def residual_plots(run: ActigraphRun) -> tuple[Plot, ...]:
    """Error of |a| of every posture run, raw, and before and after the search, held out."""
    result, runs = run.result, run.runs
    before = result.base_held.error[:, 0, 0] / MG if result.loop and result.added else None
    after = result.final_held.error[:, 0, 0] / MG
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
        "error of |a| (mg)",
        (Series("raw reading", when, raw, "points"), Series("corrected", when, after, "points")),
        "One point a posture run; the figures below show the corrected ones alone.",
    )
    noise = _NOISE * result.error.floor
    return (
        first,
        *(_residuals(name, label, x, before, after, noise) for name, label, x in drivers),
    )


def _residuals(
    name: str, label: str, x: Array, before: Array | None, after: Array, noise: float
) -> Plot:
    centre, mean = _binned(x, after)
    ends, zero = np.array([np.nanmin(x), np.nanmax(x)]), np.zeros(2)
    band = Series("noise alone, ± 2 sd", ends, zero, "band", zero - noise, zero + noise)
    series: tuple[Series, ...] = (
        Series("after", x, after, "points"),
        Series("mean after", centre, mean, "line"),
    )
    if before is not None:
        series = (Series("before", x, before, "points"), *series)
    if np.isfinite(noise):
        series = (band, *series)
    caption = (
        "One point a posture run, predicted without its block of time; a line that leaves zero is "
        "what no effect explains."
    )
    return Plot(f"Error of |a| against {name}", label, "error of |a| (mg)", series, caption)


def _binned(x: Array, y: Array) -> tuple[Array, Array]:
    """Means over stretches of equally many points."""
    parts = np.array_split(np.argsort(x), min(_BINS, max(1, x.size // 5)))
    return np.array([x[p].mean() for p in parts]), np.array([y[p].mean() for p in parts])


def sphere_blocks(run: ActigraphRun) -> tuple[Block, ...]:
    """The error over the sphere as a map of the runs and as a table of its parts."""
    held = run.result.final_held
    direction = run.result.fitted.corrected[:, 0]
    directions = even_directions(600)
    sd = norm_sd(run.result.final, directions) / MG
    bar = max(1.0, float(np.quantile(sd, 0.8)))
    map_ = sphere_map(
        "Attitudes seen and the error left", direction, held.error[:, 0, 0] / MG, "mg",
        "Equal areas of the map are equal parts of the sphere. One point a posture run, predicted "
        "without its block of time.",
        poor=directions[sd > bar], poor_words=f"|a| known to worse than {bar:.2g} mg (sd)",
    )  # fmt: skip
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
