"""λ sin(angle) between rivals that new data promise: what of one the other cannot take over.

With all columns' products G, base and rival b taken out of truth a,

    λ² sin² = θᵀ (G_aa - G_ac G_cc⁻¹ G_ca) θ,   c = base and b

for sizes θ as the recording tells them. Sizes are uncertain: of several draws the one that few fall
below counts, for the least of all ordered pairs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.loop.separation.products import Ambiguity

#: Draws of a rival's size, and the share of them that counts as few.
_DRAWS, _FEW = 24, 0.15


@dataclass(frozen=True)
class Pair:
    """truth, other : rivals; own, rest : their columns; base : those of the base model; size :
    (k, draws) of the truth"""

    truth: str
    other: str
    own: Index
    rest: Index
    base: Index
    size: Array


def pairs_of(ambiguity: Ambiguity, seed: int = 0) -> tuple[Pair, ...]:
    """Every rival as the truth, with sizes that the recording allows, against every other."""
    rng = np.random.default_rng(seed)
    found = []
    for truth in ambiguity.rivals:
        at = ambiguity.blocks[truth]
        size = ambiguity.sizes[truth]
        drawn = size.drawn(rng, _DRAWS, np.ones(_DRAWS))[-at.size :]
        found += [
            Pair(truth, other, at, b, ambiguity.own, drawn)
            for other, b in ambiguity.blocks.items()
            if other != truth
        ]
    return tuple(found)


def apart(gram: Array, pairs: Sequence[Pair]) -> Array:
    """(..., pairs) expected λ sin(angle) with products of all columns (..., P, P); pairs : of one
    ambiguity."""
    # The base is taken out once for all pairs: with many IMUs it has most of the columns.
    base = pairs[0].base
    every = np.unique(np.concatenate([at for pair in pairs for at in (pair.own, pair.rest)]))
    # A little of each diagonal: columns that nothing tells apart must not end the computation.
    little = 1e-10 * np.einsum("...ii->...i", gram) + 1e-12
    left = _without(gram, base, every, little[..., base])

    def one(pair: Pair) -> Array:
        own, rest = np.searchsorted(every, pair.own), np.searchsorted(every, pair.rest)
        apart = _without(left, rest, own, little[..., pair.rest])
        square = np.einsum("kd,...kl,ld->...d", pair.size, apart, pair.size)
        return np.asarray(np.sqrt(np.maximum(np.quantile(square, _FEW, axis=-1), 0.0)))

    return np.stack([one(pair) for pair in pairs], axis=-1)


def _without(gram: Array, out: Index, kept: Index, little: Array) -> Array:
    """(..., k, k) products of the kept columns with others taken out; little : (..., o) that is
    added to the diagonal of these"""
    inside = gram[..., out[:, None], out] + little[..., None] * np.eye(len(out))
    across = gram[..., out[:, None], kept]
    back = across.swapaxes(-1, -2) @ np.linalg.solve(inside, across)
    return np.asarray(gram[..., kept[:, None], kept] - back)
