"""What a joint fit has as unknowns: positions and terms, and their products at a fitted motion.

How much the readings tell of a joint fit whose weights follow its residuals.

Weights (ν + 3)/(ν + d²) fall where a residual grows, so that a score answers a shift of what is
fitted by less than its weights say: by (ν + 3)/(ν + 5) where residuals are the errors (Lange,
Little, Taylor 1989, JASA 84). The motion of a sample takes a part of few IMUs' errors and may lay
one chip's on another, and then the share is another: of four chips less still. So it is measured.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.motion.board_motion import BoardMotion
from imucalib.calibrators.array.motion.setup import Setup
from imucalib.calibrators.array.motion.terms import Term
from imucalib.estimators.array.gram import Columns, Gram
from imucalib.estimators.array.samples import Readings, Sampled

#: Coordinates that a drawing's stated deviation counts as.
_STATED = 3.0


def drawing_precision(off: Array, sd: float) -> float:
    """1/m², of each coordinate about its drawing, where the drawing's stated sd (m) may itself be
    wrong by a factor that all coordinates share: a multivariate t, whose weight follows from what
    they are off (d,) m (Lange, Little, Taylor 1989, JASA 84, equation 5)."""
    return (_STATED + off.size) / (_STATED * sd**2 + float(off @ off))


class PositionBase:
    """Columns of what is fitted: positions and terms, and the matrix from raw columns to the
    coordinates that are free."""

    def __init__(
        self, setup: Setup, sampled: Sampled, motion: BoardMotion, r: Array, terms: Sequence[Term]
    ) -> None:
        """r : (K, 3) m; sampled, motion : fitted with it and the terms."""
        k = setup.triads
        turn = np.broadcast_to(sampled.turn, (k, *sampled.turn.shape))
        blocks = [Columns(np.asarray(turn), False, False)]
        blocks += [term.columns(motion) for term in terms]
        self.blocks: Sequence[Columns] = blocks
        self.setup, self.sampled = setup, sampled
        self.raw = sum(block.size for block in blocks)
        self.lives = [np.eye(3 * k)[:, 3:], *(term.live for term in terms)]
        off = (r - setup.board.drawn)[1:].ravel()
        flat = np.full(off.size, drawing_precision(off, setup.board.prior_sd))
        self.prior = np.concatenate([flat, *(term.sd**-2.0 for term in terms)])
        # What positions absorb is absorbed for good.
        held = [term.sd**-2.0 * (not term.found) for term in terms]
        self.rests = np.concatenate([0.0 * flat, *held])
        self.pull = self.prior * np.concatenate([off, *(term.value for term in terms)])

    def free(self, found: Gram) -> Gram:
        """The Gram matrix with the raw columns of the base replaced by its coordinates, in its
        place: of many IMUs a copy would be large."""
        turn = self._turn
        n, raw = turn.shape[1], self.raw
        own, beside = turn.T @ found.matrix[:raw, :raw] @ turn, turn.T @ found.matrix[:raw, raw:]
        matrix = found.matrix[raw - n :, raw - n :]
        matrix[:n, :n], matrix[:n, n:], matrix[n:, :n] = own, beside, beside.T
        along = np.concatenate([turn.T @ found.along[:raw], found.along[raw:]])
        return Gram(matrix, along, found.power)

    @property
    def _turn(self) -> Array:
        from scipy.linalg import block_diag

        return np.asarray(block_diag(*self.lives))

    def along(self, raw: Array) -> Array:
        """Products (..., raw) with the raw columns as those with the free coordinates."""
        ends = np.cumsum([live.shape[0] for live in self.lives])[:-1]
        parts = zip(self.lives, np.split(raw, ends, axis=-1), strict=True)
        return np.concatenate([part @ live for live, part in parts], axis=-1)

    def reading(self, step: Array, shape: tuple[int, ...]) -> Readings:
        """What a step of the free coordinates adds to the readings; shape : (T, K, 3) of each."""
        acceleration, rate = np.zeros(shape), np.zeros(shape)
        ends = np.cumsum([live.shape[1] for live in self.lives])[:-1]
        for block, live, part in zip(self.blocks, self.lives, np.split(step, ends), strict=True):
            target = rate if block.gyro else acceleration
            target += block.at(live @ part)
        return Readings(acceleration, rate)
