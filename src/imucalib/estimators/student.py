"""Student's t distribution, for whole degrees of freedom: intervals of differences need no more.

Scipy's, exact too, costs an import that is a tenth of a day's calibration.
"""

from __future__ import annotations

import math

import numpy as np

#: Halvings of an angle of 90 deg: a double has no more.
_HALVINGS = 60


def quantile(freedom: int, probability: float) -> float:
    """t below which a variable with `freedom` degrees of freedom is with a probability from a half
    up to one.

    With t = √ν tan φ the chance of |t| is a finite sum over cosines of φ, which grows with φ
    (Abramowitz and Stegun 1964, 26.7.3 and 26.7.4); it is solved by halving.
    """
    wanted, low, high = 2.0 * probability - 1.0, 0.0, 0.5 * math.pi
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _inside(freedom, middle) < wanted:
            low = middle
        else:
            high = middle
    return math.sqrt(freedom) * math.tan(0.5 * (low + high))


def _inside(freedom: int, angle: float) -> float:
    """The chance of |t| < √ν tan φ."""
    odd = freedom % 2
    first = (2.0 / math.pi) * (angle if odd else 0.0)
    count = (freedom - odd) // 2
    if not count:
        return first
    # Terms sin cos (1, 2/3 cos², 2·4/(3·5) cos⁴ ...), or sin (1, 1/2 cos², 1·3/(2·4) cos⁴ ...).
    k = np.arange(1, count)
    ratio = (2.0 * k if odd else 2.0 * k - 1.0) / (2.0 * k + 1.0 if odd else 2.0 * k)
    total = 1.0 + float(np.cumprod(ratio * math.cos(angle) ** 2).sum())
    factor = (2.0 / math.pi) * math.cos(angle) if odd else 1.0
    return first + factor * math.sin(angle) * total
