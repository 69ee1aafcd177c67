"""Axes of an array's sensors against each other: signed permutations, told by what all share.

Sensors of one rigid board see one gravity at rest and one angular rate in motion. Where a sensor's
axes are not as drawn, one of the 48 signed permutations of them brings it back to the others.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from imucalib.arrays import Array, Index

#: (48, 3, 3); the first is the identity.
SIGNED = np.array(
    [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
)
_ALIKE = 0.9  # agreement that the right permutation reaches
_APART = 0.02  # by which the axes as drawn must miss perfect agreement
_CLEARER = 20.0  # times as far from perfect agreement as the right permutation
_TURNED = np.cos(np.radians(10.0))  # of two rests' directions, below which they differ
_TURNS = 4  # from rest to rest that show how the gyros turn
_FITS, _MISSES, _NEAR = 0.25, 4.0, 0.02  # rad, ratio, rad: what the right axes miss, and others


def relative_axes(seen: Array, rotations: Array) -> Array:
    """(K, 3, 3) S of each sensor: `rotation S reading` agrees with what most others see.

    seen : (n, K, 3) rotation · reading, in board axes; rotations : (K, 3, 3) package to board.
    S is the identity where the axes are as drawn, or where these vectors cannot tell.
    """
    size = np.maximum(np.sqrt(np.sum(seen**2, axis=(0, 2))), 1e-300)
    each = (
        np.einsum("nja,nkb->jkab", seen, seen, optimize=True)
        / np.outer(size, size)[..., None, None]
    )
    turned = rotations[:, None] @ SIGNED @ rotations.transpose(0, 2, 1)[:, None]
    score = np.einsum("kpab,jkab->jkp", turned, each, optimize=True)
    best = np.argmax(score, axis=2)
    right = 1.0 - np.take_along_axis(score, best[..., None], axis=2)[..., 0]
    drawn = 1.0 - score[..., 0]
    told = (right < 1.0 - _ALIKE) & (drawn > _APART) & (drawn > _CLEARER * right)
    reference = int(np.argmin(told.sum(axis=1)))
    return np.asarray(SIGNED[np.where(told[reference], best[reference], 0)])


def common_gyro_axes(t: Array, rate: Array, still: Array, start: Array, stop: Array) -> Array:
    """(3, 3) signed permutation of the rate that turns gravity from each rest to the next.

    t : (n,) s; rate : (n, 3) rad/s, mean over the gyros; still : (m, 3) specific force at m rests
    from start to stop (m,) s. The identity where that fits, or where too little says so.
    """
    up = still / np.linalg.norm(still, axis=1, keepdims=True)
    off = [
        np.linalg.norm(_turned_by(t[part], rate[part]) @ up[k] - up[k + 1], axis=1)
        for k, part in enumerate(_between(t, start, stop))
        if part.size and float(up[k] @ up[k + 1]) < _TURNED
    ]
    if len(off) < _TURNS:
        return np.eye(3)
    miss = np.median(off, axis=0)
    best = int(np.argmin(miss))
    told = miss[best] < _FITS and miss[0] > _MISSES * max(float(miss[best]), _NEAR)
    return np.asarray(SIGNED[best if told else 0])


def _between(t: Array, start: Array, stop: Array) -> list[Index]:
    """Samples from each rest to the next; none where some are missing between them."""
    step = float(np.median(np.diff(t)))
    ends = np.searchsorted(t, stop[:-1]), np.searchsorted(t, start[1:], side="right")
    spans = [np.arange(max(a - 1, 0), b) for a, b in zip(*ends, strict=True)]
    return [s if np.diff(t[s]).max(initial=0.0) < 3.0 * step else s[:0] for s in spans]


def _turned_by(t: Array, rate: Array) -> Array:
    """(48, 3, 3) what a rate, permuted in every way, does over a stretch to a vector that stands
    still in space, du/dt = -ω x u: small steps, multiplied in pairs."""
    from scipy.spatial.transform import Rotation

    small = -0.5 * (rate[1:] + rate[:-1]) * np.diff(t)[:, None]
    every = np.einsum("pij,nj->pni", SIGNED, small)
    turns = Rotation.from_rotvec(every.reshape(-1, 3)).as_matrix().reshape(48, -1, 3, 3)
    while turns.shape[1] > 1:
        if turns.shape[1] % 2:
            same = np.broadcast_to(np.eye(3), (48, 1, 3, 3))
            turns = np.concatenate([turns, same], axis=1)
        turns = turns[:, 1::2] @ turns[:, ::2]
    return np.asarray(turns[:, 0])


def in_words(signed: Array) -> str:
    """A signed permutation as the board file and mappings write it: "x,-y,z"."""
    at = np.argmax(np.abs(signed), axis=1)
    return ",".join(("-" if signed[i, k] < 0 else "") + "xyz"[k] for i, k in enumerate(at))
