"""Normal equations along a chain: the unknowns of one rest meet those of the next one, and a few
unknowns meet all rests.

Block Cholesky along the chain takes a rest's unknowns out after another (Golub and Van Loan, Matrix
Computations, 4th edition, section 4.5), for many weights of the turns at a time, so that the cost
grows as the rests.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index


@dataclass(frozen=True)
class Chain:
    """A symmetric matrix of N rests with b unknowns each and of g columns that all share.

    own : (N, b, b) of a rest with itself; ahead : (N - 1, b, b) of the next rest (rows) with it;
    shared : (N, b, g); corner : (g, g)
    """

    own: Array
    ahead: Array
    shared: Array
    corner: Array


@dataclass(frozen=True)
class ChainTurns:
    """Products of the two rows of a turn after each rest, nothing where none is known, as of a
    Chain: own, beyond : (N - 1, b, b) of the rest where it begins and of the next one; ahead :
    (N - 1, b, b); shared, shared_beyond : (N - 1, b, g) of both; flat : (2 (N - 1), g) the rows"""

    own: Array
    beyond: Array
    ahead: Array
    shared: Array
    shared_beyond: Array
    flat: Array


def chain_of(normal: Array, order: Index, shared: Index) -> Chain:
    """The parts of a matrix. order : (N, b) columns of each rest; shared : (g,) the others."""
    rows, others = order[:, :, None], shared[None, :]
    return Chain(
        own=normal[rows, order[:, None, :]],
        ahead=normal[rows[1:], order[:-1, None, :]],
        shared=normal[rows, others],
        corner=normal[np.ix_(shared, shared)],
    )


def turns_of(jacobian: Array, rest: Index, order: Index, shared: Index) -> ChainTurns:
    """Of two rows a turn (2 T, P), one after the other; rest : (T,) where each begins."""
    rows = np.zeros((len(order) - 1, 2, jacobian.shape[1]))
    rows[rest] = jacobian.reshape(len(rest), 2, -1)
    here, there = (
        np.take_along_axis(rows, columns[:, None, :], axis=2).swapaxes(1, 2)
        for columns in (order[:-1], order[1:])
    )
    across = rows[:, :, shared]
    return ChainTurns(
        own=here @ here.swapaxes(1, 2),
        beyond=there @ there.swapaxes(1, 2),
        ahead=there @ here.swapaxes(1, 2),
        shared=here @ across,
        shared_beyond=there @ across,
        flat=across.reshape(-1, len(shared)),
    )


def eliminate(chain: Chain, turns: ChainTurns, weight: Array) -> tuple[Array, Array]:
    """(B, g, g) the products of the shared columns with all rests taken out of the chain and of the
    turns, each times its weight, and (B,) half the logarithm of the determinant of these.

    weight : (B, N - 1), of the turn after each rest. Raises LinAlgError where a rest is
    undetermined.
    """
    each = np.repeat(weight, 2, axis=1)
    corner = chain.corner + (turns.flat.T * each[:, None, :]) @ turns.flat
    logs, last = np.zeros(len(weight)), len(chain.own) - 1
    step = seen = np.zeros((0, 0))
    for k in range(last + 1):
        own, shared = chain.own[k], chain.shared[k]
        if k:  # what the rest before leaves, and the turn from there
            heavy, back = weight[:, k - 1, None, None], step.swapaxes(1, 2)
            own = own + heavy * turns.beyond[k - 1] - back @ step
            shared = shared + heavy * turns.shared_beyond[k - 1] - back @ seen
        if k < last:
            heavy = weight[:, k, None, None]
            own, shared = own + heavy * turns.own[k], shared + heavy * turns.shared[k]
        root = np.linalg.cholesky(own)
        inverse = np.linalg.inv(root)
        seen = inverse @ shared
        corner -= seen.swapaxes(1, 2) @ seen
        logs += np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        if k < last:
            step = inverse @ (chain.ahead[k] + heavy * turns.ahead[k]).swapaxes(1, 2)
    return corner, logs
