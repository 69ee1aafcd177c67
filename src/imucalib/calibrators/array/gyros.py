"""Gyros of an array in motion: each relative to their mean, and how far that mean can be believed.

At rest a gyro shows its offset only. In motion the triads are compared with each other: gain G_k
of each relative to the mean rate, whose own gain is one by definition. The common gyro scale trades
off against the array's size (size changes by minus twice the scale): it is held by the mean of the
gyros and reported, never fitted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index

#: Rests from which they contradict an effect, and times their scatter that it would make of it.
ATTITUDES, _WORSE = 4, 1.2
SCALE_TOLERANCE = 0.03  # of one gyro's scale, by the data sheets of consumer parts


@dataclass(frozen=True)
class Gyros:
    """gain : (K, 3, 3), reading = G_k ω; mean : (N, 3) rad/s of the corrected triads;
    scatter : (N,) rad/s, rms over the triads and axes; covariance : (3, 3) of one triad."""

    gain: Array
    mean: Array
    scatter: Array
    covariance: Array

    @property
    def triads(self) -> int:
        return len(self.gain)

    @property
    def scale_sd(self) -> float:
        """Relative standard deviation of the array's size that the gyros' tolerance leaves:
        uniform within it, mean of all axes, twice."""
        return float(2.0 * SCALE_TOLERANCE / np.sqrt(3.0) / np.sqrt(3.0 * self.triads))


def relative_gyros(rate: Array, rows: Index) -> Gyros:
    """Fit the gains on samples `rows` of rates (N, K, 3) rad/s and apply them to all."""
    triads = rate.shape[1]
    gain = np.broadcast_to(np.eye(3), (triads, 3, 3)).copy()
    chosen = rate[rows]
    for _ in range(20):
        corrected = np.einsum("kij,nkj->nki", np.linalg.inv(gain), chosen)
        w = corrected.mean(axis=1)
        normal = w.T @ w
        fitted = np.stack([np.linalg.solve(normal, w.T @ chosen[:, k]).T for k in range(triads)])
        fitted = fitted @ np.linalg.inv(fitted.mean(axis=0))
        moved = np.abs(fitted - gain).max()
        gain = fitted
        if moved < 1e-12:
            break
    corrected = np.einsum("kij,nkj->nki", np.linalg.inv(gain), rate)
    mean = corrected.mean(axis=1)
    off = corrected - mean[:, None]
    freedom = (triads - 1) / triads
    scatter = np.sqrt(np.mean(off**2, axis=(1, 2)) / freedom)
    apart = off[rows].reshape(-1, 3)
    # Robust: half the samples near the median carry the spread, a few far ones do not.
    width = np.median(np.abs(apart), axis=0) / 0.6745
    inside = np.all(np.abs(apart) < 4.0 * width, axis=1)
    covariance = apart[inside].T @ apart[inside] / inside.sum() / freedom
    return Gyros(gain, mean, scatter, covariance)


def contradicted(rate: Array, made: Array) -> bool:
    """Whether what an effect adds to gyros at rest makes the rests scatter more.

    rate, made : (n, K, 3) rad/s at n rests, as read and as the effect has it
    """
    return _scatter(rate - made) > _WORSE * _scatter(rate)


def _scatter(values: Array) -> float:
    """Root mean square about the means over the rests."""
    return float(np.sqrt(np.mean((values - values.mean(axis=0)) ** 2)))


def gyro_drift(rate: Array, t: Array) -> tuple[Array, Array]:
    """Coefficients (order + 1, K, 3) rad/s of the gyros' offsets at rest, of powers of a time that
    runs from -1 at the first rest to 0 at the last, and their standard deviation (K, 3) there; the
    order by the Bayesian information criterion.

    rate : (n, K, 3) rad/s at n rests; t : (n,) s
    """
    values = rate.reshape(len(rate), -1)
    late = (t - t[-1]) / max(float(np.ptp(t)), 1e-9)
    tries = []
    for order in range(3):
        powers = late[:, None] ** np.arange(order + 1)
        found = np.linalg.lstsq(powers, values, rcond=None)[0]
        rest = values - powers @ found
        size = values.shape[1]
        cost = values.size * np.log(max(float(np.mean(rest**2)), 1e-300))
        tries.append((cost + np.log(values.size) * size * (order + 1), found, powers, rest))
    _, found, powers, rest = min(tries, key=lambda t: t[0])
    freedom = max(len(rest) - powers.shape[1], 1)
    leverage = float(np.linalg.inv(powers.T @ powers)[0, 0])
    sd = np.sqrt(leverage * np.sum(rest**2, axis=0) / freedom)
    return found.reshape(-1, *rate.shape[1:]), np.asarray(sd.reshape(rate.shape[1:]))
