"""A log of one IMU that is turned by hand from rest to rest, with planted effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.imu.laws import exposure
from imucalib.calibrators.imu.log import LogCourse
from imucalib.calibrators.imu.plan import ANGLE
from imucalib.calibrators.imu.request import gyro_effects
from imucalib.errors import UsageError
from imucalib.estimators.carried import attitudes
from imucalib.recording.recording import Channel, Recording
from imucalib.units import DEG, MG, STANDARD_GRAVITY

_TURN = 1.6  # s


@dataclass(frozen=True)
class ImuPlan:
    """rests : their number, of `still` s each, by turns of 135 deg between; rate : Hz
    noise : mg and gyro_noise : deg/s of a sample; late : s; planted : effects of the gyroscope by
    name, in their units; gain, bias, gyro_bias : sd of what a chip is off (1, mg, deg/s)"""

    rests: int = 20
    still: float = 2.5
    rate: float = 100.0
    noise: float = 3.0
    gyro_noise: float = 0.06
    late: float = 0.0
    planted: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    gain: float = 0.012
    bias: float = 20.0
    gyro_bias: float = 1.0


def simulate_imu(plan: ImuPlan, rng: np.random.Generator) -> tuple[Recording, Array]:
    """The log, and the gains (3, 3) K that the gyroscope truly has, in the accelerometer's frame.
    Raises UsageError for an effect that is no gyroscope's."""
    turns = plan.rests - 1
    span = plan.rests * plan.still + turns * _TURN
    fine = np.arange(round(span * plan.rate) * 4 + 1) / (4.0 * plan.rate)
    rate = _by_hand(plan, fine, rng)
    whole = attitudes(fine, rate)
    up = whole.transpose(0, 2, 1)[:, :, 2]
    t = fine[::4]
    rate, up = rate[::4], up[::4]
    sensing = np.eye(3) + np.tril(rng.normal(size=(3, 3))) * plan.gain
    force = STANDARD_GRAVITY * up @ sensing.T + rng.normal(size=3) * plan.bias * MG
    gain = np.eye(3) + rng.normal(size=(3, 3)) * plan.gain
    late = np.stack([np.interp(t - plan.late, t, v) for v in rate.T], axis=1)
    own = late @ np.linalg.inv(gain).T
    read = own + _plant_rates(plan.planted, own, up, t) + rng.normal(size=3) * plan.gyro_bias * DEG
    read += rng.normal(size=read.shape) * plan.gyro_noise * DEG
    force += rng.normal(size=force.shape) * plan.noise * MG
    channels = {
        f"imu0/{quantity}": Channel(t, values, unit, quantity, "imu0", plan.rate)
        for quantity, unit, values in (
            ("acceleration", "m/s2", force),
            ("angular_rate", "rad/s", read),
        )
    }
    return Recording(channels, "simulated", "simulated", ""), gain


def _by_hand(plan: ImuPlan, t: Array, rng: np.random.Generator) -> Array:
    """(n, 3) rad/s: 135 deg about x, y and z in turn, every second round backwards, along the path
    of least jerk, by a hand that misses the axis and wobbles."""
    rate = np.zeros((len(t), 3))
    for k in range(plan.rests - 1):
        x = (t - plan.still - k * (plan.still + _TURN)) / _TURN
        inside = (x > 0.0) & (x < 1.0)
        bump = 30.0 * x**2 * (1.0 - x) ** 2 * inside / _TURN
        vector = (-1.0 if k // 3 % 2 else 1.0) * ANGLE * np.eye(3)[k % 3]
        vector = vector + 0.15 * rng.normal(size=3)
        wobble = 0.3 * np.sin(2.0 * np.pi * rng.uniform(1.5, 3.0, 3) * x[:, None] * _TURN)
        rate += bump[:, None] * (vector + wobble * rng.normal(size=3))
    return rate


def _plant_rates(
    planted: Mapping[str, tuple[float, ...]], rate: Array, up: Array, t: Array
) -> Array:
    """(n, 3) rad/s that effects add to what a gyroscope's axes turn by."""
    known, added = gyro_effects({}), np.zeros(rate.shape)
    truth, context = exposure(rate, up, t, LogCourse(np.zeros(1), t[-1:], t, None))
    for name, values in planted.items():
        effect = known.get(name)
        if effect is None or effect.missing(context):
            able = (n for n, e in known.items() if not e.missing(context))
            raise UsageError(f"cannot plant {name}", remedy=f"known: {', '.join(able)}")
        if len(values) not in (1, len(effect.each)):
            raise UsageError(f"{name} takes one value, or {len(effect.each)}")
        theta = np.broadcast_to(np.array(values), (len(effect.each),))
        added += effect.basis(truth, context)[:, 0] @ theta
    return added
