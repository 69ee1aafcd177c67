"""What a recording says of every effect beside its base model, kept without the recording.

Linear in all parameters at the base model's fit, it is enough to pool recordings of one device, and
devices of one kind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import CLOCKS
from imucalib.core.fit import Fit
from imucalib.posterior.odds import SHOWN
from imucalib.posterior.search.gram import marginalize
from imucalib.posterior.search.problem import Problem
from imucalib.posterior.search.solution import noises_of
from imucalib.posterior.search.space import Posterior


@dataclass(frozen=True)
class BaseParameters:
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
    noise : mg, of an observation; dof : its degrees of freedom; drift : mg, rms of what a bias
        that wanders does beside it
    """

    base: BaseParameters
    blocks: Mapping[str, Index]
    gram: Array
    along: Array
    taken: Array
    noise: float
    dof: float
    drift: float

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


def sums_of(problem: Problem, posterior: Posterior, base: Fit, noise: float, drift: float) -> Sums:
    """What a recording says of every name beside its base model, over the noises by their weights.

    base : the base model's fit; noise, drift : mg
    """
    grams, p = posterior.grams, problem.base
    weight = noises_of(problem, grams, ())
    one = marginalize(grams, problem.flat)
    own = {
        problem.components[c.component].name: c.at
        for c in reversed(problem.choices)
        if _keep(problem, c.component)
    }
    at = columns_of(own, list(own))
    rows = one.rows(at)
    scaled = weight / (one.power / posterior.dof)
    gram = np.einsum("e,eij->ij", scaled, rows[:, :, at])
    along = scaled @ rows[:, :, -1]
    inside = grams.rows(np.arange(p))
    solved = np.linalg.solve(inside[:, :, :p], inside[:, :, at])
    whole = np.einsum("e,emm->m", scaled, grams.rows(at)[:, :, at])
    share = np.diag(gram) / np.maximum(whole, 1e-300)
    blocks, kept, start = dict[str, Index](), list[int](), 0
    for name, columns in own.items():
        place = np.arange(start, start + columns.size)
        start += columns.size
        if float(share[place].max(initial=0.0)) > SHOWN**2:
            blocks[name] = np.arange(len(kept), len(kept) + place.size)
            kept += place.tolist()
    return Sums(
        base=BaseParameters(tuple(q.name for q in base.parameters), base.theta, base.covariance),
        blocks=blocks,
        gram=0.5 * (gram + gram.T)[np.ix_(kept, kept)],
        along=along[kept],
        taken=np.einsum("e,epm->pm", weight, solved)[:, kept],
        noise=noise,
        dof=float(posterior.dof),
        drift=drift,
    )


def _keep(problem: Problem, component: int) -> bool:
    """Whether a component is one name, and not of this recording's time alone, which its kind does
    not share."""
    one = problem.components[component]
    needs = one.members[0].effects[0][0].needs
    return one.kind == "name" and not one.name.endswith("@") and not set(needs) & set(CLOCKS)
