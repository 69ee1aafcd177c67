"""Axes that are noisier than the others: a part of the noise, not wrong records or heavy tails.

The excess of an axis is a variance component of its own, one number a reading. It is estimated
first, and again after every effect, as noise that neighbours share is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations, SharedNoise
from imucalib.loop.found import Unexplained
from imucalib.loop.noise.component import estimated, refitted
from imucalib.loop.thresholds import AXIS_NATS, AXIS_NUMBERS
from imucalib.units import MG

_FEWEST = 12  # observations from which the scatter of an axis is worth a number
_NAMES = ("noise of x", "noise of y", "noise of z")
#: How far one axis may scatter beyond the quietest: by data sheets those of a chip differ by 2.
_BEYOND = 3.0
#: Numbers up to which axes are compared at all: it costs their square.
_LONGEST = 1500
_LIKELY = 1.5  # standard deviations of the score from which an estimate is worth its cost
#: Start of the estimate: share of the noise of all axes that is left to the others, and the excess.
_STARTS = ((0.6, 1.0),)


def with_noisy_axes(fit: Fit) -> Fit:
    """The same model, refitted with the excess of every axis that is noisier, if one is.

    Up to `AXIS_NUMBERS` numbers of a single triad in known directions: of a size alone no axis is
    seen. What neighbours share is taken out of the model.
    """
    own, sessions = fit.observations, fit.observations.of_sessions
    bare = replace(own, shared=sessions)
    found = fit if len(own.shared) == len(sessions) else refitted(fit, bare)
    size = fit.at.residual.size
    if size != 3 * own.n or own.n < _FEWEST or size > AXIS_NUMBERS:
        return found
    most, chosen = found.log_likelihood, None
    for axes in _likely(found):
        excess = tuple(_excess(found.observations, axis) for axis in axes)
        data = replace(found.observations, shared=(*found.observations.shared, *excess))
        one = estimated(found, data, _STARTS)
        worth = one.log_likelihood - AXIS_NATS * len(axes)
        if worth > most:
            most, chosen = worth, (data, one.noise)
    return found if chosen is None else refitted(found, *chosen)


def doubtful_axes(fit: Fit, alpha: float) -> tuple[Unexplained, ...]:
    """Axes that scatter beyond doubt more than `_BEYOND` times the quietest: a channel that is out
    of order, or a response finer than the readings are dense, scatters so alike."""
    remedy = (
        "a channel out of order, or a response finer than these readings; repeated positions tell"
    )
    return _louder(_modelled(fit) or _by_power(fit), alpha, "the quietest axis", remedy)


#: Of an axis: its name, its scatter and the quietest's (m/s²), and the degrees of freedom of both.
_Compared = tuple[str, float, float, tuple[float, float]]


def _modelled(fit: Fit) -> list[_Compared]:
    """The axes whose excess is part of the noise."""
    quiet = fit.noise.factor * float(np.median(fit.at.sigma))
    spread = np.diagonal(fit.noise_covariance)
    found = []
    for k, shared in enumerate(fit.observations.shared, fit.at.free):
        known = k + 1 < len(spread) and (spread[[0, k + 1]] > 0.0).all()
        if shared.name in _NAMES and known:
            loud = math.hypot(quiet, fit.noise.sd[k])
            dof = (0.5 / float(spread[k + 1]), 0.5 / float(spread[0]))
            found.append((shared.name[-1], loud, quiet, dof))
    return found


def _by_power(fit: Fit) -> list[_Compared]:
    """Every axis of a sheet too long for an excess of its own, by what it leaves of the noise."""
    size = fit.at.residual.size
    if size != 3 * fit.observations.n or not AXIS_NUMBERS < size <= _LONGEST:
        return []
    return _beside_the_quietest(fit, _powers(fit), tuple("xyz"))


def _beside_the_quietest(
    fit: Fit, powers: tuple[Array, Array, Array], names: tuple[str, ...]
) -> list[_Compared]:
    power, expected, spread = powers
    ratio, dof = power / expected, 2.0 * (expected / spread) ** 2
    quiet = int(np.argmin(ratio))
    sizes = fit.noise.factor * float(np.median(fit.at.sigma)) * np.sqrt(ratio)
    return [
        (name, float(sizes[a]), float(sizes[quiet]), (float(dof[a]), float(dof[quiet])))
        for a, name in enumerate(names)
        if a != quiet and ratio[quiet] > 0.0
    ]


def _louder(
    compared: Sequence[_Compared], alpha: float, quietest: str, remedy: str
) -> tuple[Unexplained, ...]:
    """Those that scatter beyond doubt more than `_BEYOND` times the quietest, by an F test."""
    from scipy.special import fdtrc

    return tuple(
        Unexplained(
            f"{name} scatters by {loud / MG:.2g} mg, {quietest} by {quiet / MG:.2g} mg: {remedy}",
            "", "noise", p, 0.0, 0.0,
        )
        for name, loud, quiet, dof in compared
        if (p := float(fdtrc(*dof, (loud / (_BEYOND * quiet)) ** 2))) < alpha
    )  # fmt: skip


def _likely(fit: Fit) -> list[tuple[int, ...]]:
    """Axes that may be noisier: each that stands out above, and both others of one below."""
    score = _beyond(fit)
    alone: list[tuple[int, ...]] = [(int(axis),) for axis in np.flatnonzero(score > _LIKELY)]
    quiet = int(np.argmin(score))
    others = tuple(axis for axis in range(3) if axis != quiet)
    return [*alone, others] if score[quiet] < -_LIKELY else alone


def _beyond(fit: Fit) -> Array:
    """(3,) how far the power of each axis lies above what the noise of all explains, in standard
    deviations: the score of its excess at none (Rao 1948)."""
    power, expected, spread = _powers(fit)
    return np.asarray((power - expected) / spread)


def _powers(fit: Fit) -> tuple[Array, Array, Array]:
    return powers_of(fit, np.tile(np.arange(3), fit.observations.n))


def powers_of(fit: Fit, part: Index) -> tuple[Array, Array, Array]:
    """The power of each part of the numbers (N,), which count from 0, what the noise of all
    explains of it, and the sd of that; (parts,) each."""
    white, q = fit.white_basis()
    inverse = white(np.eye(fit.at.residual.size))
    outside = inverse - q @ (q.T @ inverse)
    projector = inverse.T @ outside
    of = (part[:, None] == np.arange(int(part.max()) + 1)).astype(np.float64)
    power = np.square(outside.T @ white(fit.at.residual) / fit.noise.factor)
    expected = np.diagonal(projector) @ of
    spread = np.sqrt(2.0 * np.einsum("nk,nm,mk->k", of, projector**2, of, optimize=True))
    return power @ of, np.asarray(expected), np.asarray(spread)


def _excess(data: Observations, axis: int) -> SharedNoise:
    basis = np.zeros((data.n, 3, 1))
    # In proportion to what is declared of each reading.
    basis[:, axis, 0] = data.sigma[:, 0, axis] / np.median(data.sigma)
    return SharedNoise(_NAMES[axis], np.eye(data.n), math.nan, basis=basis)
