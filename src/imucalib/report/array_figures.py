"""Figures of an array: the board with its ellipses, residuals, how precision grows, chains."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.motion.closed_loop import NORMAL_MAD
from imucalib.calibrators.array.motion.covariance import sd_of_few
from imucalib.calibrators.array.motion.state import ArrayState
from imucalib.calibrators.array.run import ArrayRun
from imucalib.report.render.document import Plot, Series
from imucalib.units import DEG, MG

_MOST = 2.6482  # radius that holds 97 % of a plane Gaussian
_BINS = 24  # of what residuals may follow, each with as many samples
_SENSORS = (("gyro", "deg/s", DEG, 1), ("accelerometer", "mg", MG, 0))
_SHARES = (0.02, 0.05, 0.1, 0.2, 0.4, 1.0)
_FEWEST = 10  # samples below which a part is not shown
_AXES, _ORDER = ("x (mm)", "y (mm)"), "IMU, in the board's order"


def board_plots(run: ArrayRun) -> tuple[Plot, ...]:
    """Deviations from the drawing, and what more samples bring."""
    return (_deviations(run), *_growth(run))


def _sides(run: ArrayRun) -> dict[str, Index]:
    """Which IMUs are on each side of the board."""
    z = run.board.positions[:, 2]
    top = z >= float(np.median(z))
    sides = {"top side": top, "underside": ~top} if np.ptp(z) > 0 else {"board": top | True}
    return {name: np.flatnonzero(side) for name, side in sides.items() if side.any()}


def board_picture(run: ArrayRun) -> Plot:
    """The board as drawn, and where its accelerometers were found, with 97 % ellipses. Deviations
    are drawn to scale; ellipses that would vanish are magnified, and say so."""
    origin, drawn = 1e3 * run.board.positions[0], 1e3 * run.board.positions
    mean, sides = 1e3 * run.total.mean + origin, _sides(run)
    series = [Series("drawn", drawn[:, 0], drawn[:, 1], "points", names=tuple(run.board.imus))]
    if run.board.package is not None:
        half = 0.5e3 * np.array(run.board.package[:2])
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * half
        series.append(_join("package", [d[:2] + corners for d in drawn]))
    times = min(_magnification(run, rows) for rows in sides.values())
    larger = "" if times == 1.0 else f", {times:g} times as large"
    caption = f"Seen from the top, in mm; {run.board.imus[0]} is the reference and stands where "
    caption += f"drawn. Places are to scale; ellipses hold 97 %{larger}."
    for side, rows in sides.items():
        names, on = tuple(run.board.imus[k] for k in rows), "" if side == "board" else f", {side}"
        series.append(
            Series(f"found{on}", mean[rows, 0], mean[rows, 1], "points", names=names),
        )
        if rings := [times * _ellipse(run, int(k), _MOST) + mean[k, :2] for k in rows if k > 0]:
            series.append(_join(f"97 %{on}", rings))
        held = centres_held(run, rows)
        if held:
            caption += f" They hold the package's centre in {sum(held)} of {len(held)}{on}."
    return Plot("The board, drawn and found", *_AXES, tuple(series), caption, equal=True)


def centres_held(run: ArrayRun, rows: Index) -> list[bool]:
    """Of some IMUs, but for the reference, whether the 97 % ellipse holds the drawn place."""
    held = []
    for k in (int(k) for k in rows if k > 0):
        at = slice(3 * (k - 1), 3 * (k - 1) + 2)
        off = (run.total.mean - run.board.drawn)[k, :2]
        square = float(off @ np.linalg.solve(run.total.covariance[at, at], off))
        held.append(square <= _MOST**2)
    return held


def _magnification(run: ArrayRun, rows: Index) -> float:
    """1, or the round factor that makes the largest ellipse a tenth of the smallest spacing."""
    flat = 1e3 * run.board.positions[rows][:, :2]
    gaps = np.linalg.norm(flat[:, None] - flat, axis=2)
    spacing = float(np.min(gaps, where=gaps > 1e-6, initial=np.inf))
    largest = 1e3 * _MOST * float(run.total.sd[rows][:, :2].max())
    if not (np.isfinite(spacing) and 0.0 < largest < 0.05 * spacing):
        return 1.0
    factor = 0.1 * spacing / largest
    power = 10.0 ** np.floor(np.log10(factor))
    return float(max(m * power for m in (1.0, 2.0, 5.0) if m * power <= factor))


def _ellipse(run: ArrayRun, k: int, radius: float) -> Array:
    """(n, 2) mm around the mean of one IMU."""
    at = slice(3 * (k - 1), 3 * (k - 1) + 2)
    root = np.linalg.cholesky(run.total.covariance[at, at])
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(1e3 * radius * circle @ root.T)


def _join(label: str, rings: list[Array]) -> Series:
    gap = np.full((1, 2), np.nan)
    line = np.concatenate([part for ring in rings for part in (ring, gap)])
    return Series(label, line[:, 0], line[:, 1], "line")


def _deviations(run: ArrayRun) -> Plot:
    """Deviation from the drawing of every coordinate, with 95 % intervals."""
    off, half = 1e3 * (run.total.mean - run.board.drawn)[1:], 1.96e3 * run.total.sd[1:]
    x = np.arange(1.0, run.board.count)
    series = tuple(
        Series.from_half(
            axis, x + 0.15 * (k - 1), off[:, k], half[:, k], "points", run.board.imus[1:]
        )
        for k, axis in enumerate("xyz")
    )
    caption = f"Position minus drawing, relative to {run.board.imus[0]}, 95 % intervals."
    return Plot("Deviation from the drawing", _ORDER, "deviation (mm)", series, caption)


def _growth(run: ArrayRun) -> tuple[Plot, ...]:
    """Median standard deviation of each axis against the number of samples, as Table II of paper
    001 has it; empty where there are few."""
    state = run.state
    counts = [round(s * len(state.setup.inner)) for s in _SHARES]
    found = [(n, sd_of_few(state, n)) for n in counts if n >= _FEWEST]
    if len(found) < 3:
        return ()
    n = np.array([f[0] for f in found], np.float64)
    sd = 1e3 * np.array([f[1] for f in found])
    # The stated uncertainty holds more than the motion's: the curve ends at what is stated.
    sd *= 1e3 * np.median(run.total.sd[1:], axis=0) / sd[-1]
    series = [Series(axis, n, sd[:, k], "points") for k, axis in enumerate("xyz")]
    fine = np.geomspace(n[0], n[-1], 60)
    series.append(Series("1/√T", fine, sd[-1].mean() * np.sqrt(n[-1] / fine), "line"))
    caption = (
        "Median over the IMUs, by the curvature of the fit over evenly chosen parts of the "
        "samples, scaled to end at what is stated. Twice the precision takes four times the motion."
    )
    title = "Standard deviation against the samples used"
    return (Plot(title, "samples used", "sd (mm)", tuple(series), caption, log_y=True),)


def residual_plots(run: ArrayRun) -> list[Plot]:
    """Of gyros and accelerometers in motion before and after the search: against rate, force and
    time, and of every IMU; none where nothing was searched."""
    if run.loop is None:
        return []
    base, final = run.loop.base, run.loop.final
    before, after = len(base.setup.inner), len(final.setup.inner)
    used = f"Before: {before} samples of the search; after: {after}."
    binned = f"1.4826 MAD of a {_BINS}th of the samples, of all sensors."
    each = f"1.4826 MAD over the moving samples. {used}"
    order = np.arange(run.board.count, dtype=np.float64)
    kinds: tuple[tuple[str, Callable[[ArrayState], Array] | None, str, str], ...] = (
        ("against the rate", lambda s: _speed(s) / DEG, "speed of rotation (deg/s)", binned),
        ("against force", _force, "specific force (m/s²)", binned),
        ("against time", lambda s: s.setup.t[s.setup.inner], "time in the log (s)", binned),
        ("of each IMU", None, _ORDER, each),
    )
    plots = []
    for against, follow, x_label, caption in kinds:
        for what, unit, size, k in _SENSORS:
            series = [_noise(final, k, size)] if against.endswith("the rate") else []
            for name, state in (("before", base), ("after", final)):
                off = state.sampled.off[k][state.setup.inner]
                if follow is not None:
                    series.append(Series(name, *_bin(follow(state), off, size), "points"))
                    continue
                mad = NORMAL_MAD * np.median(np.abs(off), axis=(0, 2)) / size
                series.append(Series(name, order, mad, "points", names=run.board.imus))
            title, y_label = f"{what.capitalize()} residual {against}", f"{what} residual ({unit})"
            log = follow is not None
            plots.append(Plot(title, x_label, y_label, tuple(series), caption, log_y=log))
    return plots


def _noise(state: ArrayState, sensor: int, size: float) -> Series:
    """What 1.4826 MAD of the fitted noise is, over the speeds of the motion."""
    from scipy.special import stdtrit

    noise, ends = state.noise[sensor], _speed(state)
    speed = np.geomspace(max(float(ends.min()), 1e-3), float(ends.max()), 60)
    sd = np.sqrt(noise.variance(speed).mean(axis=1)) / size
    sd *= NORMAL_MAD * float(stdtrit(min(noise.freedom, 1e9), 0.75))
    return Series("noise that was fitted", speed / DEG, sd, "line")


def _speed(state: ArrayState) -> Array:
    """(n,) rad/s."""
    return np.asarray(np.linalg.norm(state.sampled.rate, axis=1)[state.setup.inner])


def _force(state: ArrayState) -> Array:
    """(n,) m/s², of all accelerometers."""
    force = np.linalg.norm(state.sampled.force, axis=2).mean(axis=1)
    return np.asarray(force[state.setup.inner])


def _bin(x: Array, off: Array, size: float) -> tuple[Array, Array]:
    """Median of x (n,) and 1.4826 MAD of residuals (n, K, 3) over a size, in bins of as many."""
    parts = [p for p in np.array_split(np.argsort(x), _BINS) if p.size]
    middle = np.array([np.median(x[p]) for p in parts])
    return middle, NORMAL_MAD * np.array([np.median(np.abs(off[p])) for p in parts]) / size
