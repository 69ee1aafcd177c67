"""Whether one axis scatters far more than the others, which the noise of a run takes for one size.

Only |a| is seen, of which a posture shows each axis by its share n_a: beside the smoothed walk a
run's residual has the variance s² (v + k n_a²) where axis a is noisier, v being what its windows
and the resolution make of one. Tails are heavy on a wrist, so that both sides of the comparison
have Student's t with four degrees of freedom (Lange, Little and Taylor 1989).
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.loop.found import Unexplained
from imucalib.loop.thresholds import AXIS_NATS
from imucalib.loop.wander.noise import Noise, natural
from imucalib.loop.wander.walk import beside

_TAILS = 4.0
#: Variance of an axis over that of the others that is tried, and s over its first guess.
_EXCESS = (3.0, 10.0, 30.0, 100.0)
_SCALES = np.geomspace(0.1, 3.0, 60)


def noisy_axis(fit: Fit, noise: Noise, known: Array) -> tuple[Unexplained, ...]:
    """The axis whose noise is the likeliest to be larger, where odds of e^10 speak for it.

    known : (n,) mg², the part of each run's variance that its windows and the resolution explain
    """
    misfit, _, seen = natural(fit)
    left = beside(noise.course, noise.walk, misfit)
    own = noise.scatter**2 + known
    plain = _likeliest(left, own)
    share = seen[:, :3] ** 2
    nats = np.array(
        [[_likeliest(left, own * (1.0 + k * share[:, a])) for k in _EXCESS] for a in range(3)]
    )
    axis, at = np.unravel_index(int(np.argmax(nats)), nats.shape)
    gain = float(nats[axis, at]) - plain
    if gain <= AXIS_NATS:
        return ()
    name = "xyz"[axis]
    words = f"noise of {name}, some {np.sqrt(1.0 + _EXCESS[at]):.1g} times that of the other axes"
    p = float(np.exp(-gain))
    return (Unexplained(words, name, "noise", p, gain, 0.0),)


def _likeliest(left: Array, variance: Array) -> float:
    """Log likelihood of residuals (n,) with these variances, at the likeliest size of all."""
    square = left**2 / variance
    each = square[:, None] / (_TAILS * _SCALES**2)
    nats = -0.5 * (_TAILS + 1.0) * np.log1p(each).sum(axis=0) - left.size * np.log(_SCALES)
    return float(nats.max()) - 0.5 * float(np.log(variance).sum())
