"""What a recording says of every effect beside its base model, kept without the recording.

Linear in all parameters at the base model's fit, it is enough to pool recordings of one device, and
devices of one kind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index


@dataclass(frozen=True)
class Base:
    """The base model alone: parameters (p,) by name, θ (p,) and its covariance, in their units."""

    parameters: tuple[str, ...]
    theta: Array
    covariance: Array


@dataclass(frozen=True)
class Sums:
    """base : the model without any of the effects; blocks : effect -> (k,) its columns
    gram : (m, m) products of the columns, at typical sizes in units of the noise, with the base
        model's parameters taken out; along : (m,) their products with the data
    taken : (p, m) by how much the base's θ falls for one typical size of each column
    noise : mg, of an observation; dof : its degrees of freedom; wander : mg, rms of what a bias
        that wanders does beside it
    """

    base: Base
    blocks: Mapping[str, Index]
    gram: Array
    along: Array
    taken: Array
    noise: float
    dof: float
    wander: float

    def together(self, names: Sequence[str], mean: Array, covariance: Array) -> tuple[Array, Array]:
        """θ and covariance of the base and of effects whose sizes (typical) are known: mean (k,),
        covariance (k, k) in the order of their names."""
        turn = self.taken[:, columns_of(self.blocks, names)]
        across = -turn @ covariance
        inside = self.base.covariance - across @ turn.T
        return (
            np.concatenate([self.base.theta - turn @ mean, mean]),
            np.block([[inside, across], [across.T, covariance]]),
        )


def columns_of(blocks: Mapping[str, Index], names: Sequence[str]) -> Index:
    """(k,) columns of some effects, in the order of their names."""
    return np.concatenate([np.zeros(0, np.intp), *(blocks[name] for name in names)])
