"""The gyroscope of an IMU's calibration: stored as parameters, and what it does to a rate.

    ω = K (w - b - Σ_j θ_j h_j),   h_j at what the gyroscope's axes are exposed to

in the frame of the accelerometer. Parameters of stage "gyroscope": `gyro_gain` (K, rows first),
`gyro_rest_bias` (b), and those of effects that were found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.calibration import Calibration
from imucalib.core.effect import Context, Motion, Response, Truth
from imucalib.effects import known
from imucalib.errors import UnreadableInput
from imucalib.recording.recording import Channel, Recording
from imucalib.recording.sensors import angular_rate
from imucalib.rests.thermal import temperature_at
from imucalib.units import DEG, STANDARD_GRAVITY

STAGE, GAIN, BIAS = "gyroscope", "gyro_gain", "gyro_rest_bias"
_SURE = 3.0  # sd from which on a delay is told
#: Rounds in which what an effect adds is subtracted from what it acts on.
_ROUNDS = 3


@dataclass(frozen=True)
class Gyroscope:
    """gain : (3, 3) K; bias : (3,) rad/s, at the end of what was calibrated
    laws : effects with the parameters (w,) that they have, and these (w,) in their units
    warm : °C that it has where no thermometer says"""

    gain: Array
    bias: Array
    laws: tuple[tuple[Response, Index, Array], ...]
    warm: float

    def rate(self, reading: Array, force: Array, warm: Array | None = None) -> Array:
        """Angular rate (n, 3) rad/s in the accelerometer's frame, of readings (n, 3) rad/s under
        forces (n, 3) m/s², at temperatures (n,) °C. What follows the order of a recording acts as
        at its end."""
        seen = own = reading - self.bias
        heat = np.full(len(seen), self.warm) if warm is None else warm
        for _ in range(_ROUNDS if self.laws else 0):
            own = seen - self.evaluate_laws(own, force, heat)
        return np.asarray(own @ self.gain.T)

    def evaluate_laws(self, rate: Array, force: Array, warm: Array) -> Array:
        """(n, 3) rad/s that laws add to a reading, of what the axes are exposed to."""
        none = np.zeros((len(rate), 1, 3))
        known = {"order": np.ones(len(rate)), "temperature": warm}
        context = Context(len(rate), known, moving=True)
        truth = Truth(force[:, None], Motion(rate[:, None], none, none))
        each = (e.basis(truth, context)[:, 0][..., at] @ theta for e, at, theta in self.laws)
        return np.asarray(sum(each, np.zeros(rate.shape)))

    @property
    def by_force(self) -> Array:
        """(3, 3) rad/s per m/s², what a force adds to a reading."""
        out = np.zeros(9)
        for effect, at, theta in self.laws:
            if effect.name == "gyro_g_sensitivity":
                out[at] = theta
        return out.reshape(3, 3) * DEG / STANDARD_GRAVITY


def gyroscope_of(calibration: Calibration) -> Gyroscope | None:
    """The gyroscope, or None where the calibration has none. Raises UnreadableInput for an effect
    that this version does not know."""
    own: dict[str, dict[str, float]] = {}
    for p in calibration.parameters:
        if p.stage == STAGE:
            own.setdefault(p.effect, {})[p.name] = p.value
    if GAIN not in own or BIAS not in own:
        return None
    laws = []
    for name, values in own.items():
        if name in (GAIN, BIAS):
            continue
        effect = known(name)
        if not isinstance(effect, Response):
            raise UnreadableInput(
                f"the calibration uses the unknown effect {name}",
                remedy="load the file that defines it with --effects, or update imucal",
            )
        names = [p.name for p in effect.each]
        at = np.array([names.index(n) for n in values], np.intp)
        laws.append((effect, at, np.array(list(values.values()))))
    return Gyroscope(
        gain=np.array(list(own[GAIN].values())).reshape(3, 3),
        bias=DEG * np.array(list(own[BIAS].values())),
        laws=tuple(laws),
        warm=0.5 * sum(calibration.valid.get("temperature", (25.0, 25.0))),
    )


def read_delay(calibration: Calibration) -> tuple[float, float] | None:
    """s by which the gyroscope is late against its accelerometer, and its standard deviation; None
    where it is no more than chance."""
    known = calibration.facts.get("imu", {}).get("gyroscope_late_s")
    if known is None or abs(known["value"]) < _SURE * known["sd"]:
        return None
    return float(known["value"]), float(known["sd"])


def correct_rates(
    gyro: Gyroscope, recording: Recording, triad: str, thermometer: Channel | None
) -> Recording:
    """A recording whose acceleration is corrected, with the rates of the same sensor corrected too;
    rates that are not in rad/s stay, which is noted."""
    channels, notes = dict(recording.channels), list(recording.notes)
    force, channel = channels[f"{triad}/acceleration"], angular_rate(recording, triad)
    if channel is not None:
        name = next(n for n, c in channels.items() if c is channel)
        if channel.unit != "rad/s":
            notes.append(f"{name}: rates in {channel.unit} stay as they are")
        elif channel.t.size:
            warm = None if thermometer is None else temperature_at(thermometer, channel.t)
            values = gyro.rate(channel.values, at_times(channel.t, force), warm)
            channels[name] = replace(channel, values=values)
            notes.append(f"{name} corrected too; both are in the accelerometer's frame")
    return replace(recording, channels=channels, notes=tuple(notes))


def at_times(t: Array, channel: Channel) -> Array:
    """(n, 3) a channel at other times (n,) s, linearly between its samples."""
    if len(t) == len(channel.t) and np.array_equal(t, channel.t):
        return channel.values
    return np.stack([np.interp(t, channel.t, channel.values[:, k]) for k in range(3)], axis=1)
