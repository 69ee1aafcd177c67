"""A model: an immutable tuple of effects. It predicts readings, and corrects them.

reading = x + Σ sensor effects(x),   x = mounting(fixture(truth))
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Effect, Parameter, Truth
from imucalib.errors import NotConverged

_ORDER = {"fixture": 0, "mounting": 1, "sensor": 2}
_SAME = np.eye(3)
#: Rounds of Newton's method, and as many that close in on a jump; m/s², about 20 mg, the largest.
_ROUNDS, _JUMP = 30, 0.2


@dataclass(frozen=True)
class Prediction:
    """reading (n, K, 3); d_theta (n, K, 3, p); d_truth (n, K, 3, 3); force: x (n, K, 3).

    set_up : (n, K, 3) what the fixture makes of the truth; d_set_up : (n, K, 3, 3) by it
    """

    reading: Array
    d_theta: Array
    d_truth: Array
    force: Array
    set_up: Array
    d_set_up: Array


@dataclass(frozen=True)
class Model:
    """Effects in the order in which they act: fixture, mounting, sensor."""

    effects: tuple[Effect, ...]

    def __post_init__(self) -> None:
        ordered = tuple(sorted(self.effects, key=lambda e: _ORDER[e.stage]))
        object.__setattr__(self, "effects", ordered)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(effect.name for effect in self.effects)

    def plus(self, effect: Effect) -> Model:
        return Model((*self.effects, effect))

    def parameters(self, context: Context) -> tuple[Parameter, ...]:
        return tuple(p for effect in self.effects for p in effect.parameters(context))

    def slices(self, context: Context) -> dict[str, slice]:
        """Where each effect's parameters are in θ."""
        found, at = {}, 0
        for effect in self.effects:
            size = len(effect.parameters(context))
            found[effect.name] = slice(at, at + size)
            at += size
        return found

    def start(self, context: Context) -> Array:
        return np.array([p.start for p in self.parameters(context)])

    def predict(self, theta: Array, truth: Array, context: Context) -> Prediction:
        """Readings of the truth (n, K, 3) m/s² and all derivatives."""
        n, k, _ = truth.shape
        slope = np.zeros((n, k, 3, theta.size))
        chain = mounted = np.broadcast_to(_SAME, (n, k, 3, 3))
        x = set_up = truth
        slices = self.slices(context)
        for effect in self.effects:
            if effect.stage == "sensor":
                continue
            part, own = slices[effect.name], theta[slices[effect.name]]
            action = effect.act(own, Truth(x), context)
            step = action.d_x + _SAME
            slope[..., : part.start] = step @ slope[..., : part.start]  # of those that act before
            slope[..., part] = action.d_theta
            chain = step @ chain
            x = x + action.delta
            if effect.stage == "fixture":
                set_up = x
            else:
                mounted = step @ mounted
        reading, response = x.copy(), np.broadcast_to(_SAME, chain.shape).copy()
        turning = theta.size
        for effect in self.effects:
            if effect.stage == "sensor":
                part, own = slices[effect.name], theta[slices[effect.name]]
                action = effect.act(own, Truth(x), context)
                reading += action.delta
                response += action.d_x
                slope[..., part] = action.d_theta
                turning = min(turning, part.start)
        slope[..., :turning] = response @ slope[..., :turning]  # of those that turn the truth
        return Prediction(reading, slope, response @ chain, x, set_up, response @ mounted)

    def correct(self, theta: Array, reading: Array, context: Context) -> Array:
        """The specific force (n, K, 3) in the tool's frame that gives these readings.

        Undoes the sensor effects by Newton's method on each sample and then the mounting; the
        fixture is not undone, since it belongs to the bench. Where the response jumps, no force may
        give a reading: the force at the jump is the answer. Raises NotConverged.
        """
        x, short = reading.copy(), 1.0
        for turn in range(2 * _ROUNDS):
            predicted, response = self._sense(theta, x, context)
            missed = reading - predicted
            # Newton's method leaps to and fro across a jump, ever shorter steps close in on it.
            short *= 1.0 if turn < _ROUNDS else 0.5
            try:
                step = short * np.linalg.solve(response, missed[..., None])[..., 0]
            except np.linalg.LinAlgError:
                raise NotConverged(
                    "the sensor effects cannot be inverted: an axis does not follow the force",
                    remedy="look whether the readings of each axis change with the attitude",
                ) from None
            x = x + step
            if np.abs(step).max(initial=0.0) <= 1e-12 * max(np.abs(x).max(initial=0.0), 1.0):
                break
        if not np.abs(missed).max(initial=0.0) < _JUMP:
            raise NotConverged(
                "the sensor effects cannot be inverted at these readings",
                remedy="they lie outside the range in which the calibration holds",
            )
        return self._unmount(theta, x, context)

    def _sense(self, theta: Array, x: Array, context: Context) -> tuple[Array, Array]:
        """Readings (n, K, 3) of specific force x in the sensor's frame, and their slopes."""
        slices = self.slices(context)
        reading, response = x.copy(), np.broadcast_to(_SAME, (*x.shape, 3)).copy()
        for effect in self.effects:
            if effect.stage == "sensor":
                action = effect.act(theta[slices[effect.name]], Truth(x), context)
                reading += action.delta
                response += action.d_x
        return reading, response

    def _unmount(self, theta: Array, x: Array, context: Context) -> Array:
        slices = self.slices(context)
        for effect in reversed(self.effects):
            if effect.stage == "mounting":
                turn = _SAME + effect.act(theta[slices[effect.name]], Truth(x), context).d_x
                x = np.asarray(np.linalg.solve(turn, x[..., None])[..., 0], np.float64)
        return x
