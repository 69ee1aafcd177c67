"""What a worn sensor's recording says of every effect, whatever the walk of its bias may be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.fit import Fit
from imucalib.loop.separation.sums import Base, Sums, columns_of
from imucalib.loop.thresholds import ABSORBED
from imucalib.loop.wander.bank import Bank
from imucalib.loop.wander.likelihood import Level, levels
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.walk import correlated, weighted

#: Likelihood below the best one's from which on a walk counts for nothing, nats.
_FORGOTTEN = 8.0
#: Share by which a variance may differ between walks before more is no help.
_MOST_OPEN = 0.5


def sums_of(problem: Problem, level: Level, base: Fit) -> Sums:
    """Of the rows that were searched: what is thinned out says nothing.

    base : under the fitted walk. Left out is what the base model absorbs, and what time alone
    drives, scans included: that is this recording's, not its kind's.

    Columns are weighted by the fitted walk, a = W'y and G = W'X; but what a scatters by is that of
    every walk that the data allow, going on through all parts: K. What a says of the sizes is then
    G K⁻¹ G and G K⁻¹ a (a temperature and a slow walk look alike: with K = G one clean fleet in
    eight had an effect of temperature, with K one in sixteen).
    """
    bank, terms = problem.bank, problem.terms
    own = [e for e in problem.entries if not (e.timed or e.family)]
    at = columns_of({e.name: e.columns for e in own}, [e.name for e in own])
    inside, every = bank.columns[:, terms.columns], bank.columns[:, at]
    weight = weighted(bank.course, bank.walks[level.walk], np.column_stack([inside, every]))
    precise = inside.T @ weight[:, : terms.base] + np.diag(terms.precision)
    taken = np.linalg.solve(precise, weight[:, : terms.base].T @ every)
    rest = weight[:, terms.base :] - weight[:, : terms.base] @ taken
    share = np.einsum("nm,nm->m", rest, every)
    share = share / np.maximum(np.einsum("nm,nm->m", weight[:, terms.base :], every), 1e-300)
    kept, blocks, start = list[int](), {}, 0
    for entry in own:
        end = start + entry.columns.size
        if float(share[start:end].max(initial=0.0)) > ABSORBED**2:
            blocks[entry.name] = np.arange(len(kept), len(kept) + end - start)
            kept += range(start, end)
        start = end
    rest, gram = rest[:, kept], rest[:, kept].T @ every[:, kept]
    scatter = _scatter(bank, problem, rest, tuple(blocks.values()))
    told = gram @ np.linalg.pinv(scatter, rcond=1e-9, hermitian=True)
    gram, along = told @ gram, told @ (rest.T @ bank.columns[:, bank.data])
    typical = np.array([q.typical for q in base.parameters])
    return Sums(
        base=Base(tuple(q.name for q in base.parameters), base.theta, base.covariance),
        blocks=blocks,
        gram=0.5 * (gram + gram.T),
        along=along,
        taken=taken[:, kept] * typical[:, None],
        noise=problem.noise.scatter * float(np.sqrt(level.variance)),
        dof=float(len(inside) - terms.base),
        wander=problem.noise.wander,
    )


def _scatter(bank: Bank, problem: Problem, columns: Array, blocks: Sequence[Index]) -> Array:
    """W' V W over the walks, as often as the likelihood of each says.

    What the data leave open of a variance makes its inverse too large on average: an effect whose
    variance differs between the walks by a share v has Student's tails of 2 / v degrees of freedom,
    and squares that are 1 / (1 - v) of it.
    """
    every = levels(bank, problem.terms, np.ones(bank.course.parts, dtype=bool))
    top = max(one.nats for one in every)
    likely = [one for one in every if one.nats > top - _FORGOTTEN]
    often = np.exp([one.nats - top for one in likely])
    often = often / often.sum()
    each = np.array([
        one.variance * columns.T @ correlated(bank.course, bank.walks[one.walk], columns)
        for one in likely
    ])  # fmt: skip
    mean = np.asarray(np.einsum("w,wij->ij", often, each))
    wider = np.ones(len(mean))
    for at in blocks:
        inverse = np.linalg.pinv(mean[np.ix_(at, at)], rcond=1e-9, hermitian=True)
        ratio = np.einsum("ij,wji->w", inverse, each[:, at][:, :, at]) / at.size
        open_ = float(often @ (ratio - 1.0) ** 2)
        wider[at] = (1.0 - min(open_, _MOST_OPEN)) ** -0.5
    return mean * np.outer(wider, wider)
