"""Whether one axis scatters far more than the others, which the noise of a run takes for one size.

Only |a| is seen, of which a posture shows each axis by its share n_a: beside the smoothed walk a
run's residual has the variance s² (v + k n_a²) where axis a is noisier, v being what its windows
and the resolution make of one. Tails are heavy on a wrist, so that both sides of the comparison
have Student's t with four degrees of freedom (Lange, Little and Taylor 1989). A while in which all
scatter by another size is taken off first: its postures show one axis more than others.
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.loop.found import Unexplained
from imucalib.loop.thresholds import AXIS_NATS
from imucalib.loop.wander.left.loud import SCALES, TAILS, in_words, stretch_of
from imucalib.loop.wander.noise import Noise, natural
from imucalib.loop.wander.walk import beside

#: Variance of an axis over that of the others that is tried.
_EXCESS = (3.0, 10.0, 30.0, 100.0)


def or_noise(
    told: tuple[Unexplained, ...], fit: Fit, noise: Noise, known: Array
) -> tuple[Unexplained, ...]:
    """What was told; in place of nothing, or of a while that is another one by fewer odds, what the
    noise shows: a while in which it is larger, or an axis whose noise is, by odds of e^10.

    known : (n,) mg², the part of each run's variance that its windows and the resolution explain
    """
    if any(one.kind != "stretch" for one in told):
        return told
    misfit, _, seen = natural(fit)
    left = beside(noise.course, noise.walk, misfit)
    own, share = noise.scatter**2 + known, seen[:, :3] ** 2
    found = stretch_of(left, own)
    gain, axis, times = _noisier(left, own, share)
    if found is not None and found.nats > max(gain, *(one.evidence for one in told), 0.0):
        if loud := in_words(found, noise.course.time):
            return loud
        gain, axis, times = _noisier(left, own * found.factor, share)
    if told or gain <= AXIS_NATS:
        return told
    name = "xyz"[axis]
    words = f"noise of {name}, some {times:.1g} times that of the other axes"
    return (Unexplained(words, name, "noise", float(np.exp(-gain)), gain, 0.0),)


def _noisier(left: Array, own: Array, share: Array) -> tuple[float, int, float]:
    """Nats of the axis whose noise is the likeliest to be larger, which, and how many times."""
    nats = np.array(
        [[_likeliest(left, own * (1.0 + k * share[:, a])) for k in _EXCESS] for a in range(3)]
    )
    axis, at = np.unravel_index(int(np.argmax(nats)), nats.shape)
    gain = float(nats[axis, at]) - _likeliest(left, own)
    return gain, int(axis), float(np.sqrt(1.0 + _EXCESS[at]))


def _likeliest(left: Array, variance: Array) -> float:
    """Log likelihood of residuals (n,) with these variances, at the likeliest size of all."""
    square = left**2 / variance
    each = square[:, None] / (TAILS * SCALES**2)
    nats = -0.5 * (TAILS + 1.0) * np.log1p(each).sum(axis=0) - left.size * np.log(SCALES)
    return float(nats.max()) - 0.5 * float(np.log(variance).sum())
