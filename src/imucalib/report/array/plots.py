"""Plots of the array report: the board with its ellipses, chains, ranks, autocorrelation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.calibrators.array.run import ArrayRun
from imucalib.estimators.markov.convergence import autocorrelation
from imucalib.report.document import Plot, Series

_HALF, _MOST = 1.1774, 2.6482  # radii that hold 50 % and 97 % of a plane Gaussian


def board_plots(run: ArrayRun) -> tuple[Plot, ...]:
    """One plan view for each side of the board (or one for all), 50 and 97 % ellipses."""
    z = run.board.positions[:, 2]
    top = z >= float(np.median(z))
    sides = [("top side", top), ("underside", ~top)] if np.ptp(z) > 0 else [("board", top | True)]
    return tuple(_plan(run, name, np.flatnonzero(side)) for name, side in sides if side.any())


def _plan(run: ArrayRun, name: str, rows: NDArray[np.intp]) -> Plot:
    """Deviations are drawn to scale; ellipses that would vanish are magnified, and say so."""
    origin = 1e3 * run.board.positions[0]
    mean = 1e3 * run.final.mean[rows] + origin
    drawn = 1e3 * run.board.positions[rows]
    names = tuple(run.board.imus[k] for k in rows)
    series = [Series("drawn", drawn[:, 0], drawn[:, 1], "points", names=names)]
    if run.board.package is not None:
        half = 0.5e3 * np.array(run.board.package[:2])
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * half
        series.append(_joined("package", [d[:2] + corners for d in drawn]))
    times = _magnified(run, rows)
    for label, radius in (("50 %", _HALF), ("97 %", _MOST)):
        rings = [times * _ellipse(run, int(k), radius) + m[:2]
                 for k, m in zip(rows, mean, strict=True) if k > 0]  # fmt: skip
        if rings:
            name_of = label if times == 1.0 else f"{label}, {times:g} times as large"
            series.append(_joined(name_of, rings))
    series.append(Series("posterior mean", mean[:, 0], mean[:, 1], "points", names=names))
    caption = f"Seen from the top; {run.board.imus[0]} is the reference and stands where drawn."
    held, of = centres_held(run, rows)
    if of:
        caption += f" The 97 % ellipses hold the package's centre in {held} of {of}"
        caption += "." if held == of else (
            ": accelerometers that sit beside the middle of their package, alike in all, are "
            "beside it on the side that the reference is not on."
        )  # fmt: skip
    return Plot(f"Positions, {name}", "x (mm)", "y (mm)", tuple(series), caption, equal=True)


def centres_held(run: ArrayRun, rows: NDArray[np.intp]) -> tuple[int, int]:
    """In how many of some IMUs, the reference left out, the 97 % ellipse holds the drawn place."""
    chosen = [int(k) for k in rows if k > 0]
    held = 0
    for k in chosen:
        at = slice(3 * (k - 1), 3 * (k - 1) + 2)
        off = (run.final.mean - run.board.drawn)[k, :2]
        square = float(off @ np.linalg.solve(run.final.covariance[at, at], off))
        held += square <= _MOST**2
    return held, len(chosen)


def _magnified(run: ArrayRun, rows: NDArray[np.intp]) -> float:
    """1, or the round factor that makes the largest ellipse a tenth of the nearest spacing."""
    flat = 1e3 * run.board.positions[rows][:, :2]
    gaps = np.linalg.norm(flat[:, None] - flat, axis=2)
    spacing = float(np.min(gaps, where=gaps > 1e-6, initial=np.inf))
    largest = 1e3 * _MOST * float(run.final.sd[rows][:, :2].max())
    if not (np.isfinite(spacing) and 0.0 < largest < 0.05 * spacing):
        return 1.0
    factor = 0.1 * spacing / largest
    power = 10.0 ** np.floor(np.log10(factor))
    return float(max(m * power for m in (1.0, 2.0, 5.0) if m * power <= factor))


def close_up(run: ArrayRun) -> Plot:
    """All IMUs' deviations from the drawing in one place, to scale, with 97 % ellipses."""
    off = 1e3 * (run.final.mean - run.board.drawn)
    z = run.board.positions[:, 2]
    top = z >= float(np.median(z))
    series = []
    for label, side in (("top side", top), ("underside", ~top)):
        rows = [int(k) for k in np.flatnonzero(side) if k > 0]
        if rows:
            names = tuple(run.board.imus[k] for k in rows)
            series.append(Series(label, off[rows, 0], off[rows, 1], "points", names=names))
            rings = [_ellipse(run, k, _MOST) + off[k, :2] for k in rows]
            series.append(_joined(f"{label}, 97 %", rings))
    caption = (
        f"Accelerometers relative to {run.board.imus[0]}, each about its drawn position at 0, 0; "
        "what the sides share is where the accelerometer sits inside its package."
    )
    return Plot("Deviation in the plane of the board", "x (mm)", "y (mm)", tuple(series), caption,
                equal=True)  # fmt: skip


def _ellipse(run: ArrayRun, k: int, radius: float) -> Array:
    """(n, 2) mm around the mean of one IMU."""
    at = slice(3 * (k - 1), 3 * (k - 1) + 2)
    root = np.linalg.cholesky(run.final.covariance[at, at])
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(1e3 * radius * circle @ root.T)


def _joined(label: str, rings: list[Array]) -> Series:
    gap = np.full((1, 2), np.nan)
    line = np.concatenate([part for ring in rings for part in (ring, gap)])
    return Series(label, line[:, 0], line[:, 1], "line")


def deviation_plot(run: ArrayRun) -> Plot:
    """Deviation from the drawing of every coordinate, with 95 % intervals."""
    off, sd = 1e3 * (run.final.mean - run.board.drawn), 1e3 * run.final.sd
    x = np.arange(run.board.count, dtype=np.float64)
    series = tuple(
        Series(
            label=axis,
            x=x[1:] + 0.2 * (k - 1),
            y=off[1:, k],
            mark="bars",
            low=off[1:, k] - 1.96 * sd[1:, k],
            high=off[1:, k] + 1.96 * sd[1:, k],
            names=run.board.imus[1:],
        )
        for k, axis in enumerate("xyz")
    )
    caption = f"Position minus drawing, relative to {run.board.imus[0]}, 95 % intervals."
    return Plot("Deviation from the drawing", "IMU", "deviation (mm)", series, caption)


def chain_plots(run: ArrayRun) -> tuple[Plot, ...]:
    """Trace, ranks and autocorrelation of the coordinate that mixes worst."""
    found = run.final.convergence
    free = run.final.prior.positions
    worst = int(np.argmin(found.bulk[:free]))
    name = f"{run.board.imus[1 + worst // 3]} {'xyz'[worst % 3]}"
    draws = 1e3 * run.final.unknowns[..., worst]
    chains, n = draws.shape
    x = np.arange(n, dtype=np.float64)
    shown = range(min(chains, 4))
    trace = tuple(Series(f"chain {c + 1}", x, draws[c], "line") for c in shown)
    ranks = np.argsort(np.argsort(draws.ravel())).reshape(chains, n)
    edges = np.linspace(0, chains * n, 11)
    bins = 0.5 * (edges[1:] + edges[:-1])
    counts = tuple(
        Series(f"chain {c + 1}", bins, np.histogram(ranks[c], edges)[0].astype(float), "step")
        for c in shown
    )
    even = Series("expected", bins[[0, -1]], np.full(2, n / len(bins)), "line")
    lags = min(n - 1, 40)
    rho = autocorrelation(draws.T)[:lags]
    series = tuple(Series(f"chain {c + 1}", x[:lags], rho[:, c], "line") for c in shown)
    return (
        Plot(
            f"Trace of {name}", "draw", "position (mm)", trace, "The coordinate with the least ESS."
        ),
        Plot(
            f"Ranks of {name}",
            "rank",
            "number of draws",
            (*counts, even),
            "Flat where the chains agree.",
        ),
        Plot(
            f"Autocorrelation of {name}",
            "lag (draws)",
            "autocorrelation",
            series,
            "Falls to zero within a few draws.",
        ),
    )
