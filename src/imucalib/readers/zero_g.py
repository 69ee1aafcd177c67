"""What a converter reads at zero g: if that is no zero, gravity's sphere has its centre elsewhere.

An analogue sensor behind a converter is counted from the middle of its supply (33,000 of 65,536,
or 1.65 V of 3.3 V); no bias of an accelerometer reaches as far as gravity itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array

_FEWEST = 8
#: An offset is half of a converter's range, which is no hundred g: further off, what looks like a
#: sphere is the noise of one posture.
_FARTHEST = 50.0
#: What every direction of the sphere must hold of the readings' spread, and how far the middle one
#: of them may lie from the sphere, of its radius: scales and misalignments differ by less.
_SPREAD, _NEAR = 0.05, 0.05


@dataclass(frozen=True)
class ZeroG:
    """level : (3,) reading of each axis at zero g; radius : of the sphere, what one g reads"""

    level: Array
    radius: float

    @property
    def sentence(self) -> str:
        return (
            f"at rest the readings lie around {', '.join(f'{v:.6g}' for v in self.level)}, each "
            f"{self.radius:.4g} away: they are counted from an offset"
        )

    @property
    def option(self) -> str:
        level = ",".join(f"{v:.6g}" for v in self.level)
        return f"--unit counts --lsb {self.radius:.4g} --acc-offset {level}"


def zero_g(rest: Array) -> ZeroG | None:
    """The sphere that readings at rest (n, 3) lie on, where its centre is further from zero than
    gravity is large; None where they tell no sphere, or one about zero."""
    if len(rest) < _FEWEST or not np.ptp(rest):
        return None
    middle, scale = rest.mean(axis=0), float(rest.std())
    own = (rest - middle) / scale
    terms = np.column_stack([2.0 * own, np.ones(len(own))])
    (*shift, rest_of_it), *_ = np.linalg.lstsq(terms, (own**2).sum(axis=1))
    centre = np.array(shift)
    radius = float(np.sqrt(max(rest_of_it + centre @ centre, 0.0)))
    out = own - centre
    away = float(np.median(np.abs(np.linalg.norm(out, axis=1) - radius)))
    least = float(np.linalg.eigvalsh(np.cov(out.T))[0])
    if not radius or away > _NEAR * radius or least < _SPREAD * radius**2:
        return None
    level = middle + scale * centre
    if not 1.0 < np.linalg.norm(level) / (scale * radius) < _FARTHEST:
        return None
    return ZeroG(level, scale * radius)
