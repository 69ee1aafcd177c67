"""Inclination and tool-face of corrected samples or rests, with what is not known of them.

The parameters' covariance and one reading's noise are carried through the derivatives of paper
004's formulae (1) and (2), p. 2, as in `calibration.uncertainty`, from a calibration's file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibration.calibration import Calibration
from imucalib.core.effect import Context
from imucalib.core.references import angles_of
from imucalib.rests.segments import Segments
from imucalib.units import DEG, MG, STANDARD_GRAVITY

#: Rows whose derivatives are held at once.
_ROWS = 4096
#: Cosine of the inclination below which a tool-face has no meaning.
_LEAST = 0.05


@dataclass(frozen=True)
class Angles:
    """Of n samples or rests. t : (n,) s; inclination, tool_face : (n,) rad, the tool-face NaN near
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
    spans = zip(rests.first[:, k], rests.last[:, k], strict=True)
    mean = np.array([corrected[a:b].mean(axis=0) for a, b in spans]).reshape(-1, 3)
    count = np.maximum(rests.samples[:, k], 1)[:, None]
    noise = np.hypot(_reading_noise(calibration), rests.noise[k] / np.sqrt(count))
    t = 0.5 * (rests.start + rests.stop)
    return _angles(calibration, mean, noise, t, np.ones(t.size, np.bool_))


def angles_of_samples(
    calibration: Calibration, corrected: Array, t: Array, rests: Segments, k: int
) -> Angles:
    """corrected : (N, 3) m/s² of triad number `k` at times t (N,) s; angles hold where still."""
    still = np.zeros(t.size, np.bool_)
    for a, b in zip(rests.first[:, k], rests.last[:, k], strict=True):
        still[a:b] = True
    noise = np.hypot(_reading_noise(calibration), rests.noise[k])
    return _angles(calibration, corrected, np.broadcast_to(noise, corrected.shape), t, still)


def _reading_noise(calibration: Calibration) -> float:
    """m/s², what one position scatters by when it comes again; 0 where the file does not tell."""
    return float(calibration.facts.get("noise", {}).get("reading_mg") or 0.0) * MG


def _angles(calibration: Calibration, force: Array, noise: Array, t: Array, still: Flags) -> Angles:
    parts = [
        _uncertainty(calibration, force[a : a + _ROWS], noise[a : a + _ROWS])
        for a in range(0, len(force), _ROWS)
    ]
    own_i, all_i, own_t, all_t = np.concatenate([np.empty((4, 0)), *parts], axis=1)
    inclination, tool_face = angles_of(force)
    steep = np.cos(inclination) < _LEAST
    return Angles(
        t=t,
        inclination=inclination,
        inclination_sd=all_i,
        inclination_calibration_sd=own_i,
        tool_face=np.where(steep, np.nan, tool_face),
        tool_face_sd=np.where(steep, np.nan, all_t),
        tool_face_calibration_sd=np.where(steep, np.nan, own_t),
        norm_error=(np.linalg.norm(force, axis=1) - calibration.gravity) / MG,
        still=still,
    )


def _uncertainty(calibration: Calibration, force: Array, noise: Array) -> Array:
    """(4, n) deg: inclination by the calibration and in all, tool-face likewise."""
    model, theta = calibration.model()
    covariance = calibration.covariance_of(model)
    # Attitude alone counts: what moves beside gravity is no rest.
    direction = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9)
    truth = STANDARD_GRAVITY * direction
    context = Context(len(force), calibration.usual(len(force)))
    predicted = model.predict(theta, truth[:, None], context)
    inverse = np.linalg.inv(predicted.d_truth[:, 0])
    slope = -inverse @ predicted.d_theta[:, 0]
    x, y, z = truth.T
    h = np.maximum(np.hypot(x, y), 1e-9)
    along_t = np.stack([y, -x, np.zeros_like(x)], axis=-1) / (h**2)[:, None] / DEG
    along_i = np.stack([-z * x / h, -z * y / h, h], axis=-1) / STANDARD_GRAVITY**2 / DEG
    found = []
    for along in (along_i, along_t):
        rows = np.einsum("nj,njp->np", along, slope)
        own = np.einsum("np,pq,nq->n", rows, covariance, rows)
        read = np.square(np.einsum("nj,njk->nk", along, inverse) * noise).sum(axis=1)
        found += [np.sqrt(np.maximum(own, 0.0)), np.sqrt(np.maximum(own + read, 0.0))]
    return np.array(found)
