"""What a worn recording has shown of the sphere, and how far the corrected norm is from gravity."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Annotated

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.outcome import ErrorSummary, HeldOutError
from imucalib.calibration.uncertainty import force_slope
from imucalib.calibrators.actigraph.observations import quantisation
from imucalib.core.fit import Fit
from imucalib.core.sphere import even_directions
from imucalib.data import Data
from imucalib.posterior.held_out import Predictions, predict_fitted, raw_errors
from imucalib.rests.runs import PostureRuns, Scan
from imucalib.units import MG

_NEVER = 0.3  # g, an end of an axis that gravity never came closer to
_REFERENCE = 25.0  # °C


def mean_error(held: Predictions) -> float:
    """Mean absolute error of the norm over the runs, mg: the field's measure."""
    return float(np.mean(np.abs(held.error))) / MG


def error_summary(
    base: Fit, final: Fit, base_held: Predictions, final_held: Predictions
) -> ErrorSummary:
    """Raw, base and final, fitted and held out; the floor is what the noise of runs alone gives."""
    raw = mean_error(raw_errors(base))
    sigma = final.noise.factor * final.observations.sigma[:, 0, 0]
    floor = float(np.mean(sigma)) * float(np.sqrt(2.0 / np.pi)) / MG
    return ErrorSummary(
        metric="mean error of |a| at rest",
        unit="mg",
        raw=raw,
        base=mean_error(predict_fitted(base)),
        final=mean_error(predict_fitted(final)),
        floor=floor,
        held_out=HeldOutError(raw, mean_error(base_held), mean_error(final_held)),
    )


class SphereCell(Data):
    """A part of the sphere of postures: mean absolute errors of |a| in it, null without a run."""

    name: str
    runs: Annotated[int, "Posture runs in it."]
    raw_mg: float
    base_mg: Annotated[float, "Of the base model, fitted."]
    final_mg: Annotated[float, "Of the final model, fitted."]
    held_out_mg: float
    sd_mg: Annotated[float, "Of |a|, that the parameters leave."]


def sphere_cells(base: Fit, final: Fit, held: Predictions) -> tuple[SphereCell, ...]:
    """Error over the sphere: 6 ends of axes and 8 octants between them, nearest centre wins.

    Errors are NaN where no posture was recorded; the standard deviation always exists.
    """
    ends = {f"{s}{a}": float(f"{s}1") * np.eye(3)[k] for k, a in enumerate("xyz") for s in "+-"}
    octants = {
        "".join(f"{s}{a}" for s, a in zip(signs, "xyz", strict=True)): np.array(
            [float(f"{s}1") for s in signs]
        )
        / np.sqrt(3.0)
        for signs in product("+-", repeat=3)
    }
    centres = {**ends, **octants}
    where = np.array(list(centres.values()))
    known = predict_fitted(final)
    direction = known.corrected[:, 0] / np.linalg.norm(known.corrected[:, 0], axis=1)[:, None]
    nearest = np.argmax(direction @ where.T, axis=1)
    sd = norm_sd(final, where) / MG
    compared = {
        "raw_mg": raw_errors(base),
        "base_mg": predict_fitted(base),
        "final_mg": known,
        "held_out_mg": held,
    }
    series = {k: np.abs(h.error[:, 0, 0]) / MG for k, h in compared.items()}
    found = []
    for at, name in enumerate(centres):
        inside = nearest == at
        some = inside.any()
        means = {k: float(e[inside].mean()) if some else float("nan") for k, e in series.items()}
        found.append(SphereCell(name, int(inside.sum()), sd_mg=float(sd[at]), **means))
    return tuple(found)


def norm_sd(fit: Fit, directions: Array) -> Array:
    """(n,) m/s², standard deviation of the corrected norm from the parameters alone."""
    gravity = float(np.linalg.norm(fit.observations.reference.truth(fit.eta)[0, 0]))
    slope, _ = force_slope(fit, gravity * directions)
    along = np.einsum("nj,njp->np", directions, slope)
    variance = np.einsum("np,pq,nq->n", along, fit.covariance, along)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


class Coverage(Data):
    """What a recording has shown."""

    hours: float
    rate_hz: float
    window_s: Annotated[float, "Length of a window."]
    windows: int
    still_windows: Annotated[int, "Of these at rest."]
    still_hours: float
    posture_runs: int
    runs_that_count_less: Annotated[int, "That nothing else is like."]
    noise_of_a_sample_mg: Annotated[Array, "Of each axis."]
    resolution_mg: Annotated[Array, "Smallest step of each axis."]
    quantisation_mg: Annotated[float, "Of a posture, that the noise does not average out."]
    axis_range_g: Annotated[Mapping[str, tuple[float, float]], "Least and largest, by axis."]
    norm_sd_mean_mg: Annotated[float, "Of the corrected |a|, over all directions."]
    norm_sd_largest_mg: float
    never: Annotated[tuple[str, ...], "Ends of axes that gravity never came close to."]
    temperature_degC: Annotated[tuple[float, float] | None, "Least and largest."] = None  # noqa: N815
    temperature_reference_degC: float | None = None  # noqa: N815


def coverage_of(
    runs: PostureRuns,
    scanned: Scan,
    final: Fit,
    *,
    gravity: float,
    window: float,
    downweighted: int,
) -> Coverage:
    """What was recorded, and how well |a| is known by it. gravity : m/s²; window : s"""
    sd = norm_sd(final, even_directions()) / MG
    warm = runs.temperature[np.isfinite(runs.temperature)]
    own = runs.mean / np.median(np.linalg.norm(runs.mean, axis=1))
    span = np.array([runs.mean.min(axis=0), runs.mean.max(axis=0)]) / gravity
    return Coverage(
        hours=scanned.stop / 3600.0,
        rate_hz=scanned.rate,
        window_s=window,
        windows=runs.total,
        still_windows=runs.still,
        still_hours=runs.still * window / 3600.0,
        posture_runs=runs.n,
        runs_that_count_less=downweighted,
        noise_of_a_sample_mg=runs.noise / MG,
        resolution_mg=runs.resolution / MG,
        quantisation_mg=quantisation(runs) / MG,
        axis_range_g={
            a: (float(low), float(high)) for a, (low, high) in zip("xyz", span.T, strict=True)
        },
        norm_sd_mean_mg=float(sd.mean()),
        norm_sd_largest_mg=float(sd.max()),
        never=tuple(
            f"{axis} {word}"
            for k, axis in enumerate("xyz")
            for sign, word in ((1.0, "up"), (-1.0, "down"))
            if (sign * own[:, k]).max() < _NEVER
        ),
        temperature_degC=(float(warm.min()), float(warm.max())) if warm.size else None,
        temperature_reference_degC=_REFERENCE if warm.size else None,
    )
