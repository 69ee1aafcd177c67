"""Inclination and tool-face of corrected samples or rests, with what is not known of them.

The parameters' covariance and one reading's noise are carried as in `calibration.uncertainty`, from
a calibration's file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.uncertainty import force_slopes
from imucalib.core.references import angle_slopes, angles_of
from imucalib.rests.segments import Segments
from imucalib.units import DEG, MG, STANDARD_GRAVITY

#: Rows whose derivatives are held at once.
_ROWS = 4096
#: Cosine of the inclination below which a tool-face has no meaning.
_LEAST = 0.05


@dataclass(frozen=True)
class Angles:
    """Of n samples or rests. t : (n,) s; inclination, tool_face : (n,) rad, the tool-face NaN at
    the vertical; *_sd : (n,) deg, of calibration and noise; *_calibration_sd : (n,) deg, of the
    calibration alone; norm_error : (n,) mg, |a| minus local gravity; still : (n,)"""

    t: Array
    inclination: Array
    inclination_sd: Array
    inclination_calibration_sd: Array
    tool_face: Array
    tool_face_sd: Array
    tool_face_calibration_sd: Array
    norm_error: Array
    still: Flags


def angles_at_rests(calibration: Calibration, corrected: Array, rests: Segments, k: int) -> Angles:
    """corrected : (N, 3) m/s² of triad number `k`; the mean of each rest."""
    noise = rests.noise[k] / np.sqrt(np.maximum(rests.samples[:, k], 1))[:, None]
    still = np.ones(rests.n, np.bool_)
    return _angles(calibration, rests.means(corrected, k), noise, rests.middle, still)


def angles_of_samples(
    calibration: Calibration, corrected: Array, t: Array, rests: Segments, k: int
) -> Angles:
    """corrected : (N, 3) m/s² of triad number `k` at times t (N,) s; angles hold where still."""
    still = np.zeros(t.size, np.bool_)
    for a, b in (ends for rest in rests.spans for ends in rest[k]):
        still[a:b] = True
    noise = np.broadcast_to(rests.noise[k], corrected.shape)
    return _angles(calibration, corrected, noise, t, still)


def _angles(calibration: Calibration, force: Array, noise: Array, t: Array, still: Flags) -> Angles:
    """noise : (n, 3) m/s² of the samples; what one position scatters by when it comes again is
    added, where the file tells it."""
    repeated = float(calibration.facts.get("noise", {}).get("reading_mg") or 0.0) * MG
    noise = np.hypot(repeated, noise)
    parts = [
        _uncertainty(calibration, force[a : a + _ROWS], noise[a : a + _ROWS])
        for a in range(0, len(force), _ROWS)
    ]
    own, whole = np.concatenate([np.empty((2, 2, 0)), *parts], axis=2)
    inclination, tool_face = angles_of(force)
    steep = np.cos(inclination) < _LEAST
    return Angles(
        t=t,
        inclination=inclination,
        inclination_sd=whole[0],
        inclination_calibration_sd=own[0],
        tool_face=np.where(steep, np.nan, tool_face),
        tool_face_sd=np.where(steep, np.nan, whole[1]),
        tool_face_calibration_sd=np.where(steep, np.nan, own[1]),
        norm_error=(np.linalg.norm(force, axis=1) - calibration.gravity) / MG,
        still=still,
    )


def _uncertainty(calibration: Calibration, force: Array, noise: Array) -> Array:
    """(2, 2, n) deg: by the calibration and in all; of inclination and tool-face."""
    model, theta = calibration.model()
    # Attitude alone counts: what moves is no rest.
    direction = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9)
    truth = STANDARD_GRAVITY * direction
    slope, inverse = force_slopes(model, theta, truth, calibration.context(len(force)))
    along = angle_slopes(truth) / DEG
    rows = np.einsum("anj,njp->anp", along, slope)
    own = np.einsum("anp,pq,anq->an", rows, calibration.covariance_of(model), rows)
    read = np.square(np.einsum("anj,njk->ank", along, inverse) * noise).sum(axis=-1)
    return np.sqrt(np.maximum([own, own + read], 0.0))
