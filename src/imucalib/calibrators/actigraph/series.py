"""Calibrations of consecutive parts of a recording, and whether they differ.

Another sensor from some moment on: all nine parameters jump, which no step of biases, of scales
or of angles does.

About nominal values |v| - g is linear in the nine parameters: Σ b_i u_i + g Σ s_ij u_i u_j with
u = v/|v|. Gram matrices that grow run by run give the best split without a fit for each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.actigraph.calibrate import base_model
from imucalib.calibrators.actigraph.observations import (
    NINE,
    base_fit,
    hours,
    is_weak,
    observations_of,
    open_words,
)
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.core.effect import Parameter, Truth
from imucalib.core.fit import Fit
from imucalib.data import Data
from imucalib.errors import ImucalError, Undetermined
from imucalib.estimators.power_ups import weigh_moved
from imucalib.posterior.odds import CERTAIN
from imucalib.rests.runs import PostureRuns, Scan
from imucalib.units import MG

_FEWEST = 20  # posture runs on either side
_SPLITS = 400  # moments that are tried at most, before the last is found among its neighbours
#: Times that it leaves less scatter than one part that steps: a drift leaves a quarter.
_CLEARER = 6.0
#: Columns of the biases, of the scales and of the angles: where one of them alone jumps, it is the
#: same sensor.
_PARTS = ([0, 1, 2], [3, 6, 8], [4, 5, 7])
#: By how much a parameter moves, of what devices differ by: 1 mg of a bias.
_SHARE = 0.02
_JUMP = 5e-3  # of a scale or an angle, below which it is the same sensor


@dataclass(frozen=True)
class Exchange:
    """time : s, middle of the two runs between which it happens; bias : (3,) m/s² and scale : (6,)
    what the parameters jump by"""

    time: float
    bias: Array
    scale: Array

    @property
    def words(self) -> str:
        bias, scale = (float(np.abs(jump).max()) for jump in (self.bias, self.scale))
        return (
            f"from {hours(self.time)} on the readings are those of another sensor: its biases "
            f"differ by up to {bias / MG:.0f} mg, "
            f"its scales and angles by up to {100 * scale:.1f} %"
        )


def exchange_in(runs: PostureRuns) -> Exchange | None:
    """The moment at which the sensor is another one, or None."""
    if runs.n < 2 * _FEWEST:
        return None
    columns, off = _linear(runs.mean)
    rows = np.arange(_FEWEST, runs.n - _FEWEST + 1, dtype=np.intp)
    coarse = rows[:: max(rows.size // _SPLITS, 1)]
    about = int(coarse[np.argmin(_remainders(columns, off, coarse))])
    fine = rows[np.abs(rows - about) <= max(rows.size // _SPLITS, 1)]
    row = int(fine[np.argmin(_remainders(columns, off, fine))])
    late = np.arange(runs.n) >= row
    stepped = (np.hstack([columns, columns[:, one] * late[:, None]]) for one in _PARTS)
    whole = min(float(np.sum(_rest(one, off) ** 2)) for one in stepped)
    both = np.hstack([columns, columns * late[:, None]])
    found, rest = np.linalg.lstsq(both, off, rcond=1e-9)[0], _rest(both, off)
    jump = np.asarray(found[9:], np.float64)
    if whole < _CLEARER * float(np.sum(rest**2)) or np.abs(jump[3:]).max() < _JUMP:
        return None
    return Exchange(float(runs.time[row - 1 : row + 1].mean()), jump[:3], jump[3:])


def _linear(mean: Array) -> tuple[Array, Array]:
    """(n, 9) columns of bias (m/s²) and of scale and angles (1), and (n,) |v| - median, m/s²."""
    size = np.linalg.norm(mean, axis=1)
    g = float(np.median(size))
    u = mean / size[:, None]
    squares = g * np.stack([u[:, i] * u[:, j] for i in range(3) for j in range(i, 3)], axis=1)
    return np.hstack([u, squares]), size - g


def _remainders(columns: Array, off: Array, rows: Index) -> Array:
    """Sum of squares that two sets of parameters leave, split before each of the rows."""
    whole = np.hstack([columns, off[:, None]])
    edges = np.concatenate([[0], rows, [len(off)]])
    part = [whole[a:b].T @ whole[a:b] for a, b in pairwise(edges)]
    before = np.cumsum(part, axis=0)
    first, second = before[:-1], before[-1] - before[:-1]
    return np.asarray(sum(_least_squares_rest(gram) for gram in (first, second)))


def _least_squares_rest(gram: Array) -> Array:
    """(m,) what least squares leaves, of (m, 10, 10) Gram matrices, the data last."""
    inner = gram[:, :9, :9]
    inner = inner + 1e-9 * np.trace(inner, axis1=1, axis2=2)[:, None, None] * np.eye(9)
    along = gram[:, :9, 9]
    return np.asarray(
        gram[:, 9, 9] - np.sum(along * np.linalg.solve(inner, along[..., None])[..., 0], 1)
    )


def _rest(columns: Array, off: Array) -> Array:
    return np.asarray(off - columns @ np.linalg.lstsq(columns, off, rcond=1e-9)[0])


@dataclass(frozen=True)
class SeriesPart:
    """One part: start and stop in s, its runs, and its fit, or why there is none."""

    start: float
    stop: float
    runs: int
    fit: Fit | None
    reason: str = ""


class MovedEffect(Data):
    """An effect whose parameters differ between parts."""

    effect: str
    probability: float


@dataclass(frozen=True)
class CalibrationSeries:
    """Parts in order, and whether one calibration serves them all.

    common : of all parts; probability : that they differ; moved : the effects that do
    """

    parts: tuple[SeriesPart, ...]
    parameters: tuple[Parameter, ...]
    common: Array
    probability: float
    moved: tuple[MovedEffect, ...]

    @property
    def differ(self) -> bool:
        return self.probability > CERTAIN


def series(
    runs: PostureRuns, scanned: Scan, request: ActigraphRequest, say: Callable[[str], None]
) -> CalibrationSeries:
    """Calibrate every `request.every` seconds with the base model; a part that cannot be is named.

    Raises Undetermined when no two parts can be calibrated.
    """
    assert request.every is not None
    edges = np.append(np.arange(0.0, scanned.stop, request.every), np.inf)
    parts = []
    for start, stop in pairwise(edges):
        own = runs.take((runs.time >= start) & (runs.time < stop))
        end = float(min(stop, scanned.stop))
        found, reason = _fit(own, scanned, request)
        parts.append(SeriesPart(float(start), end, own.n, found, reason))
        if reason:
            say(f"  {hours(float(start))} to {hours(end)}: {reason}")
    good = [part.fit for part in parts if part.fit is not None]
    if len(good) < 2:
        raise Undetermined(
            f"{len(good)} of {len(parts)} parts can be calibrated",
            where=scanned.path,
            remedy="choose longer parts with --every",
        )
    return _compare_parts(tuple(parts), good)


def undo_found(runs: PostureRuns, final: Fit, request: ActigraphRequest) -> PostureRuns:
    """The runs as they would read without the effects that the search found in the whole: these
    belong to all parts, and what is left to differ are the parameters of the base model."""
    data = final.observations
    slices, found = final.model.slices(data.context), np.zeros_like(data.reading)
    own = (*NINE, *request.declare)
    truth = Truth(final.model.correct(final.theta, data.reading, data.context))
    for effect in final.model.effects:
        if effect.name not in own:
            found += effect.act(final.theta[slices[effect.name]], truth, data.context).delta
    return replace(runs, mean=runs.mean - found[:, 0])


def _fit(runs: PostureRuns, scanned: Scan, request: ActigraphRequest) -> tuple[Fit | None, str]:
    if runs.n < 2:
        return None, "nothing at rest"
    try:
        data = observations_of(runs, scanned, request.gravity, request.blocks)
        model = base_model(request, data)
        found, _ = base_fit(model, data, runs)
    except ImucalError as error:
        return None, error.what
    if not found.converged:
        return None, "the fit did not settle"
    if is_weak(found):
        return None, f"{runs.n} postures leave open: {open_words(found)} from the data"
    return found, ""


def _compare_parts(parts: tuple[SeriesPart, ...], good: list[Fit]) -> CalibrationSeries:
    information = np.linalg.inv(np.array([fit.covariance for fit in good]))
    vector = np.array([w @ fit.theta for w, fit in zip(information, good, strict=True)])
    slices = good[0].model.slices(good[0].observations.context)
    blocks = {name: np.arange(at.start, at.stop) for name, at in slices.items()}
    typical = _SHARE * np.array([p.typical for p in good[0].parameters])
    probability, each = weigh_moved(information, vector, blocks, typical, np.arange(0))
    likely = sorted(each.items(), key=lambda one: -one[1])
    return CalibrationSeries(
        parts=parts,
        parameters=good[0].parameters,
        common=np.linalg.solve(information.sum(axis=0), vector.sum(axis=0)),
        probability=probability,
        moved=tuple(MovedEffect(*one) for one in likely if one[1] > CERTAIN),
    )


class PartValue(Data):
    """A parameter of a part."""

    name: str
    value: float
    sd: float
    unit: str


class PartFacts(Data):
    """A part of the recording, and its own calibration."""

    start_s: float
    stop_s: float
    runs: int
    reason: Annotated[str, "Why it has none; empty where it has one."]
    parameters: tuple[PartValue, ...]


class SeriesFacts(Data):
    """Recalibration over time."""

    differ: bool
    probability: Annotated[float, "That the parts differ."]
    moved: tuple[MovedEffect, ...]
    parts: tuple[PartFacts, ...]


def describe_series(found: CalibrationSeries) -> SeriesFacts:
    """What report.json tells of it."""

    def values(fit: Fit | None) -> tuple[PartValue, ...]:
        each = zip(found.parameters, fit.theta, fit.sd, strict=True) if fit else ()
        return tuple(PartValue(p.name, float(v), float(sd), p.unit) for p, v, sd in each)

    spans = "start_s=start stop_s=stop"
    return SeriesFacts.of(
        found,
        parts=tuple(PartFacts.of(p, spans, parameters=values(p.fit)) for p in found.parts),
    )
