"""White noise, bias instability and random walk of still sensors, as far as a recording shows them.

    σ²(τ) = N²/τ + (2 ln 2 / π) B² + K² τ/3 + R² τ²/2

(IEEE Std 952-1997, annex C). A term counts when the likelihood of the variances, each chi-square
with its degrees of freedom, gains by it; of one that does not, what it could still be is bounded.

σ²(τ) is half of the mean squared difference of neighbouring means over τ, at every overlap (W. J.
Riley, Handbook of Frequency Stability Analysis, NIST SP 1065, 2008, section 5.2.2). From 64 samples
on, the overlap goes in steps of 1/64 of τ, so that memory does not grow with the recording.
Stretches that do not touch add their squares.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.atomic_file import replaced_atomically
from imucalib.errors import UnreadableInput
from imucalib.recording.recording import Channel, Recording
from imucalib.recording.yaml_text import dump, load
from imucalib.rests.segments import Segments

_STEPS = 64  # places of a mean within τ, at most
_OCTAVES = 40  # levels at most
_LEAST_FREEDOM = 2.0  # degrees of freedom below which a value says nothing


@dataclass(frozen=True)
class AllanCurve:
    """tau : (M,) s, doubling; variance : (M,) of one axis, in the unit squared; freedom : (M,)
    degrees of freedom of each, the fewest of any noise; seconds : of samples in all; longest : s,
    the longest stretch"""

    tau: Array
    variance: Array
    freedom: Array
    seconds: float
    longest: float

    @property
    def deviation(self) -> Array:
        return np.sqrt(self.variance)

    def interval(self, level: float = 0.95) -> tuple[Array, Array]:
        """(M,) ends of the deviation's interval, by its chi-square (SP 1065, section 5.3.1)."""
        from scipy.special import chdtri

        ends = (1.0 + level) / 2.0, (1.0 - level) / 2.0
        low, high = (self.variance * self.freedom / chdtri(self.freedom, 1.0 - e) for e in ends)
        return np.sqrt(low), np.sqrt(high)


class _Level:
    """Means of 2^level samples, one after the other, and what they add to the squares."""

    def __init__(self, axes: int, lengths: tuple[int, ...]) -> None:
        self.lengths = lengths
        self.squares = np.zeros((len(lengths), axes))
        self.terms = np.zeros(len(lengths), dtype=np.int64)
        self.freedom = np.zeros(len(lengths))
        self.count = 0
        self._tail = self._odd = np.empty((0, axes))

    def cut(self) -> None:
        """A stretch has ended: what comes next has no neighbours here."""
        self.freedom += [_freedom(self.count + 1, m) for m in self.lengths]
        self.count, self._tail, self._odd = 0, self._tail[:0], self._odd[:0]

    def add(self, values: Array) -> Array:
        """Take means in; returns the means of pairs that are complete."""
        self.count += len(values)
        every = np.concatenate([self._tail, values])
        for i, m in enumerate(self.lengths):
            seen = every[max(0, len(every) - len(values) - 2 * m + 1) :]
            if len(seen) >= 2 * m:
                x = np.concatenate([np.zeros((1, seen.shape[1])), np.cumsum(seen, axis=0)])
                second = (x[2 * m :] - 2.0 * x[m:-m] + x[: -2 * m]) / m
                self.squares[i] += np.sum(second**2, axis=0)
                self.terms[i] += len(second)
        self._tail = every[-(2 * self.lengths[-1] - 1) :]
        pairs = np.concatenate([self._odd, values])
        whole = len(pairs) // 2 * 2
        self._odd = pairs[whole:]
        return np.asarray(0.5 * (pairs[0:whole:2] + pairs[1:whole:2]))


class AllanSums:
    """Sums of one sensor's axes over stretches of samples."""

    def __init__(self, axes: int) -> None:
        self._axes = axes
        self._levels = [_Level(axes, tuple(1 << k for k in range(_STEPS.bit_length())))]
        self._offset: Array | None = None
        self._longest = self._samples = 0

    def add(self, values: Array) -> None:
        """The next samples (n, axes) of a stretch."""
        if not len(values):
            return
        if self._offset is None:
            self._offset = values[0].copy()
        means = values - self._offset
        for k in range(_OCTAVES):
            if k == len(self._levels):
                self._levels.append(_Level(self._axes, (_STEPS,)))
            means = self._levels[k].add(means)
            if not len(means):
                break

    def cut(self) -> None:
        """The stretch ends here."""
        self._samples += self._levels[0].count
        self._longest = max(self._longest, self._levels[0].count)
        for level in self._levels:
            level.cut()
        self._offset = None

    def curves(self, interval: float) -> tuple[AllanCurve, ...]:
        """One an axis, for samples every `interval` s; the stretch in hand ends. A variance with
        hardly any freedom is left out."""
        self.cut()
        squares, terms, freedom = (
            np.concatenate([getattr(level, part) for level in self._levels])
            for part in ("squares", "terms", "freedom")
        )
        samples = [m << k for k, level in enumerate(self._levels) for m in level.lengths]
        seen = (terms > 0) & (freedom >= _LEAST_FREEDOM)
        tau, freedom = np.array(samples)[seen] * interval, freedom[seen]
        variance = squares[seen] / (2.0 * terms[seen][:, None])
        seconds = self._samples * interval, self._longest * interval
        return tuple(AllanCurve(tau, variance[:, a], freedom, *seconds) for a in range(self._axes))


def _freedom(points: int, m: int) -> float:
    """Degrees of freedom of the overlapping variance from `points` of the integral: the fewest of
    white, flicker and random walk noise (SP 1065, table 5)."""
    if points < 2 * m + 2:
        return 0.0
    n = float(points)
    white = 3.0 * (n - 1.0) / (2.0 * m) - 2.0 * (n - 2.0) / n
    white *= 4.0 * m * m / (4.0 * m * m + 5.0)
    flicker = 5.0 * n * n / (4.0 * m * (n + 3.0 * m))
    flicker = flicker if m > 1 else 2.0 * (n - 2.0) ** 2 / (2.3 * n - 4.9)
    walk = (n - 2.0) / m * ((n - 1.0) ** 2 - 3.0 * m * (n - 1.0) + 4.0 * m * m) / (n - 3.0) ** 2
    return max(min(white, flicker, walk), 0.0)


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
_FEWEST, _KEPT = 4, 6  # values that a fit needs; that stay where the shortest are left out
_SEEN = 0.5  # share of the variance at some τ that white noise must be, to show
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

    def at_most(self, term: str) -> float:
        """What a term that does not show lies below, 95 %: beside the others where these show,
        else as if all of the variance at some τ were its own."""
        found: Coefficient = getattr(self, term)
        if found.bound is not None:
            return found.bound
        shape = _shape((term,), self.curve.tau)[:, 0]
        return float(np.min(self.curve.interval()[1] / np.sqrt(shape)))


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
    noise = []
    for one in found.values():
        like, curves = one.like, one.sums.curves(1.0 / one.like.rate)
        if len(curves[0].tau) >= _FEWEST and all((c.variance > 0.0).all() for c in curves):
            axes = tuple(map(identified, curves))
            noise.append(SensorNoise(like.triad, like.quantity, like.unit, like.rate, axes))
    return tuple(noise)


class _Collected:
    """The sums of one channel over the rests."""

    def __init__(self, channel: Channel) -> None:
        self.like = channel
        self.sums = AllanSums(channel.values.shape[1])
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
                self.sums.cut()
            self.sums.add(channel.values[part])
        self._last, self._in = float(t[rows[-1]]), int(at[rows[-1]])


def identified(curve: AllanCurve) -> AxisNoise:
    """The coefficients that a curve of four or more values shows; none where no such sum fits it,
    as with lines in the spectrum: then only what the white noise lies below."""
    from scipy.special import chdtrc

    for start in range(max(len(curve.tau) - _KEPT, 0) + 1):
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


def _chosen(curve: AllanCurve, rows: Index) -> tuple[tuple[str, ...], Array]:
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
    names: tuple[str, ...],
    curve: AllanCurve,
    rows: Index,
    held: tuple[str, float] | None = None,
) -> tuple[Array, float]:
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


def _coefficient(name: str, names: tuple[str, ...], curve: AllanCurve, rows: Index) -> Coefficient:
    if name not in names:
        return Coefficient(None, None, _bound(name, names, curve, rows))
    p, _ = _fitted(names, curve, rows)
    shape = _shape(names, curve.tau[rows])
    relative = shape / (shape @ p)[:, None]
    information = relative.T @ (0.5 * curve.freedom[rows, None] * relative)
    at = names.index(name)
    value = float(np.sqrt(p[at]))
    sd = float(np.sqrt(np.linalg.pinv(information, hermitian=True)[at, at])) / (2.0 * value)
    return Coefficient(value, sd * (1.0 if name == "white" else _SHARED), None)


def _bound(name: str, names: tuple[str, ...], curve: AllanCurve, rows: Index) -> float | None:
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


_PREFIX = {"acceleration": "accelerometer", "angular_rate": "gyroscope"}


def noise_blocks(noise: Sequence[SensorNoise]) -> dict[str, dict[str, Any]]:
    """By triad: densities in unit/√Hz and random walks in unit/s/√Hz (SI), each of the noisiest
    axis. Of one that the recording shows on no axis "_at_most" is its upper limit, 95 %."""
    blocks: dict[str, dict[str, Any]] = {}
    for sensor in noise:
        block = blocks.setdefault(sensor.triad, {})
        prefix = _PREFIX[sensor.quantity]
        for name, term in (("noise_density", "white"), ("random_walk", "walk")):
            shown = [getattr(axis, term).value for axis in sensor.axes]
            if known := [value for value in shown if value is not None]:
                block[f"{prefix}_{name}"] = max(known)
            else:
                block[f"{prefix}_{name}_at_most"] = max(axis.at_most(term) for axis in sensor.axes)
        block["rostopic"] = f"/{sensor.triad}/imu"
        block["update_rate"] = sensor.rate
    return blocks


def save_noise(noise: Sequence[SensorNoise], source: str, path: Path) -> None:
    """Write the blocks. One sensor's keys stand alone, as Kalibr reads them; more by name."""
    blocks = noise_blocks(noise)
    lines = [
        f"# Noise at rest of {source}, SI: m/s2/sqrt(Hz), m/s3/sqrt(Hz), rad/s/sqrt(Hz), "
        "rad/s2/sqrt(Hz); of each sensor's noisiest axis.",
        *(
            f"# {name}: the rests do not show all; upper limits (95 %): {', '.join(lost)}"
            for name, block in blocks.items()
            if (lost := [key for key in block if key.endswith("_at_most")])
        ),
    ]
    content = next(iter(blocks.values())) if len(blocks) == 1 else blocks
    text = "\n".join([*lines, dump(content)])
    with replaced_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read_noise(path: Path) -> dict[str, dict[str, Any]]:
    """Blocks by triad; one that stands alone is under "". Raises UnreadableInput for another
    file."""
    content = load(path)
    if isinstance(content, dict) and content:
        if "update_rate" in content:
            return {"": dict(content)}
        if all(isinstance(v, dict) and "update_rate" in v for v in content.values()):
            return {str(k): dict(v) for k, v in content.items()}
    raise UnreadableInput(
        "no noise of sensors",
        where=str(path),
        remedy="write it with `imucal inspect FILE --save-noise FILE`",
    )
