"""Errors of a worn sensor's calibration: how far the corrected norm at rest is from gravity."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.outcome import ErrorSummary, HeldOutError
from imucalib.calibration.uncertainty import force_slope
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.loop.held_out import Held, errors, fitted
from imucalib.units import MG


def mean_error(held: Held) -> float:
    """Mean absolute error of the norm over the runs, mg: the field's measure."""
    return float(np.mean(np.abs(held.error))) / MG


def raw_errors(fit: Fit) -> Held:
    """The uncorrected readings against gravity."""
    return errors(replace(fit, model=Model(()), theta=np.zeros(0)), np.zeros(0), fit.observations)


def error_summary(base: Fit, final: Fit, base_held: Held, final_held: Held) -> ErrorSummary:
    """Raw, base and final, fitted and held out; the floor is what the noise of runs alone gives."""
    raw = mean_error(raw_errors(base))
    sigma = final.noise.factor * final.observations.sigma[:, 0, 0]
    floor = float(np.mean(sigma)) * float(np.sqrt(2.0 / np.pi)) / MG
    return ErrorSummary(
        metric="mean error of |a| at rest",
        unit="mg",
        raw=raw,
        base=mean_error(fitted(base)),
        final=mean_error(fitted(final)),
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


def sphere_cells(base: Fit, final: Fit, held: Held) -> tuple[SphereCell, ...]:
    """Error over the sphere: 6 ends of axes and 8 octants between them, nearest centre wins.

    Errors are NaN where no posture was recorded; the standard deviation always exists.
    """
    ends = [(name, sign * np.eye(3)[k]) for k, name in enumerate("xyz") for sign in (1.0, -1.0)]
    cells = [(f"{'+' if c.sum() > 0 else '-'}{name}", c) for name, c in ends]
    for signs in np.ndindex(2, 2, 2):
        corner = (1.0 - 2.0 * np.array(signs)) / np.sqrt(3.0)
        text = "".join(f"{'+' if v > 0 else '-'}{a}" for v, a in zip(corner, "xyz", strict=True))
        cells.append((text, corner))
    centres = np.array([c for _, c in cells])
    known = fitted(final)
    direction = known.corrected[:, 0] / np.linalg.norm(known.corrected[:, 0], axis=1)[:, None]
    nearest = np.argmax(direction @ centres.T, axis=1)
    sd = norm_sd(final, centres) / MG
    series = [np.abs(h.error[:, 0, 0]) / MG for h in (raw_errors(base), fitted(base), known, held)]
    found = []
    for k, (name, _) in enumerate(cells):
        inside = nearest == k
        raw, before, after, out = (
            float(e[inside].mean()) if inside.any() else float("nan") for e in series
        )
        count = int(inside.sum())
        found.append(
            SphereCell(
                name=name,
                runs=count,
                raw=raw,
                base=before,
                final=after,
                held_out=out,
                sd=float(sd[k]),
            )
        )
    return tuple(found)


def norm_sd(fit: Fit, directions: Array) -> Array:
    """(n,) m/s², standard deviation of the corrected norm from the parameters alone."""
    gravity = float(np.linalg.norm(fit.observations.reference.truth(fit.eta)[0, 0]))
    slope, _ = force_slope(fit, gravity * directions[:, None])
    along = np.einsum("nj,njp->np", directions, slope)
    variance = np.einsum("np,pq,nq->n", along, fit.covariance, along)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))
