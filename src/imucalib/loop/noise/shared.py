"""Noise that neighbours in the order of recording share: a part of the model, not a rival.

A bias of each axis that wanders is a variance component beside the noise of a reading, with an
exponential correlation exp(-|i - j| / τ) in the order of recording. It is estimated first, and
again after every effect: what an effect explains, it no longer holds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Noise
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations, SharedNoise
from imucalib.estimators.variance import estimate_noise
from imucalib.loop.noise.axes import with_noisy_axes
from imucalib.loop.noise.component import estimated, refitted
from imucalib.loop.thresholds import SHARED_NATS, SHARED_NUMBERS, SHARED_ON_DIALS
from imucalib.units import STANDARD_GRAVITY

NAME = "shared noise"
#: What stands beside an effect that a slow walk of the bias, or of the scale, imitates.
WANDERING, WANDERING_SCALE = "wandering_bias", "wandering_scale"
#: Observations after which it forgets, as tried; beyond a sixth of all it is a drift.
_MEMORY, _LONGEST = (1.5, 4.0, 12.0), 1.0 / 6.0
_FEWEST = 12
#: Memories, in recordings, of what passes for a drift or a step, the middle one first, and nats
#: beyond which the others do not change what it says.
_SLOW, _FAR = (0.5, 0.2, 2.0), 10.0
_JITTER = 1e-9
#: Starts of the estimate: what neighbours share can stand in for the noise of a reading and for
#: settings.
_STARTS = ((1.0, 0.5), (0.4, 1.5))


def with_shared_noise(fit: Fit) -> Fit:
    """The same model, refitted under the shared noise that the data ask for, if they ask for any.

    Up to `SHARED_NUMBERS` numbers in one order, `SHARED_ON_DIALS` of a bench; otherwise the noise
    is left as it is.
    """
    own = fit.observations
    if "order" not in own.context or own.n < _FEWEST or _too_many(fit):
        return fit
    alone = with_noisy_axes(fit)
    bare = alone.observations
    longest = max(bare.n * _LONGEST, _MEMORY[0])
    tried = _tried(bare, tuple(m for m in _MEMORY if m <= longest))
    found = [(estimated(alone, data, _STARTS), data) for data in tried]
    best, data = max(found, key=lambda one: one[0].log_likelihood)
    if best.log_likelihood - alone.log_likelihood <= SHARED_NATS:
        return alone
    shared = replace(data.shared[-1], without=alone.noise.ratio)
    return refitted(alone, replace(data, shared=(*bare.shared, shared)), best.noise)


def _too_many(fit: Fit) -> bool:
    return fit.at.residual.size > (SHARED_ON_DIALS if fit.at.free else SHARED_NUMBERS)


def lead_over_a_walk(fit: Fit, nats: float) -> float:
    """Nats by which an effect, worth `nats` beside the fit, beats a bias that wanders slowly: over
    a whole recording the two can look alike."""
    if "order" not in fit.observations.context or _too_many(fit):
        return nats
    walk = fit.observations.walk
    shared = fit.observations.shared
    bare = replace(fit.observations, shared=shared[:-1] if walk else shared)
    alone = replace(fit, noise=_without(fit.noise)) if walk else fit
    memories = tuple(bare.n * share for share in _SLOW)
    slow = max(estimated(alone, data, _STARTS).log_likelihood for data in _tried(bare, memories))
    return fit.log_likelihood + nats - max(slow, fit.log_likelihood)


def imitated_by_a_scale(before: Fit, after: Fit, name: str, margin: float) -> bool:
    """Whether a scale that wanders slowly, of all axes together or of each by itself, comes within
    `margin` nats of an effect, fitted.

    The effect's restricted likelihood is of flat numbers: a prior as wide as each turned out, at
    least its typical size, makes it an evidence (MacKay 1992, Laplace's method).
    """
    own = before.observations
    if "order" not in own.context or _too_many(before):
        return False
    part = after.model.slices(own.context)[name]
    typical = np.array([p.typical for p in after.parameters[part]])
    width = np.maximum(np.abs(after.theta[part]), typical)
    effect = after.log_likelihood - float(np.sum(np.log(width) + 0.5))
    along = own.reading.mean(axis=1)[..., None] / STANDARD_GRAVITY
    for share in _SLOW:
        leads = [
            effect - estimated(before, data, _STARTS).log_likelihood
            for basis in (along, along * np.eye(3))
            for data in _tried(own, (own.n * share,), basis)
        ]
        if min(leads) < margin:
            return True
        if min(leads) > margin + _FAR:
            return False
    return False


def _without(noise: Noise) -> Noise:
    return Noise(noise.factor, noise.component[:-1], noise.sd[:-1])


def _tried(
    bare: Observations, memories: tuple[float, ...], basis: Array | None = None
) -> list[Observations]:
    position = np.argsort(np.argsort(bare.context["order"], kind="stable")).astype(float)
    apart = np.abs(position[:, None] - position)
    return [
        replace(
            bare,
            shared=(*bare.shared, SharedNoise(NAME, _root(apart, memory), memory, basis=basis)),
        )
        for memory in memories
    ]


def _root(apart: Array, memory: float) -> Array:
    values = np.exp(-apart / memory) + _JITTER * np.eye(len(apart))
    return np.asarray(np.linalg.cholesky(values), np.float64)


def shared_evidence(fit: Fit) -> float:
    """Nats that a fit's noise that neighbours share gains over none; zero where there is none."""
    if fit.observations.walk is None or fit.noise.sd[-1] == 0.0:
        return 0.0
    at = replace(fit.at, settings=fit.at.settings[:-1], component=fit.at.component[:-1])
    noise = _without(fit.noise)
    return fit.log_likelihood - estimate_noise(at, noise, fixed=False).log_likelihood
