"""How a gyroscope is set up beside its accelerometer: units, axes and signs as hypotheses that
gravity weighs.

Between two rests gravity turns by the integral of the rate, u(k+1) = R' u(k). Of a rotation P,
R(Pω) = P R(ω) P', so that two integrations a unit, of ω and of -ω, serve all 48 mappings of axes.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from imucalib.arrays import Array
from imucalib.units import DEG

#: (48, 3, 3) every signed permutation of three axes, the identity first.
SIGNED: Array = np.array(
    [
        np.eye(3)[list(order)] * np.array(sign)[:, None]
        for order, sign in product(permutations(range(3)), product((1.0, -1.0), repeat=3))
    ]
)
#: Determinants of these, and the rotation that each is, or is beside an inversion.
_HAND: Array = np.rint(np.linalg.det(SIGNED))
_PURE: Array = _HAND[:, None, None] * SIGNED
#: rad by which plain gains carry gravity past where it is.
_OFF = 2.0 * DEG
#: Prior chance of what is stated, of a unit and of axes; where nobody states a unit, all are alike.
_STATED = 0.95
#: What is proven: all the rest together has no larger a share.
DOUBT = 1e-3


def misfits(before: Array, after: Array, turned: Array) -> Array:
    """(m, k, 48) rad between gravity carried over m turns, by rates in each of k units and in axes
    of each of `SIGNED`, and gravity that is read after them.

    before, after : (m, 3) unit vectors; turned : (m, k, 2, 3, 3) rotations R of ω and of -ω
    """
    pure = np.einsum("pji,mj->mpi", _PURE, before)
    back = turned[:, :, (_HAND < 0.0).astype(int)]
    carried = np.einsum("pij,mupkj,mpk->mupi", _PURE, back, pure)
    dot = np.einsum("mupi,mi->mup", carried, after)
    across = np.linalg.norm(np.cross(carried, after[:, None, None]), axis=-1)
    return np.asarray(np.arctan2(across, dot))


def weigh(off: Array, *, stated: bool = True) -> Array:
    """(k, 48) probability of each unit with each axes, by misfits (m, k, 48).

    stated : whether the first unit is what somebody states. A turn may be spoiled by what nobody
    knows, so errors have the tails of Student's t with two degrees of freedom
    """
    _, units, axes = off.shape
    prior = np.full((units, axes), (1.0 - _STATED) / (axes - 1))
    prior[:, 0] = _STATED
    if stated and units > 1:
        prior[0] *= _STATED
        prior[1:] *= (1.0 - _STATED) / (units - 1)
    score = np.log(prior) - 1.5 * np.log1p((off / _OFF) ** 2).sum(axis=0)
    chance = np.exp(score - score.max())
    return np.asarray(chance / chance.sum())


def axes_in_words(signed: Array) -> str:
    """A signed permutation as mappings and board files write it: "x,-y,z"."""
    at = np.argmax(np.abs(signed), axis=1)
    return ",".join(("-" if signed[i, k] < 0 else "") + "xyz"[k] for i, k in enumerate(at))
