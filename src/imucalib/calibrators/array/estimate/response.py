"""How much the readings tell of a joint fit whose weights follow its residuals.

Weights (ν + 3)/(ν + d²) fall where a residual grows, so that a score answers a shift of what is
fitted by less than its weights say: by (ν + 3)/(ν + 5) where residuals are the errors (Lange,
Little, Taylor 1989, JASA 84). The motion of a sample takes a part of few IMUs' errors and may lay
one chip's on another, and then the share is another: of four chips less still. So it is measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.loop.state import ArrayState, corrected
from imucalib.core.eigen import eigen
from imucalib.estimators.array.gram import Columns, gram
from imucalib.estimators.array.noise import SensorNoise
from imucalib.estimators.array.samples import Readings, Sampled, Weights, fit_samples

_SAMPLES = 800  # at which the answer is measured
_ROUNDS = 12  # of weights and motion after a shift
_SHIFT = 3.0  # in standard deviations of each direction
_LEAST = 0.1  # share that is left in any case
_SEEN = 1e-3  # of the best known direction's information, below which one is not shifted


def information(state: ArrayState) -> tuple[float, float]:
    """What accelerometers and gyros tell over what their weights say, by the answer of the scores
    of positions and of gyro offsets to a shift of these: 1 where the noise is Gaussian."""
    if not any(np.isfinite(noise.freedom) for noise in state.noise):
        return 1.0, 1.0
    inner = state.setup.inner
    rows = inner[np.linspace(0, len(inner) - 1, min(_SAMPLES, len(inner))).astype(np.intp)]
    readings = corrected(state).take(rows)
    start = fit_samples(readings, _weights(state.noise, state.sampled, rows), state.r,
                        state.sampled.rate[rows])  # fmt: skip
    answers = _Answers(readings, start, state.noise, state.r)
    return answers.of_positions(), answers.of_offsets()


class _Answers:
    """Scores at a few samples, their weights and motion fitted anew after every shift."""

    def __init__(
        self, readings: Readings, start: Sampled, noise: tuple[SensorNoise, SensorNoise], r: Array
    ) -> None:
        self.readings, self.noise, self.r = readings, noise, r
        self.start = self._followed(readings, start, r)

    def of_positions(self) -> float:
        def score(shift: Array) -> Array:
            r = self.r.copy()
            r[1:] += shift.reshape(-1, 3)
            found = self._followed(self.readings, self.start, r)
            heavy = found.off.acceleration * found.weights.acceleration[..., None]
            return np.asarray(np.einsum("tij,tki->kj", found.turn, heavy)[1:].ravel())

        count = 3 * len(self.r)
        return self._share(score, np.arange(3, count))

    def of_offsets(self) -> float:
        def score(shift: Array) -> Array:
            rate = self.readings.rate - shift.reshape(-1, 3)
            found = self._followed(replace(self.readings, rate=rate), self.start, self.r)
            return np.asarray(np.einsum("tki,tk->ki", found.off.rate, found.weights.rate).ravel())

        count = 3 * len(self.r)
        return self._share(score, np.arange(count, 2 * count))

    @cached_property
    def told(self) -> Array:
        """(6 K, 6 K) what the weights say of all positions and gyro offsets."""
        shape = (len(self.r), len(self.start.rate), 3, 3)
        bases = (np.asarray(np.broadcast_to(x, shape)) for x in (self.start.turn, np.eye(3)))
        blocks = [
            Columns(basis, gyro, False) for gyro, basis in zip((False, True), bases, strict=True)
        ]
        return gram(self.start, blocks, np.arange(shape[1])).matrix

    def _share(self, score: Callable[[Array], Array], at: Index) -> float:
        """Mean share, over directions that weigh alike, by one shift of all of them and back."""
        told = self.told[np.ix_(at, at)]
        values, vectors = eigen(told)
        seen = values > _SEEN * float(values[-1])
        signs = np.where(np.arange(int(seen.sum())) % 2, -1.0, 1.0)
        shift = _SHIFT * (vectors[:, seen] / np.sqrt(values[seen])) @ signs
        answer = 0.5 * (score(-shift) - score(shift))
        return float(np.clip(shift @ answer / (shift @ told @ shift), _LEAST, 1.0))

    def _followed(self, readings: Readings, sampled: Sampled, r: Array) -> Sampled:
        for _ in range(_ROUNDS):
            sampled = fit_samples(readings, _weights(self.noise, sampled), r, sampled)
        return sampled


def _weights(
    noise: tuple[SensorNoise, SensorNoise], sampled: Sampled, rows: Index | slice = slice(None)
) -> Weights:
    speed = np.linalg.norm(sampled.rate[rows], axis=1)
    a, g = (
        one.weight(np.sum(off[rows] ** 2, axis=2), speed)
        for one, off in zip(noise, (sampled.off.acceleration, sampled.off.rate), strict=True)
    )
    return Weights(a, g)
