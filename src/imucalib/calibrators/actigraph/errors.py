"""What a worn recording has shown of the sphere, and how far the corrected norm is from gravity."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.outcome import ErrorSummary, HeldOutError
from imucalib.calibration.plain import fields
from imucalib.calibration.uncertainty import force_slope
from imucalib.calibrators.actigraph.observations import quantisation
from imucalib.core.fit import Fit
from imucalib.core.sphere import even_directions
from imucalib.loop.held_out import Predictions, predict_fitted, raw_errors
from imucalib.rests.runs import PostureRuns, Scan
from imucalib.units import MG

_NEVER = 0.3  # g, an end of an axis that gravity never came closer to


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


@dataclass(frozen=True)
class SphereCell:
    """A part of the sphere of postures: its name, runs in it, mean absolute errors (mg) raw, with
    the base and the final model, and the standard deviation (mg) of |a| that the parameters leave.
    """

    name: str
    runs: int
    raw: float
    base: float
    final: float
    held_out: float
    sd: float


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
        "raw": raw_errors(base),
        "base": predict_fitted(base),
        "final": known,
        "held_out": held,
    }
    series = {k: np.abs(h.error[:, 0, 0]) / MG for k, h in compared.items()}
    found = []
    for at, name in enumerate(centres):
        inside = nearest == at
        some = inside.any()
        means = {k: float(e[inside].mean()) if some else float("nan") for k, e in series.items()}
        found.append(SphereCell(name, int(inside.sum()), sd=float(sd[at]), **means))
    return tuple(found)


def norm_sd(fit: Fit, directions: Array) -> Array:
    """(n,) m/s², standard deviation of the corrected norm from the parameters alone."""
    gravity = float(np.linalg.norm(fit.observations.reference.truth(fit.eta)[0, 0]))
    slope, _ = force_slope(fit, gravity * directions[:, None])
    along = np.einsum("nj,njp->np", directions, slope)
    variance = np.einsum("np,pq,nq->n", along, fit.covariance, along)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@dataclass(frozen=True)
class Coverage:
    """What a recording has shown.

    hours; rate : Hz; windows, still, runs, downweighted : windows, those at rest, posture runs, and
    those that count less; window : s; noise, resolution : (3,) mg; quantisation : mg
    span : (2, 3) least and largest reading of each axis, local g; temperature : °C, or None
    mean_sd, worst_sd : mg, of the corrected |a| over all directions
    unseen : ends of the axes that gravity never came close to, in words
    """

    hours: float
    rate: float
    windows: int
    still: int
    runs: int
    downweighted: int
    window: float
    noise: Array
    resolution: Array
    quantisation: float
    span: Array
    mean_sd: float
    worst_sd: float
    temperature: tuple[float, float] | None
    unseen: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """The block of calibration.yaml and report.json."""
        block = {
            **fields(self, "hours rate_hz=rate windows still_windows=still"),
            "still_hours": self.still * self.window / 3600.0,
            **fields(
                self,
                "posture_runs=runs runs_that_count_less=downweighted noise_of_a_sample_mg=noise "
                "resolution_mg=resolution quantisation_mg=quantisation",
            ),
            "axis_range_g": {a: self.span[:, k].tolist() for k, a in enumerate("xyz")},
            **fields(self, "norm_sd_mean_mg=mean_sd norm_sd_largest_mg=worst_sd"),
        }
        if self.temperature is not None:
            block["temperature_degC"] = list(self.temperature)
            block["temperature_reference_degC"] = 25.0
        return block


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
    return Coverage(
        hours=scanned.stop / 3600.0,
        rate=scanned.rate,
        windows=runs.total,
        still=runs.still,
        runs=runs.n,
        downweighted=downweighted,
        window=window,
        noise=runs.noise / MG,
        resolution=runs.resolution / MG,
        quantisation=quantisation(runs) / MG,
        span=np.array([runs.mean.min(axis=0), runs.mean.max(axis=0)]) / gravity,
        mean_sd=float(sd.mean()),
        worst_sd=float(sd.max()),
        temperature=(float(warm.min()), float(warm.max())) if warm.size else None,
        unseen=tuple(
            f"{axis} {word}"
            for k, axis in enumerate("xyz")
            for sign, word in ((1.0, "up"), (-1.0, "down"))
            if (sign * own[:, k]).max() < _NEVER
        ),
    )
