"""What a calibration leaves open, carried into the motion that it fuses.

A calibration's error moves all samples alike, and each by its own force and rate. To first order
dx = C Jᵀ Λ dy, with C the covariance of the noise, J the derivative of a reading, Λ its weight and
dy what the error adds to it. What turns or scales the whole board moves the motion itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibrators.array.effect_blocks import covariance_of
from imucalib.calibrators.array.fused.beyond import term_of
from imucalib.calibrators.array.loop.at_rest import AT_REST
from imucalib.calibrators.array.loop.motion import BoardMotion
from imucalib.calibrators.array.loop.terms import Term
from imucalib.core.effect import cross_matrix
from imucalib.core.eigen import eigen
from imucalib.estimators.array.fusion import FusedMotion, Sensed
from imucalib.estimators.array.samples import slope_of, turning
from imucalib.units import DEG

_FLAT = 1e-12  # of the largest variance of an effect's parameters, below which it is rounding


@dataclass(frozen=True)
class Doubt:
    """places : (3 K, 3 K) m² of the positions by the calibration's motion; triads : (K, 12, 12) of
    gains (rows first) and biases (m/s²), each IMU's by itself; gravity, scale : relative sds of the
    force and of all gyros' rates; frame : (3,) rad; effects : terms with a root (p, q) of the
    covariance of their parameters"""

    places: Array
    triads: Array
    gravity: float
    scale: float
    frame: Array
    effects: tuple[tuple[Term, Array], ...]


def doubt_of(calibration: Calibration, places: Array) -> Doubt | None:
    """Of an array's calibration with positions (K, 3) m about the first IMU; None where its file
    does not say how well positions are known."""
    facts, count = calibration.facts, len(calibration.triads)
    free = 3 * (count - 1)
    if calibration.covariance.shape != (free, free) or not calibration.covariance.any():
        return None
    size, frame = facts.get("size", {}), facts.get("frame", {})
    beyond = float(size.get("sd_beyond_motion", 0.0))
    turns = np.broadcast_to(np.asarray(frame.get("sd_deg", 0.0), dtype=float), (3,)) * DEG
    own = np.zeros((3 * count, 3 * count))
    own[3:, 3:] = _by_motion(1e-6 * calibration.covariance, places[1:], beyond, turns)
    return Doubt(
        places=own,
        triads=np.array([t.covariance for t in calibration.triads]),
        gravity=float(size.get("sd_of_gravity", 0.0)),
        scale=float(facts.get("gyro_scale", {}).get("sd", 0.0)),
        frame=turns,
        effects=tuple(_effects(calibration)),
    )


def _by_motion(covariance: Array, places: Array, size: float, frame: Array) -> Array:
    """(d, d) m² less what size and frame have put into it."""
    about = np.stack([np.cross(axis, places).ravel() for axis in np.eye(3)], axis=1) * frame
    along = size * places.ravel()
    values, vectors = eigen(covariance - about @ about.T - np.outer(along, along))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _effects(calibration: Calibration) -> Iterator[tuple[Term, Array]]:
    imus = tuple(t.name for t in calibration.triads)
    for block in calibration.facts.get("effects", ()):
        term = None if str(block["effect"]).startswith(AT_REST) else term_of(block, imus)
        if term is None or term.aged:
            continue
        values, vectors = eigen(covariance_of(block))
        seen = values > _FLAT * float(values[-1])
        if seen.any():
            yield term, np.asarray(vectors[:, seen] * np.sqrt(values[seen]))


def of_the_calibration(
    doubt: Doubt, motion: FusedMotion, sensed: Sensed, r: Array, seen: BoardMotion
) -> Array:
    """(T, 9, 9) covariance of force, dω/dt and ω by what the calibration leaves open.

    motion : with the covariance of the noise, as `sensed` gives it; r : (K, 3) m; seen : the motion
    as effects take it
    """
    force, rate = _gains(motion, sensed, r)
    k = len(r)
    moved = np.matmul(force, turning(motion.rate, motion.spin)[:, None])  # by a place
    across = moved.transpose(0, 2, 1, 3).reshape(-1, 9, 3 * k)
    out = np.matmul(across @ doubt.places, across.transpose(0, 2, 1))
    own = _of_triads(doubt.triads, motion.felt(r))
    out += np.matmul(np.matmul(force, own), force.transpose(0, 1, 3, 2)).sum(axis=1)
    for term, root in doubt.effects:
        gain = rate if term.effect.channel == "angular_rate" else force
        columns = term.columns(seen)
        by = np.matmul(gain, columns.basis.swapaxes(0, 1))  # (T, K, 9, m)
        by = by.sum(axis=1, keepdims=True) if columns.shared else by
        by = by.swapaxes(1, 2).reshape(len(by), 9, -1) @ root
        out += np.matmul(by, by.swapaxes(1, 2))
    return np.asarray(out + _of_the_whole(doubt, motion, sensed))


def _gains(motion: FusedMotion, sensed: Sensed, r: Array) -> tuple[Array, Array]:
    """(T, K, 9, 3) what a reading's error does to the motion, of accelerometers and of gyros."""
    t, k = sensed.force.shape[:2]
    place = np.concatenate([np.ones((k, 1)), r], axis=1)
    slope = slope_of(motion.rate).reshape(t, 3, 4, 9).transpose(0, 1, 3, 2)
    arms = np.matmul(slope, place.T).transpose(0, 3, 2, 1)  # (T, K, 9, 3)
    whole = motion.covariance[:, None]
    force = np.matmul(whole, np.matmul(arms, sensed.force_precision))
    seen = np.zeros((t, k, 9, 3))
    seen[:, :, 6:] = sensed.rate_precision
    if sensed.late is not None:
        seen[:, :, 3:6] = np.matmul(sensed.late.swapaxes(2, 3), sensed.rate_precision)
    return force, np.asarray(np.matmul(whole, seen))


def _of_triads(covariance: Array, force: Array) -> Array:
    """(T, K, 3, 3) (m/s²)² of corrected readings, by their gains and biases."""
    t, k = force.shape[:2]
    both = np.zeros((k, 3, 4, 3, 4))
    both[:, :, :3, :, :3] = covariance[:, :9, :9].reshape(k, 3, 3, 3, 3)
    both[:, :, :3, :, 3] = covariance[:, :9, 9:].reshape(k, 3, 3, 3)
    both[:, :, 3, :, :3] = covariance[:, 9:, :9].reshape(k, 3, 3, 3)
    both[:, :, 3, :, 3] = covariance[:, 9:, 9:]
    one = np.concatenate([force, np.ones((t, k, 1))], axis=2)
    pairs = (one[..., :, None] * one[..., None, :]).reshape(t, k, 16).transpose(1, 0, 2)
    made = np.matmul(pairs, both.transpose(0, 2, 4, 1, 3).reshape(k, 16, 9))
    return np.asarray(made.transpose(1, 0, 2).reshape(t, k, 3, 3))


def _of_the_whole(doubt: Doubt, motion: FusedMotion, sensed: Sensed) -> Array:
    """(T, 9, 9) by gravity, the gyros' common scale and the frame.

    Readings (1 + k) ω have given positions 1/(1 + k)², so that forces agree, the accelerometers
    show dω/dt too large by 2 k, and neighbours' rates by k.
    """
    t = len(motion.rate)
    columns = np.zeros((t, 9, 5))
    told = np.zeros((t, 3))
    if sensed.spin_precision is not None:
        told = np.einsum("tii->ti", motion.covariance)[:, 3:6] * sensed.spin_precision
    columns[:, :3, 0] = doubt.gravity * motion.force
    columns[:, 3:6, 1] = doubt.scale * (2.0 - np.clip(told, 0.0, 1.0)) * motion.spin
    columns[:, 6:, 1] = doubt.scale * motion.rate
    for at, vector in ((0, motion.force), (3, motion.spin), (6, motion.rate)):
        columns[:, at : at + 3, 2:] = -cross_matrix(vector) * doubt.frame
    return np.asarray(np.matmul(columns, columns.transpose(0, 2, 1)))
