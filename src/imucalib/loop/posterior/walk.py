"""Independent scatter and a walk of the bias, seen by the posture: whitened at a cost linear in n.

    V = diag(d) + Σ_j K ∘ h_j h_jᵀ,   K(t, t') = exp(-|t - t'| / memory)

Each column h_j (n,) is the share of one independent Ornstein-Uhlenbeck walk of unit size in every
row. Such a walk is Markov: Kalman's filter gives L⁻¹ of the Cholesky factor L of V (Kalman 1960;
Harvey 1989, 3.4), here for a block of rows at a time, whose own factor is dense. The walk goes on
through whatever gaps the rows have.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array

#: Rows that are whitened at once.
_BLOCK = 16


@dataclass(frozen=True)
class Whitener:
    """L⁻¹ at E noises, by blocks of b rows, the last filled up with rows of nothing.

    inverse : (blocks, E, b, b) L⁻¹ of a block given the rows before; seen : (blocks, E, b, q) what
    the walks at the end of the block before do to it; keep : (blocks, E) of these walks; gain :
    (blocks, E, q, b) by which the white rows move them; log_det : (E,) log|V|
    """

    inverse: Array
    seen: Array
    keep: Array
    gain: Array
    log_det: Array

    def of(self, noises: slice) -> Whitener:
        """At some of the noises."""
        return Whitener(
            self.inverse[:, noises],
            self.seen[:, noises],
            self.keep[:, noises],
            self.gain[:, noises],
            self.log_det[noises],
        )

    def __call__(self, columns: Array) -> Array:
        """(E, n, m) L⁻¹ columns, of columns (n, m)."""
        n, m = columns.shape
        own = np.zeros((len(self.keep) * _BLOCK, m))
        own[:n] = columns
        out = np.empty((self.log_det.size, len(own), m))
        state = np.zeros((self.log_det.size, self.gain.shape[2], m))
        for k in range(len(self.keep)):
            rows = slice(k * _BLOCK, (k + 1) * _BLOCK)
            white = np.matmul(self.inverse[k], own[rows], out=out[:, rows])
            white -= self.seen[k] @ state
            state = self.keep[k][:, None, None] * state + self.gain[k] @ white
        return out[:, :n]

    def back(self, white: Array) -> Array:
        """(E, n, m) L⁻ᵀ of columns (E, n, m)."""
        e, n, m = white.shape
        own = np.zeros((e, len(self.keep) * _BLOCK, m))
        own[:, :n] = white
        state = np.zeros((e, self.gain.shape[2], m))
        for k in reversed(range(len(self.keep))):
            rows = slice(k * _BLOCK, (k + 1) * _BLOCK)
            moved = own[:, rows] + self.gain[k].swapaxes(1, 2) @ state
            own[:, rows] = self.inverse[k].swapaxes(1, 2) @ moved
            state = self.keep[k][:, None, None] * state - self.seen[k].swapaxes(1, 2) @ moved
        return own[:, :n]


def whitener(time: Array, variance: Array, shares: Array, memory: Array) -> Whitener:
    """At E noises. time : (n,) s, increasing; variance : (E, n) d; shares : (E, n, q) the h_j, or
    one for all noises; memory : (E,) s"""
    (e, n), q = variance.shape, shares.shape[2]
    blocks = -(-n // _BLOCK)
    rows = np.minimum(np.arange(blocks * _BLOCK), n - 1).reshape(blocks, _BLOCK)
    real = (np.arange(blocks * _BLOCK) < n).reshape(blocks, 1, _BLOCK)
    at = time[rows]
    before = time[np.maximum(rows[:, 0] - 1, 0)]
    near = np.exp(-np.abs(at[:, None, :, None] - at[:, None, None]) / memory[:, None, None])
    keep = np.exp(-(at - before[:, None])[:, None] / memory[:, None])
    h = np.broadcast_to(shares, (e, n, q))[:, rows].swapaxes(0, 1) * real[..., None]
    whole = near * (h @ h.swapaxes(2, 3))
    diagonal = np.arange(_BLOCK)
    whole[..., diagonal, diagonal] += np.where(real, variance[:, rows].swapaxes(0, 1), 1.0)
    kept = keep[..., None] * h
    last = near[..., -1:] * h
    inverse = np.empty((blocks, e, _BLOCK, _BLOCK))
    gain = np.empty((blocks, e, q, _BLOCK))
    off, log_det = np.zeros((e, q, q)), np.zeros(e)
    for k in range(blocks):
        on = keep[k, :, -1, None, None]
        lower = np.linalg.cholesky(whole[k] + kept[k] @ off @ kept[k].swapaxes(1, 2))
        log_det += 2.0 * np.log(lower[:, diagonal, diagonal]).sum(axis=1)
        inverse[k] = np.linalg.inv(lower)
        gain[k] = (inverse[k] @ (last[k] + on * kept[k] @ off)).swapaxes(1, 2)
        off = on**2 * off - gain[k] @ gain[k].swapaxes(1, 2)
    return Whitener(inverse, inverse @ kept, keep[:, :, -1], gain, log_det)
