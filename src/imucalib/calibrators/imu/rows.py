"""The rows of the joint fit with every rest's own unknowns taken out, and how they hang together.

A rest's rates give its bias one for one, and what its forces are across gravity its direction. Put
into the other rows, a rest leaves one number, the size of its force, a turn two, and the walk
between two rests three. What was put in brings its noise along: neighbours share it, so that
the covariance is a band, beside what whole power-ups share,

    V = D + F diag(v) F' + G diag(r) G' + p² O O'

D : turns and walk; v, r : variances of the rests' forces and rates; p : scatter of power-ups. Its
Cholesky factor costs as the rests (Golub and Van Loan, Matrix Computations, 4th edition, 4.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import cho_solve_banded, cholesky_banded

from imucalib.arrays import Array, Index
from imucalib.estimators.turns import (
    ACCELEROMETER,
    ANGLE_PRIOR,
    GAIN,
    TurnFit,
    noise_points,
    tangents,
    variances,
)
from imucalib.posterior.odds import BETWEEN
from imucalib.posterior.search.noise import WideCovariance

#: g, scatter of the forces of rests beside what their samples say, that is weighed: flat in the log
#: over what chips and hands leave; and how many floors of a turn are taken together.
_FORCES, _COARSE = 1e-4 * np.array([0.0, *4.0 ** np.arange(4)]), 2


class TurnNoisePoint(NamedTuple):
    """turns : number among `noise_points`; force, power_up : g; log_prior : of it"""

    turns: int
    force: float
    power_up: float
    log_prior: float


def points_of(fit: TurnFit, *, between_temperatures: bool) -> tuple[TurnNoisePoint, ...]:
    """All noises that a fit's rows may have. between_temperatures : whether a law of the
    temperature may be what power-ups differ by, so that they may scatter less than they seem to."""
    shares = BETWEEN if between_temperatures else BETWEEN[:1]
    angles = len(ANGLE_PRIOR)
    floors = range(0, len(noise_points(fit.log, fit.noise)), _COARSE * angles)
    every = product(_FORCES.tolist(), shares.tolist(), floors, enumerate(np.log(ANGLE_PRIOR)))
    return tuple(
        TurnNoisePoint(floor + k, force, fit.noise.power_up * share, float(prior))
        for force, share, floor, (k, prior) in every
    )


@dataclass(frozen=True)
class ReducedRows:
    """columns : (n, q) of accelerometer, gains and laws, and the misfit, last; shared : (n, 3 L) of
    power-ups; known : (18, q) what is known of accelerometer and gains before any reading
    turn : (n,) the turn of a number, or -1; force, rate : (n, 3 N) sparse, what the noise of each
    rest's forces and rates does to a number; walk : (n,) variance of its own
    """

    columns: Array
    shared: Array
    known: Array
    turn: Index
    force: sparse.csr_array
    rate: sparse.csr_array
    walk: Array

    @staticmethod
    def of(fit: TurnFit) -> ReducedRows:
        """The rows of a fit, its turns that took part; its parameters' number in any prior."""
        log, state, rows = fit.log, fit.state, fit.rows
        n, of_turns = log.rests, 2 * rows.turns
        whole = sparse.hstack([rows.jacobian, rows.residual[:, None]], format="csr")
        ends = np.cumsum([of_turns, 3 * n, 3 * n, 3 * (n - 1)])
        edges = pairwise([0, *ends.tolist(), whole.shape[0]])
        turns, forces, rates, walk, known = (whole[a:b] for a, b in edges)
        frames = np.concatenate([state.up[:, :, None], tangents(state.up)], axis=2)
        turned = sparse.block_diag(list(frames.swapaxes(1, 2)), format="csr")
        forces = turned @ forces  # along gravity, and twice across
        across = np.delete(np.arange(3 * n), np.arange(0, 3 * n, 3))
        used = np.repeat(fit.used & (fit.weight > 0.0), 2)
        every = sparse.vstack([turns[np.flatnonzero(used)], forces[::3], walk], format="csr")
        drift, up = state.first_drift, state.first_up
        of_rate, of_up = every[:, drift:up], every[:, up : up + 2 * n]
        every = (every - of_rate @ rates + of_up @ forces[across]).toarray()
        shared = every[:, state.first_offset : drift]
        every[:, -1] -= shared @ state.offset.ravel()  # which power-ups have about none
        at = np.repeat([turn.rest for turn in log.turns], 2)[used]
        steps = np.repeat(np.arange(n - 1), 3)
        order = np.argsort(np.concatenate([at + 0.3, np.arange(n), steps + 0.6]), kind="stable")
        number = np.repeat(np.arange(rows.turns), 2)[used]
        turn = np.concatenate([number, np.full(n + steps.size, -1)])
        place = sparse.csr_array((np.ones(2 * n), (np.arange(2 * n), across)), shape=(2 * n, 3 * n))
        along = sparse.csr_array(
            (np.ones(n), (at.size + np.arange(n), 3 * np.arange(n))), shape=(len(turn), 3 * n)
        )
        variance = variances(log, fit.noise, np.zeros(state.theta.size))
        own = np.zeros(len(turn))
        own[at.size + n :] = variance[ends[2] : ends[3]]
        kept = np.r_[: state.first_offset, every.shape[1] - 1]
        first = ACCELEROMETER + GAIN
        sd = np.sqrt(variance[ends[3] : ends[3] + first])
        return ReducedRows(
            columns=every[order][:, kept],
            shared=shared[order],
            known=known.toarray()[:first][:, kept] / sd[:, None],
            turn=turn[order].astype(np.intp),
            force=sparse.csr_array((along + of_up @ place)[order]),
            rate=sparse.csr_array(-of_rate[order]),
            walk=own[order],
        )

    def scale(self, size: Array) -> ReducedRows:
        """With each column times its size (q,)."""
        return replace(self, columns=self.columns * size, known=self.known * size)

    def select(self, columns: Index) -> ReducedRows:
        """Of some columns."""
        return replace(self, columns=self.columns[:, columns], known=self.known[:, columns])


@dataclass(frozen=True)
class TurnTerms:
    """Reduced rows with what their noise may be. fit : whose turns, weights and rests count;
    rows : of it or of one like it, all of whose turns are in it"""

    rows: ReducedRows
    fit: TurnFit

    @cached_property
    def _kept(self) -> Index:
        """Numbers of turns that take part, and all others."""
        turn = self.rows.turn
        return np.flatnonzero((turn < 0) | self.fit.used[turn])

    @cached_property
    def columns(self) -> Array:
        """(n, q) those of the rows that take part."""
        return self.rows.columns[self._kept]

    @cached_property
    def numbers(self) -> float:
        """How many there are, but for those that a rest which takes no part has of its own."""
        lost = np.repeat(~np.isfinite(self.fit.log.force_sd), 3)
        touched = np.asarray(abs(self.rows.force[self._kept]).sum(axis=0)).ravel() > 0.0
        return float(self._kept.size - np.sum(lost & touched))

    @cached_property
    def _turns(self) -> Array:
        """(B, T) variances of the turns at every floor and angle, as heavy as each turn is."""
        weight = np.where(self.fit.weight > 0.0, self.fit.weight, 1.0)
        return noise_points(self.fit.log, self.fit.noise) / weight

    @cached_property
    def _bands(self) -> dict[float, Array]:
        """Of a scatter of the rests' forces the band without that of the turns."""
        return {}

    def _band(self, force: float) -> Array:
        if force not in self._bands:
            log, kept = self.fit.log, self._kept
            noise = replace(self.fit.noise, force=force)
            every = variances(log, noise, np.zeros(self.fit.state.theta.size))
            start = 2 * len(log.turns)
            own = every[start : start + 3 * log.rests]
            f, g = self.rows.force[kept], self.rows.rate[kept]
            whole = f @ f.multiply(own).T + g @ g.multiply(log.rate_sd.ravel() ** 2).T
            self._bands[force] = _lower_band(sparse.coo_array(whole), self.rows.walk[kept])
        return self._bands[force]

    def covariance(self, point: TurnNoisePoint, lacked: Array | None = None) -> WideCovariance:
        """V at a point; lacked : (n, m) factor of what may be there beside the noise."""
        turn = self.rows.turn[self._kept]
        band = self._band(point.force).copy()
        band[0] += np.where(turn < 0, 0.0, self._turns[point.turns][turn])
        root = cholesky_banded(band, lower=True, check_finite=False)

        def weigh(columns: Array) -> Array:
            return np.asarray(cho_solve_banded((root, True), columns, check_finite=False))

        wide = [point.power_up * self.rows.shared[self._kept]]
        every = np.hstack(wide if lacked is None else [*wide, lacked])
        return WideCovariance.of(weigh, 2.0 * float(np.log(root[0]).sum()), every)

    def evidence(
        self, points: Sequence[TurnNoisePoint], base: int, lacked: Array | None = None
    ) -> Array:
        """(P,) log evidence of the first `base` columns, flat, at some points, where `lacked` is
        there beside the noise."""
        own = np.r_[:base, self.columns.shape[1] - 1]
        columns, known = self.columns[:, own], self.rows.known[:, own]
        before, logs = known.T @ known, np.empty(len(points))
        for k, point in enumerate(points):
            covariance = self.covariance(point, lacked)
            root = np.linalg.cholesky(before + columns.T @ covariance.solve(columns))
            size = np.log(np.diag(root))
            logs[k] = point.log_prior - 0.5 * covariance.log_det - size[:-1].sum()
            logs[k] -= (self.numbers - base) * size[-1]
        return logs


def _lower_band(matrix: sparse.coo_array, diagonal: Array) -> Array:
    """(b + 1, n) lower form of a symmetric matrix and a diagonal."""
    row, column = matrix.coords
    below = row >= column
    away = row[below] - column[below]
    band = np.zeros((int(away.max(initial=0)) + 1, matrix.shape[0]))
    np.add.at(band, (away, column[below]), matrix.data[below])
    band[0] += diagonal
    return band
