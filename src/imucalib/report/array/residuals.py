"""Residuals of an array in motion before and after the search: against rate, force and time, and of
every IMU."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.cross_fit import NORMAL_MAD
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.run import ArrayRun
from imucalib.report.document import Plot, Series
from imucalib.units import DEG, MG

_BINS = 24  # of a driver, each with as many samples
_SENSORS = (("gyro", "deg/s", DEG, 1), ("accelerometer", "mg", MG, 0))


def residual_plots(run: ArrayRun) -> tuple[Plot, ...]:
    """Of gyros and accelerometers; none where nothing was searched."""
    if run.loop is None:
        return ()
    return (*_against_rate(run), *_against_others(run), *_of_each(run))


def _states(run: ArrayRun) -> tuple[tuple[str, ArrayState], ...]:
    assert run.loop is not None
    return ("before", run.loop.base), ("after", run.loop.final)


def _against_rate(run: ArrayRun) -> list[Plot]:
    assert run.loop is not None
    speed, plots = np.geomspace(*_ends(run.loop.final), 60), []
    for what, unit, size, k in _SENSORS:
        sd = np.sqrt(run.loop.final.noise[k].variance(speed).mean(axis=1)) / size
        series = [Series("noise that was fitted, 1 sd", speed / DEG, sd, "line")]
        for name, state in _states(run):
            y = _rms(state, k)
            series.append(Series(name, _speed(state) / DEG, y / size, "points"))
        plots.append(Plot(
            f"{what.capitalize()} residual against the rate", "speed of rotation (deg/s)",
            _axis(what, unit), tuple(series),
            f"One point a moving sample, rms of an axis, its own motion taken out. {_of(run)}",
            log_y=True,
        ))  # fmt: skip
    return plots


def _against_others(run: ArrayRun) -> list[Plot]:
    """Against the specific force and against time, in bins of as many samples."""
    plots = []
    for words, label in (("force", "specific force (m/s²)"), ("time", "time in the log (s)")):
        for what, unit, size, k in _SENSORS:
            series = []
            for name, state in _states(run):
                drive = _force(state) if words == "force" else _time(state)
                x, y = _binned(drive, _residual(state, k))
                series.append(Series(name, x, y / size, "points"))
            plots.append(Plot(
                f"{what.capitalize()} residual against {words}", label, _axis(what, unit),
                tuple(series), f"1.4826 MAD of a {_BINS}th of the samples, of all sensors.",
                log_y=True,
            ))  # fmt: skip
    return plots


def _of_each(run: ArrayRun) -> list[Plot]:
    """One point an IMU."""
    plots, x = [], np.arange(run.board.count, dtype=np.float64)
    for what, unit, size, k in _SENSORS:
        series = tuple(
            Series(name, x, _each(state, k) / size, "points", names=run.board.imus)
            for name, state in _states(run)
        )
        plots.append(Plot(
            f"{what.capitalize()} residual of each IMU", "IMU, in the board's order",
            _axis(what, unit), series, f"1.4826 MAD over the moving samples. {_of(run)}",
        ))  # fmt: skip
    return plots


def _of(run: ArrayRun) -> str:
    before, after = (len(state.setup.inner) for _, state in _states(run))
    return f"Before: {before} samples of the search; after: {after}."


def _axis(what: str, unit: str) -> str:
    return f"{what} residual ({unit})"


def _ends(state: ArrayState) -> tuple[float, float]:
    speed = _speed(state)
    return max(float(speed.min()), 1e-3), float(speed.max())


def _speed(state: ArrayState) -> Array:
    """(n,) rad/s."""
    return np.asarray(np.linalg.norm(state.sampled.rate, axis=1)[state.setup.inner])


def _force(state: ArrayState) -> Array:
    """(n,) m/s², the mean over the IMUs."""
    return np.asarray(np.linalg.norm(state.sampled.force, axis=2).mean(axis=1)[state.setup.inner])


def _time(state: ArrayState) -> Array:
    return np.asarray(state.setup.t[state.setup.inner])


def _residual(state: ArrayState, sensor: int) -> Array:
    """(n, K, 3) m/s² or rad/s."""
    off = state.sampled.off
    return (off.acceleration, off.rate)[sensor][state.setup.inner]


def _rms(state: ArrayState, sensor: int) -> Array:
    """(n,) over triads and axes."""
    return np.asarray(np.sqrt(np.mean(_residual(state, sensor) ** 2, axis=(1, 2))), np.float64)


def _each(state: ArrayState, sensor: int) -> Array:
    """(K,) 1.4826 MAD over samples and axes."""
    size = np.abs(_residual(state, sensor))
    return np.asarray(NORMAL_MAD * np.median(size, axis=(0, 2)), np.float64)


def _binned(x: Array, y: Array) -> tuple[Array, Array]:
    """Median of the driver (n,) and 1.4826 MAD of residuals (n, K, 3) in bins of as many."""
    parts = [p for p in np.array_split(np.argsort(x), _BINS) if p.size]
    middle = np.array([np.median(x[p]) for p in parts])
    return middle, NORMAL_MAD * np.array([np.median(np.abs(y[p])) for p in parts])
