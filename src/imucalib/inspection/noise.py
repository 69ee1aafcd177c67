"""White noise, bias instability and random walk of still sensors, as far as a recording shows them:
a posterior over all of them together, and over the rests that still settle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.data import Data
from imucalib.estimators.allan import SHAPES, draws, find_unexplained, freedom_of, shapes
from imucalib.inspection.allan import AllanCurve, AllanSums
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import Segments
from imucalib.rests.spans import BLUR

_FEWEST = 5  # values that a fit needs
_SHOWN = 0.1  # share of the variance at some τ that a term must be, to show
_ODD = 1.5  # intervals between samples from which on there is a gap
_SENSORS = {"acceleration": "m/s2", "angular_rate": "rad/s"}
_PREFIX = {"acceleration": "accelerometer", "angular_rate": "gyroscope"}


class Coefficient(Data):
    """A term of the noise of one axis, in SI: Q in s, N in 1/√Hz, B, K in 1/s/√Hz, R in 1/s."""

    value: Annotated[float | None, "Median; null where the recording does not show it."]
    low: Annotated[float | None, "Of its 95 % interval."]
    high: float | None
    below: Annotated[float, "What it lies below, 95 %."]
    probability: Annotated[float, "That it is a tenth of the variance at some τ."]


@dataclass(frozen=True)
class AxisNoise:
    """One axis at rest, in SI.

    quantisation : Q, unit s; white : N, unit/√Hz; instability : B, unit; walk : K, unit/s/√Hz
    ramp : R, unit/s; curve : what they were found from
    fit : (3, M) deviation at the curve's τ by their sum: the median, and a 95 % interval
    holds : (M,) which of the curve's τ they explain
    """

    quantisation: Coefficient
    white: Coefficient
    instability: Coefficient
    walk: Coefficient
    ramp: Coefficient
    curve: AllanCurve
    fit: Array
    holds: Flags


@dataclass(frozen=True)
class SensorNoise:
    """The axes of one sensor: its quantity, triad, unit, samples a second, and topic; settles :
    (start, stop) s of rests that are louder than the quietest, which are not used"""

    triad: str
    quantity: str
    unit: str
    rate: float
    axes: tuple[AxisNoise, ...]
    settles: tuple[tuple[float, float], ...]
    topic: str = ""


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
        like, quiet = one.like, one.quiet()
        curves = one.sums.curves(1.0 / like.rate, quiet)
        if len(curves[0].tau) >= _FEWEST and all((c.variance > 0.0).all() for c in curves):
            axes = tuple(map(identify, curves))
            settles = tuple(s for s, q in zip(one.spans, quiet, strict=True) if not q)
            words = (like.triad, like.quantity, like.unit, like.rate)
            noise.append(SensorNoise(*words, axes, settles, like.topic))
    return tuple(noise)


class _Collected:
    """The sums of one channel over the rests, and when each stretch was."""

    def __init__(self, channel: Channel) -> None:
        self.like = channel
        self.sums = AllanSums(channel.values.shape[1])
        self.spans: list[tuple[float, float]] = []
        self._last, self._in = -np.inf, -1

    def add(self, channel: Channel, still: Segments) -> None:
        """The samples of a block that lie in rests, without their ends."""
        t = channel.t
        at = np.searchsorted(still.start + BLUR, t, side="right") - 1
        ends = still.stop[np.maximum(at, 0)] - BLUR if still.n else np.zeros(t.size)
        inside = (at >= 0) & (t <= ends)
        rows = np.flatnonzero(inside)
        if not len(rows):
            return
        step = np.diff(t[rows], prepend=self._last)
        other = np.diff(at[rows], prepend=self._in) != 0
        breaks = np.flatnonzero(other | (step > _ODD / channel.rate) | (step <= 0.0))
        for number, part in enumerate(np.split(rows, breaks)):
            if number:
                self.sums.cut()
            if len(part):
                if number or not self.spans:
                    self.spans.append((float(t[part[0]]), 0.0))
                self.spans[-1] = self.spans[-1][0], float(t[part[-1]])
            self.sums.add(channel.values[part])
        self._last, self._in = float(t[rows[-1]]), int(at[rows[-1]])

    def quiet(self) -> Flags:
        """(S,) which stretches are at rest as the quietest are."""
        self.sums.cut()
        return self.sums.quiet(1.0 / self.like.rate)


def identify(curve: AllanCurve) -> AxisNoise:
    """The coefficients of a curve of five or more values, by the posterior of `draws`.

    One that is a tenth of the variance at some τ in 97.5 % of the draws is told with the median and
    the interval; of any other stands what it lies below under a prior flat in itself.
    """
    rng = np.random.default_rng(0)
    interval = float(curve.tau[0] / curve.samples[0])
    found = draws(curve.samples, curve.variance, curve.forms, interval, rng=rng)
    squares = np.exp(found[:, :5])
    share = squares[:, None, :] * shapes(curve.tau)
    whole = share.sum(axis=2)
    share /= whole[..., None]
    unexplained = find_unexplained(len(curve.tau), found)
    share[unexplained] = 0.0
    shown = np.mean(share.max(axis=1) > _SHOWN, axis=0)
    terms = {
        name: _coefficient(np.sqrt(squares[:, k]), float(shown[k])) for k, name in enumerate(SHAPES)
    }
    middle = np.exp(np.median(found[:, :5], axis=0))
    freedom = freedom_of(middle, curve.tau, curve.forms)
    return AxisNoise(
        **terms,
        curve=replace(curve, freedom=freedom),
        fit=np.quantile(np.sqrt(whole), [0.5, 0.025, 0.975], axis=0),
        holds=np.mean(unexplained, axis=0) < 0.5,
    )


def _coefficient(size: Array, probability: float) -> Coefficient:
    """From draws (n,) under a prior that is flat in the logarithm."""
    order = np.argsort(size)
    rank = np.cumsum(size[order]) / size.sum()
    bound = float(size[order][np.searchsorted(rank, 0.95)])
    if probability < 0.975:
        return Coefficient(None, None, None, bound, probability)
    low, value, high = (float(q) for q in np.quantile(size, [0.025, 0.5, 0.975]))
    return Coefficient(value, low, high, bound, probability)


def noisiest(axes: Sequence[AxisNoise], term: str) -> AxisNoise:
    """The axis that has most of a term: of those that show it, else by what it lies below."""

    def size(axis: AxisNoise) -> tuple[bool, float]:
        own: Coefficient = getattr(axis, term)
        return own.value is not None, own.below if own.value is None else own.value

    return max(axes, key=size)


def noise_blocks(noise: Sequence[SensorNoise]) -> dict[str, dict[str, Any]]:
    """By triad: densities in unit/√Hz and random walks in unit/s/√Hz (SI), each of the noisiest
    axis; "upper_limits" names those that the recording shows on no axis, which lie below what
    stands there with 95 %."""
    blocks: dict[str, dict[str, Any]] = {}
    for sensor in noise:
        block = blocks.setdefault(sensor.triad, {})
        for name, term in (("noise_density", "white"), ("random_walk", "walk")):
            key = f"{_PREFIX[sensor.quantity]}_{name}"
            most: Coefficient = getattr(noisiest(sensor.axes, term), term)
            block[key] = most.below if most.value is None else most.value
            if most.value is None:
                block.setdefault("upper_limits", []).append(key)
        block["rostopic"] = sensor.topic or f"/{sensor.triad}/imu"
        block["update_rate"] = sensor.rate
    return blocks
