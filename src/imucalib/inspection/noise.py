"""White noise, bias instability and random walk of still sensors, as far as a recording shows them.

    σ²(τ) = N²/τ + (2 ln 2 / π) B² + K² τ/3 + R² τ²/2

(IEEE Std 952-1997, annex C). A term counts when the likelihood of the variances, each chi-square
with its degrees of freedom, gains by it; of one that does not, what it could still be is told.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.inspection.allan import AllanCurve, AllanSums
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import Segments

#: Share of the variance at τ per squared coefficient, and its power of τ.
_SHAPES = {
    "white": (1.0, -1.0),
    "instability": (2.0 * np.log(2.0) / np.pi, 0.0),
    "walk": (1.0 / 3.0, 1.0),
    "ramp": (0.5, 2.0),
}
_GAIN = 8.0  # nats that a term must gain, the octaves sharing their data
_SHARED = 1.6  # by which slow terms scatter more than if the octaves were independent (simulated)
_BOUND = 1.353 * _SHARED**2  # nats to the 95 % bound of one that does not
_MISFIT = 0.01  # probability below which the shortest τ are left out: filters bend them
_FEWEST, _LEFT = 4, 6  # values that a fit needs; that stay where the shortest are left out
_SEEN = 0.5  # share of the variance at some τ that white noise must be, to be told
_ODD = 1.5  # intervals between samples from which on there is a gap
_SENSORS = {"acceleration": "m/s2", "angular_rate": "rad/s"}


@dataclass(frozen=True)
class Coefficient:
    """value, sd : of one that the recording shows, else None; bound : what it lies below, 95 %"""

    value: float | None
    sd: float | None
    bound: float | None


@dataclass(frozen=True)
class AxisNoise:
    """One axis at rest, in SI.

    white : N, unit/√Hz; instability : B, unit; walk : K, unit/s/√Hz; ramp : R, unit/s
    curve : what it was fitted to; start : s, the shortest τ of the fit; None where none fits
    """

    white: Coefficient
    instability: Coefficient
    walk: Coefficient
    ramp: Coefficient
    curve: AllanCurve
    start: float | None


@dataclass(frozen=True)
class SensorNoise:
    """The axes of one sensor: its quantity, its triad, its unit, and the samples a second."""

    triad: str
    quantity: str
    unit: str
    rate: float
    axes: tuple[AxisNoise, ...]


def noise_at_rest(blocks: Iterable[Recording], still: Segments) -> tuple[SensorNoise, ...]:
    """The noise of every sensor in SI units over the still segments, in one pass over the blocks;
    sensors without enough samples at rest are left out."""
    found: dict[str, _Collected] = {}
    for block in blocks:
        for name, channel in block.channels.items():
            if _SENSORS.get(channel.quantity) == channel.unit and channel.t.size:
                found.setdefault(name, _Collected(channel)).add(channel, still)
    made = (one.noise() for one in found.values())
    return tuple(noise for noise in made if noise is not None)


class _Collected:
    """The sums of one channel over the rests."""

    def __init__(self, channel: Channel) -> None:
        self._like = channel
        self._sums = AllanSums(channel.values.shape[1])
        self._last, self._in = -np.inf, -1

    def add(self, channel: Channel, still: Segments) -> None:
        """The samples of a block that lie in rests."""
        t = channel.t
        at = np.searchsorted(still.start, t, side="right") - 1
        inside = (at >= 0) & (t <= still.stop[np.maximum(at, 0)]) if still.n else np.zeros(0, bool)
        rows = np.flatnonzero(inside)
        if not len(rows):
            return
        step = np.diff(t[rows], prepend=self._last)
        other = np.diff(at[rows], prepend=self._in) != 0
        breaks = np.flatnonzero(other | (step > _ODD / channel.rate) | (step <= 0.0))
        for number, part in enumerate(np.split(rows, breaks)):
            if number:
                self._sums.cut()
            self._sums.add(channel.values[part])
        self._last, self._in = float(t[rows[-1]]), int(at[rows[-1]])

    def noise(self) -> SensorNoise | None:
        """Fitted; None where the rests are too short."""
        like = self._like
        curves = self._sums.curves(1.0 / like.rate)
        if len(curves[0].tau) < _FEWEST or not all((c.variance > 0.0).all() for c in curves):
            return None
        axes = tuple(identified(curve) for curve in curves)
        return SensorNoise(like.triad, like.quantity, like.unit, like.rate, axes)


def identified(curve: AllanCurve) -> AxisNoise:
    """The coefficients that a curve of four or more values shows; none where no such sum fits it,
    as with lines in the spectrum: then only what the white noise lies below."""
    from scipy.special import chdtrc

    for start in range(max(len(curve.tau) - _LEFT, 0) + 1):
        rows = np.arange(start, len(curve.tau))
        names, p = _chosen(curve, rows)
        parts = _shape(names, curve.tau[rows]) * p
        # Twice the distance to a perfect fit is about chi-square.
        ratio = curve.variance[rows] / parts.sum(axis=1)
        off = float(np.sum(curve.freedom[rows] * (ratio - 1.0 - np.log(ratio))))
        white = float(np.max(parts[:, 0] / parts.sum(axis=1)))
        if white > _SEEN and chdtrc(max(len(rows) - len(names), 1), off) > _MISFIT:
            found = {name: _coefficient(name, names, curve, rows) for name in _SHAPES}
            return AxisNoise(**found, curve=curve, start=float(curve.tau[start]))
    none = Coefficient(None, None, None)
    most = float(np.sqrt(np.max(curve.variance * curve.tau)))
    return AxisNoise(Coefficient(None, None, most), none, none, none, curve, None)


def _chosen(curve: AllanCurve, rows: NDArray[np.intp]) -> tuple[tuple[str, ...], Array]:
    """Terms that gain, one after the other, and their squared coefficients."""
    names: tuple[str, ...] = ("white",)
    p, cost = _fitted(names, curve, rows)
    while len(names) < len(_SHAPES):
        tried = {n: _fitted((*names, n), curve, rows) for n in _SHAPES if n not in names}
        # One walk looks like a ramp: a ramp must be the likelier by as much as a term must gain.
        best = min(tried, key=lambda n: tried[n][1] + _GAIN * (n == "ramp" and len(tried) > 1))
        if tried[best][1] > cost - _GAIN:
            break
        names, (p, cost) = (*names, best), tried[best]
    return names, p


def _shape(names: tuple[str, ...], tau: Array) -> Array:
    """(M, p) variance per squared coefficient."""
    return np.stack([_SHAPES[n][0] * tau ** _SHAPES[n][1] for n in names], axis=1)


def _fitted(
    names: tuple[str, ...], curve: AllanCurve, rows: NDArray[np.intp],
    held: tuple[str, float] | None = None,
) -> tuple[Array, float]:  # fmt: skip
    """Squared coefficients of the likeliest model and minus its log likelihood.

    held : a term of a given squared coefficient beside them
    """
    from scipy.optimize import minimize

    tau, seen, half = curve.tau[rows], curve.variance[rows], 0.5 * curve.freedom[rows]
    shape = _shape(names, tau)
    more = 0.0 if held is None else _shape((held[0],), tau)[:, 0] * held[1]
    # Each term alone can at most be the least variance that is seen.
    scale = np.min(seen[:, None] / shape, axis=0)

    def cost(x: Array) -> tuple[float, Array]:
        parts = shape * (scale * np.exp(x))
        model = parts.sum(axis=1) + more
        value = float(np.sum(half * (np.log(model) + seen / model)))
        slope = (half * (1.0 / model - seen / model**2)) @ parts
        return value, np.asarray(slope)

    begins = np.full(len(names), np.log(1.0 / len(names)))
    done = minimize(cost, begins, jac=True, method="L-BFGS-B", bounds=[(-30.0, 3.0)] * len(names))
    return np.asarray(scale * np.exp(done.x)), float(done.fun)


def _coefficient(
    name: str, names: tuple[str, ...], curve: AllanCurve, rows: NDArray[np.intp]
) -> Coefficient:
    if name not in names:
        return Coefficient(None, None, _bound(name, names, curve, rows))
    p, _ = _fitted(names, curve, rows)
    shape = _shape(names, curve.tau[rows])
    relative = shape / (shape @ p)[:, None]
    information = relative.T @ (0.5 * curve.freedom[rows, None] * relative)
    at = names.index(name)
    value = float(np.sqrt(p[at]))
    sd = float(np.sqrt(np.linalg.pinv(information, hermitian=True)[at, at])) / (2.0 * value)
    sd *= 1.0 if name == "white" else _SHARED
    return Coefficient(value, sd, None)


def _bound(
    name: str, names: tuple[str, ...], curve: AllanCurve, rows: NDArray[np.intp]
) -> float | None:
    """What a term that does not show lies below, the others fitted along; None where it may be
    anything."""
    from scipy.optimize import brentq

    p, least = _fitted((*names, name), curve, rows)
    top = float(np.max(curve.variance[rows] / _shape((name,), curve.tau[rows])[:, 0]))
    best = float(np.log(max(p[-1] / top, 1e-13)))

    def above(x: float) -> float:
        return _fitted(names, curve, rows, (name, top * np.exp(x)))[1] - least - _BOUND

    if above(5.0) <= 0.0 or above(best) >= 0.0:
        return None
    return float(np.sqrt(top * np.exp(brentq(above, best, 5.0, xtol=1e-3))))
