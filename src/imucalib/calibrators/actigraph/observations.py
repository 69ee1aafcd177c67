"""From posture runs to observations: noise, covariates, held-out blocks of time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.context import Context
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.effects.history.previous import covariates_before
from imucalib.effects.thermal import rate
from imucalib.rests.runs import PostureRuns, Scan
from imucalib.rests.thermal import REMEMBERED, history_of, remembered, tells_apart
from imucalib.rests.windows import Windows
from imucalib.units import MG

_DAY = 86400.0
_LEAST_WARMTH = 1.0  # °C: less variation than this cannot show what temperature does
_HEAVY = 4.0  # standard deviations beyond which a run counts less
_LARGEST = 1.0 / 3.0  # share of the runs that a held-out block of time has at most
_MEDIAN_SQUARE = 0.4549  # of a standard normal number


def observations_of(
    runs: PostureRuns, scanned: Scan, gravity: float, blocks: int = 12
) -> Observations:
    """One observation a run, in order of time; sigma as if runs differed by 1 mg beside noise.

    blocks : contiguous stretches, see `_blocks`; each run's block is its held-out group
    """
    n = runs.n
    context = Context(n, covariates_of(runs, scanned))
    group = _blocks(runs.time, blocks)
    label = tuple(f"run at {hours(t)}" for t in runs.time)
    sigma = _sigma(MG, runs)
    return Observations(runs.mean[:, None], sigma, KnownNorm(n, gravity), context, group, label)


def _blocks(time: Array, blocks: int) -> Index:
    """(n,) the stretch of each run, of equal time; of equally many runs where one would hold a
    third of all: two hours on the wrist before days in a drawer would be held out together, and
    nothing be left to predict them from."""
    edges = np.linspace(time[0], time[-1], blocks + 1)[1:-1]
    group = np.searchsorted(edges, time, side="right").astype(np.intp)
    if time.size >= 2 * blocks and np.bincount(group).max() > _LARGEST * time.size:
        group = (np.arange(time.size) * blocks // time.size).astype(np.intp)
    return group


def hours(time: float) -> str:
    """Seconds as days, hours and minutes: "2 d 03:07"."""
    minutes = round(time / 60.0)
    return f"{minutes // 1440} d {minutes // 60 % 24:02d}:{minutes % 60:02d}"


def covariates_of(runs: PostureRuns, scanned: Scan) -> dict[str, Array]:
    """What the effects may depend on. Temperature only where it varies."""
    span = max(scanned.stop, 1.0)
    found = {
        "record": np.arange(runs.n, dtype=float),
        "time": runs.time,
        "order": runs.time / span,
        **covariates_before(runs.mean),
    }
    if span > 1.5 * _DAY:
        start = (scanned.start_ns or 0) / 1e9 % _DAY
        found["time_of_day"] = 2.0 * np.pi * ((runs.time + start) / _DAY % 1.0)
    warm = scanned.temperature
    if warm is not None and np.ptp(runs.temperature) >= _LEAST_WARMTH:  # False for NaN
        found["temperature"] = runs.temperature
        history = history_of(warm)
        past = {name: remembered(history, name, runs.time) for name in REMEMBERED}
        found |= {n: v for n, v in past.items() if _is_shown(n, v, runs.temperature, warm)}
    return found


def _is_shown(name: str, past: Array, now: Array, warm: Windows) -> bool:
    """Whether a thermometer shows a past temperature beside the present one: rounded to some °C it
    does not, and what a lag smooths is then its steps. A rate (°C/h) is shown by them too."""
    return name.startswith(rate.PREFIX) or tells_apart(warm, past, now)


def with_temperature(data: Observations, runs: PostureRuns) -> Observations:
    """With the runs' temperature, also where it varies too little to show what it does."""
    if not np.isfinite(runs.temperature).all():
        return data
    known = {**data.context.covariates, "temperature": runs.temperature}
    return replace(data, context=replace(data.context, covariates=known))


def quantisation(runs: PostureRuns) -> float:
    """m/s², what the resolution adds to a posture's error where the noise does not average it out.

    Noise of half a step and more moves every sample to either side. Below that all samples of a
    posture share one rounding error, which is uniform over a step: step / √12.
    """
    step = np.where(runs.noise < 0.5 * runs.resolution, runs.resolution, 0.0)
    return float(np.sqrt(np.mean(step**2) / 12.0))


def _sigma(between: float, runs: PostureRuns) -> Array:
    size = np.sqrt(between**2 + quantisation(runs) ** 2 + runs.window_noise**2 / runs.windows)
    return np.asarray(np.broadcast_to(size[:, None, None], (runs.n, 1, 3)).copy())


def weighted(fit: Fit, runs: PostureRuns) -> tuple[Observations, int]:
    """The same observations with the scatter between runs as the fit's residual shows it.

    A run's variance is between² + quantisation² + window noise² / windows; `between` makes the
    median square of the residual what it should be. A run beyond 4 standard deviations counts as
    one at 4 (Huber's weight). Returns the observations and how many runs count less.
    """
    misfit = fit.at.residual * fit.at.sigma[:, 0]
    noise = quantisation(runs) ** 2 + runs.window_noise**2 / runs.windows

    def ratio(between: float) -> float:
        return float(np.median(misfit**2 / (between**2 + noise))) / _MEDIAN_SQUARE

    low, high = 1e-3 * MG, 1e3 * MG
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if ratio(middle) > 1.0 else (low, middle)
    sigma = _sigma(high, runs)
    far = np.abs(misfit) / sigma[:, 0, 0] / np.sqrt(max(ratio(high), 1e-12)) / _HEAVY
    sigma *= np.maximum(far, 1.0)[:, None, None]
    return replace(fit.observations, sigma=sigma), int((far > 1.0).sum())
