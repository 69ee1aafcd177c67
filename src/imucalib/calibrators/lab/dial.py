"""What a bench's inclination dial is off by, averaged over the effects that would do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.lab.calibrate import LabResult
from imucalib.core.angle_conventions import Conventions
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.references import unit_vector
from imucalib.significant_digits import plus_minus
from imucalib.units import DEG

_NORMAL = 1.96  # of the rivals' spread


@dataclass(frozen=True)
class Dial:
    """(m,) deg: how far the true inclination is from the dial, its sd, and the 95 % half width."""

    shift: Array
    sd: Array
    half: Array


def bends(fit: Fit) -> bool:
    """Whether anything was found that turns the bench's inclination."""
    return any(name.startswith("inclination") for name in fit.model.names)


def dial_of(result: LabResult, inclination: Array) -> Dial:
    """The dial at its settings (m,) in deg, at tool-face 0, with the doubt between models.

    The mean over all models that would do, and their spread in sd and interval (Hoeting et al.
    1999, eq. 2 and 3).
    """
    conventions = result.request.conventions
    rivals = result.loop.weighed if result.loop else ()
    each = [(r.weight, dial_of_fit(r.fit, inclination, conventions)) for r in rivals]
    if len(each) < 2:
        return dial_of_fit(result.final, inclination, conventions)
    mean = sum((w * d.shift for w, d in each), np.zeros_like(inclination))
    apart = sum((w * (d.shift - mean) ** 2 for w, d in each), np.zeros_like(inclination))
    variance = sum((w * d.sd**2 for w, d in each), apart)
    half = sum((w * d.half**2 for w, d in each), _NORMAL**2 * apart)
    return Dial(mean, np.sqrt(variance), np.sqrt(half))


def dial_of_fit(fit: Fit, setting: Array, conventions: Conventions) -> Dial:
    """The same as one model has it."""
    context = fit.observations.context
    slices = fit.model.slices(context)
    m = len(setting)
    inclination, tool_face = conventions.inside(setting, np.zeros(m))
    covariates = {name: np.full(m, float(np.median(v))) for name, v in context.covariates.items()}
    covariates |= {"inclination": inclination, "tool_face": tool_face}
    covariates |= conventions.dials(setting, np.zeros(m))
    at = Context(m, covariates, context.triads, context.sweeps)
    fixture = Model(tuple(e for e in fit.model.effects if e.stage == "fixture"))
    own = fixture.slices(at)
    theta = np.zeros(len(fixture.parameters(at)))
    for name, part in own.items():
        theta[part] = fit.theta[slices[name]]
    truth = unit_vector(inclination, tool_face)[:, None]
    moved = fixture.predict(theta, truth, at)
    along = conventions.senses[0] * unit_vector(inclination + np.pi / 2.0, tool_face)
    across = np.einsum("nj,nj->n", along, moved.reading[:, 0])
    shift = np.arctan2(across, np.einsum("nj,nj->n", truth[:, 0], moved.reading[:, 0])) / DEG
    rows = np.zeros((m, fit.theta.size))
    for name, part in own.items():
        rows[:, slices[name]] = np.einsum("nj,njp->np", along, moved.d_theta[:, 0][..., part]) / DEG
    sd = np.sqrt(np.maximum(np.einsum("np,pq,nq->n", rows, fit.covariance, rows), 0.0))
    return Dial(shift, sd, fit.half_width(rows))


def dial_words(result: LabResult) -> str:
    """The dial in one sentence, or nothing when it is not off."""
    if not bends(result.final):
        return ""
    at = np.array([0.0, 50.0, 90.0])
    dial = dial_of(result, at)
    parts = [
        f"{plus_minus(float(s), float(d))} at {round(float(a))} (95 %: {s - h:.2f} to {s + h:.2f})"
        for a, s, d, h in zip(at, dial.shift, dial.sd, dial.half, strict=True)
    ]
    loop = result.loop
    wrong = [*(r.where for r in loop.records), *(f.where for f in loop.slips)] if loop else []
    kept = f"With {' and '.join(wrong)} set right, i" if wrong else "I"
    return f"{kept}nclination on this bench is the dial plus {', '.join(parts)} deg."
