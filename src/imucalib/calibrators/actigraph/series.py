"""Calibrations of consecutive parts of a recording, and whether they differ."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.calibrators.actigraph.calibrate import base_model
from imucalib.calibrators.actigraph.observations import hours, observations_of
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.weak import NINE, base_fit, is_weak, open_words
from imucalib.core.fit import Fit
from imucalib.core.parameter import Parameter
from imucalib.core.truth import Truth
from imucalib.errors import ImucalError, Undetermined
from imucalib.rests.runs import PostureRuns, Scan


@dataclass(frozen=True)
class Part:
    """One part: start and stop in s, its runs, and its fit, or why there is none."""

    start: float
    stop: float
    runs: int
    fit: Fit | None
    reason: str = ""


@dataclass(frozen=True)
class Series:
    """Parts in order, and the test that one calibration serves them all.

    statistic : Σ (θ_k - θ)ᵀ C_k⁻¹ (θ_k - θ), chi-square with `dof` if nothing changed
    p : its chance; moved : the parameters that differ most, with their p after Bonferroni
    """

    parts: tuple[Part, ...]
    parameters: tuple[Parameter, ...]
    common: Array
    statistic: float
    dof: int
    p: float
    moved: tuple[tuple[str, float], ...]

    @property
    def differ(self) -> bool:
        return self.p < 0.01


def series(
    runs: PostureRuns, scanned: Scan, request: ActigraphRequest, say: Callable[[str], None]
) -> Series:
    """Calibrate every `request.every` seconds with the base model; a part that cannot be is named.

    Raises Undetermined when no two parts can be calibrated.
    """
    assert request.every is not None
    edges = np.append(np.arange(0.0, scanned.stop, request.every), np.inf)
    parts = []
    for start, stop in pairwise(edges):
        inside = np.flatnonzero((runs.time >= start) & (runs.time < stop))
        end = float(min(stop, scanned.stop))
        found, reason = _fit(_subset(runs, inside), scanned, request)
        parts.append(Part(float(start), end, inside.size, found, reason))
        if reason:
            say(f"  {hours(float(start))} to {hours(end)}: {reason}")
    good = [part.fit for part in parts if part.fit is not None]
    if len(good) < 2:
        raise Undetermined(
            f"{len(good)} of {len(parts)} parts can be calibrated",
            where=scanned.path,
            remedy="choose longer parts with --every",
        )
    return _tested(tuple(parts), good)


def without_found(runs: PostureRuns, final: Fit, request: ActigraphRequest) -> PostureRuns:
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


def _subset(runs: PostureRuns, rows: NDArray[np.intp]) -> PostureRuns:
    return replace(
        runs,
        mean=runs.mean[rows],
        windows=runs.windows[rows],
        time=runs.time[rows],
        temperature=runs.temperature[rows],
    )


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


def _tested(parts: tuple[Part, ...], good: list[Fit]) -> Series:
    from scipy.special import chdtrc, ndtr

    information = [np.linalg.inv(fit.covariance) for fit in good]
    total = np.linalg.inv(np.sum(information, axis=0))
    weighted = np.sum([w @ f.theta for w, f in zip(information, good, strict=True)], axis=0)
    common = total @ weighted
    away = [fit.theta - common for fit in good]
    statistic = float(sum(d @ w @ d for d, w in zip(away, information, strict=True)))
    dof = common.size * (len(good) - 1)
    # The common value shares each part's data: what is left of its variance is the difference.
    spread = [np.sqrt(np.diag(fit.covariance) - np.diag(total)) for fit in good]
    z = np.array(away) / np.array(spread)
    worst = np.abs(z).max(axis=0)
    chance = np.minimum(1.0, 2.0 * ndtr(-worst) * z.size)
    order = [k for k in np.argsort(chance) if chance[k] < 0.01]
    parameters = good[0].parameters
    moved = tuple((parameters[k].name, float(chance[k])) for k in order)
    return Series(
        parts=parts,
        parameters=parameters,
        common=np.asarray(common),
        statistic=statistic,
        dof=dof,
        p=float(chdtrc(dof, statistic)),
        moved=moved,
    )


def series_block(found: Series) -> dict[str, Any]:
    """Plain types, ready for JSON."""
    return {
        "differ": found.differ,
        "p_value": found.p,
        "chi2": found.statistic,
        "dof": found.dof,
        "moved": [{"parameter": n, "p_value": p} for n, p in found.moved],
        "parts": [
            {
                "start_s": p.start,
                "stop_s": p.stop,
                "runs": p.runs,
                "reason": p.reason,
                "parameters": [
                    {"name": q.name, "value": float(v), "sd": float(s), "unit": q.unit}
                    for q, v, s in zip(found.parameters, p.fit.theta, p.fit.sd, strict=True)
                ]
                if p.fit is not None
                else [],
            }
            for p in found.parts
        ],
    }
