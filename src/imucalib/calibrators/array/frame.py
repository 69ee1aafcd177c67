"""The frame of triads whose common attitude no rest shows: one triad's in a fit, then the mean."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.core.effect import Action, Effect, Response, cross_matrix
from imucalib.core.fit import Fit
from imucalib.core.parameter import Parameter
from imucalib.core.truth import Truth
from imucalib.effects import named

#: What is fitted before anything is searched for.
BASE = ("bias", "scale", "accelerometer_misalignment")
_FIRST = (0, 1, 3)  # misalignments of the first triad that stand for the frame: xy, xz, yz


class _Framed(Response):
    """Misalignment of every triad, the first one's axes being the frame of all: x along its x,
    y in its x-y plane, so that no rotation of the whole set is left open."""

    def parameters(self, context: Context) -> tuple[Parameter, ...]:
        every = super().parameters(context)
        return tuple(p for k, p in enumerate(every) if k not in _FIRST)

    def act(self, theta: Array, truth: Truth, context: Context) -> Action:
        action = super().act(np.insert(theta, [0, 0, 1], 0.0), truth, context)
        return replace(action, d_theta=np.delete(action.d_theta, _FIRST, axis=3))


def framed_misalignment() -> Effect:
    """The catalogue's misalignment at the size that uncalibrated triads have."""
    plain = named("accelerometer_misalignment")
    assert isinstance(plain, Response)
    own = {f.name: getattr(plain, f.name) for f in fields(plain)}
    each = tuple(replace(p, typical=2.0, plausible=20.0) for p in plain.each)
    return _Framed(**{**own, "each": each})


def in_the_mean_frame(fit: Fit, rotations: Array) -> tuple[Array, Array]:
    """Gains (K, 3, 3) and the covariance (K, 12, K, 12) of gains and offsets at the end of the
    rests, turned so that the gains' mean rotation, in board axes, is none."""
    context, count = fit.observations.context, len(rotations)
    slices = fit.model.slices(context)
    last = context.take(np.array([context.n - 1]))
    end = replace(last, covariates={**last.covariates, "record": -np.ones(1)})
    linear = np.zeros((count, 12, fit.theta.size))
    for name in BASE[1:]:
        effect = next(e for e in fit.model.effects if e.name == name)
        part = slices[name]
        for axis in range(3):
            unit = np.broadcast_to(np.eye(3)[axis], (1, count, 3))
            columns = effect.act(np.zeros(part.stop - part.start), Truth(unit), end).d_theta[0]
            linear[:, axis:9:3, part] += columns
    for effect in fit.model.effects:
        if effect.name not in BASE[1:]:
            part, zero = slices[effect.name], Truth(np.zeros((1, count, 3)))
            columns = effect.act(np.zeros(part.stop - part.start), zero, end).d_theta[0]
            linear[:, 9:, part] += columns
    gain = np.eye(3) + (linear @ fit.theta)[:, :9].reshape(count, 3, 3)
    covariance = np.einsum("kip,pq,ljq->kilj", linear, fit.covariance, linear)
    for _ in range(3):  # the mean's antisymmetric part is its rotation only while that is small
        gain = _turned_back(gain, rotations)
    keep = _without_rotation(gain, rotations)
    whole = np.zeros((count, 12, count, 12))
    whole[:, :9, :, :9] = keep.reshape(count, 9, count, 9)
    whole[np.arange(count), 9:, np.arange(count), 9:] = np.eye(3)
    flat, size = whole.reshape(12 * count, -1), 12 * count
    covariance = flat @ covariance.reshape(size, size) @ flat.T
    return gain, covariance.reshape(count, 12, count, 12)


def _rotations(gain: Array, rotations: Array) -> tuple[Array, Array]:
    """(9 K, 3) what a small rotation of all triads about each board axis does to their gains, and
    (3, 9 K) the mean's antisymmetric part, in board axes, of gains."""
    count = len(gain)
    moved, held = np.zeros((count, 3, 3, 3)), np.zeros((3, count, 3, 3))
    for axis, cross in enumerate(cross_matrix(np.eye(3))):
        own = rotations.transpose(0, 2, 1) @ cross @ rotations
        moved[..., axis], held[axis] = gain @ own, own
    return moved.reshape(9 * count, 3), held.reshape(3, 9 * count)


def _turned_back(gain: Array, rotations: Array) -> Array:
    """The gains (K, 3, 3) with all triads turned by the rotation that their mean has."""
    from scipy.spatial.transform import Rotation

    moved, held = _rotations(gain, rotations)
    angles = np.linalg.solve(held @ moved, held @ gain.ravel())
    turn = Rotation.from_rotvec(-angles).as_matrix()
    return np.asarray(gain @ rotations.transpose(0, 2, 1) @ turn @ rotations)


def _without_rotation(gain: Array, rotations: Array) -> Array:
    """(9 K, 9 K) that takes the rotation of all triads out of small changes of their gains."""
    moved, held = _rotations(gain, rotations)
    return np.asarray(np.eye(len(moved)) - moved @ np.linalg.solve(held @ moved, held))
