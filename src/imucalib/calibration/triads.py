"""The IMUs of an array: each one's linear correction, stored and applied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.data import fields
from imucalib.errors import UnreadableInput, UsageError
from imucalib.recording.pairing import Pairing, pair
from imucalib.recording.recording import Channel, Recording
from imucalib.units import DEG

#: Digits of a covariance in the file: an array of many IMUs has a hundred thousand.
_DIGITS = 9
#: What the drift while it was calibrated is called among the effects that are not undone later.
DRIFT = "drift of the rests"


@dataclass(frozen=True)
class Triad:
    """One IMU in board axes: force = gain⁻¹ (rotation·reading - bias), and the same for the rate.

    rotation : (3, 3), package axes to board axes; gain, gyro_gain : (3, 3)
    bias : (3,) m/s²; gyro_bias : (3,) rad/s; noise : m/s², gyro_noise : rad/s, of a sample at rest
    covariance : (12, 12) of the gain (9, rows first) and the bias (3, m/s²)
    channel : what the calibrated recording calls it: topic, dataset, or a name of its own
    """

    name: str
    rotation: Array
    gain: Array
    bias: Array
    gyro_gain: Array
    gyro_bias: Array
    covariance: Array
    noise: float
    gyro_noise: float
    channel: str = ""

    def force(self, reading: Array) -> Array:
        """Specific force (n, 3) m/s² in board axes from readings (n, 3) m/s² in package axes."""
        return np.asarray((reading @ self.rotation.T - self.bias) @ np.linalg.inv(self.gain).T)

    def reading(self, force: Array) -> Array:
        """Readings (n, 3) m/s² in package axes of specific forces (n, 3) m/s² in board axes."""
        return np.asarray((force @ self.gain.T + self.bias) @ self.rotation)

    def rate(self, reading: Array) -> Array:
        """Angular rate (n, 3) rad/s in board axes from readings (n, 3) rad/s in package axes."""
        turned = reading @ self.rotation.T - self.gyro_bias
        return np.asarray(turned @ np.linalg.inv(self.gyro_gain).T)

    def force_covariance(self, force: Array) -> Array:
        """(n, 3, 3) (m/s²)² of corrected forces (n, 3) m/s² in board axes."""
        slope = np.linalg.inv(self.gain) @ gain_and_bias_slope(force)
        return np.asarray(np.einsum("nip,pq,njq->nij", slope, self.covariance, slope))

    def as_dict(self) -> dict[str, Any]:
        """The block of calibration.yaml and report.json."""
        sd = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return {
            **fields(self, "imu=name channel" if self.channel else "imu=name"),
            **fields(self, "rotation gain"),
            "gain_sd": sd[:9].reshape(3, 3).tolist(),
            **fields(self, "bias_m_per_s2=bias covariance noise_m_per_s2=noise gyro_gain"),
            "gyro_bias_deg_per_s": (self.gyro_bias / DEG).tolist(),
            "gyro_noise_deg_per_s": self.gyro_noise / DEG,
        }


def gain_and_bias_slope(force: Array) -> Array:
    """(n, 3, 12) of a reading in board axes by the gain (9, rows first) and the bias, at forces
    (n, 3)."""
    by_gain = np.einsum("ij,nk->nijk", np.eye(3), force).reshape(-1, 3, 9)
    by_bias = np.broadcast_to(np.eye(3), (len(force), 3, 3))
    return np.concatenate([by_gain, by_bias], axis=2)


def triad_from(block: Mapping[str, Any]) -> Triad:
    """A triad from its block; raises KeyError, TypeError or ValueError where it is damaged."""

    def array(key: str, *shape: int) -> Array:
        return np.array(block[key], dtype=float).reshape(shape)

    return Triad(
        name=str(block["imu"]),
        rotation=array("rotation", 3, 3),
        gain=array("gain", 3, 3),
        bias=array("bias_m_per_s2", 3),
        gyro_gain=array("gyro_gain", 3, 3),
        gyro_bias=array("gyro_bias_deg_per_s", 3) * DEG,
        covariance=array("covariance", 12, 12),
        noise=float(block["noise_m_per_s2"]),
        gyro_noise=float(block["gyro_noise_deg_per_s"]) * DEG,
        channel=str(block.get("channel", "")),
    )


def triangle(covariance: Array) -> list[list[float]]:
    """Rows of a covariance up to its diagonal, for a file."""
    return [
        [float(f"{value:.{_DIGITS}g}") for value in row[: k + 1]]
        for k, row in enumerate(covariance)
    ]


def effect_covariance(block: Mapping[str, Any]) -> Array:
    """(p, p) covariance of a found effect's parameters, in their units, as its block states it; of
    a file that has sds alone, that of parameters by themselves.

    Raises ValueError where it does not fit the parameters.
    """
    sd = np.array([float(p.get("sd") or 0.0) for p in block["parameters"]])
    rows, name = block.get("covariance"), block["effect"]
    if rows is None:
        return np.diag(sd**2)
    if [len(row) for row in rows] != list(range(1, len(sd) + 1)):
        raise ValueError(f"the covariance of {name} does not fit its {len(sd)} parameters")
    found = np.zeros((len(sd), len(sd)))
    for k, row in enumerate(rows):
        found[k, : k + 1] = found[: k + 1, k] = row
    if not np.allclose(np.sqrt(np.maximum(np.diag(found), 0.0)), sd, rtol=1e-6, atol=1e-12):
        raise ValueError(f"the standard deviations of {name} contradict its covariance")
    return found


def pair_triads(triads: Sequence[Triad], recording: Recording) -> Pairing:
    """The triad of each of the recording's accelerometers. Errors as in `pairing.paired`."""
    return pair([(t.name, t.channel) for t in triads], recording, "the calibration")


def select_triads(
    triads: Sequence[Triad], partner: Mapping[str, int], only: str = ""
) -> dict[str, Triad]:
    """The triad of each recorded sensor that is wanted, by the recording's name.

    only : the one IMU that is wanted, by either name, or empty for all. Raises UsageError where
    there is no such one.
    """
    chosen = {r: triads[k] for r, k in partner.items() if only in ("", r, triads[k].name)}
    if not chosen:
        known = ", ".join(f"{r} ({triads[k].name})" for r, k in partner.items())
        raise UsageError(f"no IMU '{only}'", remedy=f"name one with --sensor: {known}")
    return chosen


def drift_block(t: Array, offset: Array) -> dict[str, Any]:
    """What an array's accelerometers drifted by while they were calibrated, as calibration.yaml has
    it below `rests`. Another recording has its own drift, and keeps the mean biases.

    t : (m,) s of the calibrated recording; offset : (m, K, 3) m/s² of readings in the sensors' own
    axes, beyond their mean; straight between, and beyond the ends as there
    """
    return {"t_s": t.tolist(), "m_per_s2": np.round(offset, 7).tolist()}


def undo_drift(
    recording: Recording, partner: Mapping[str, int], drift: Mapping[str, Any]
) -> Recording:
    """The recording that was calibrated with its accelerations as they would read without the
    drift. partner : recorded sensor -> index of its triad; drift : as of `drift_block`"""
    t, offset = np.array(drift["t_s"], float), np.array(drift["m_per_s2"], float)
    channels = dict(recording.channels)
    for name, channel in recording.channels.items():
        if channel.quantity == "acceleration" and channel.triad in partner:
            own = offset[:, partner[channel.triad]].T
            more = np.stack([np.interp(channel.t, t, axis) for axis in own], axis=1)
            channels[name] = replace(channel, values=channel.values - more)
    return replace(recording, channels=channels)


def correct_triads(chosen: Mapping[str, Triad], recording: Recording) -> dict[str, Channel]:
    """The channels of a recording with its IMUs' readings corrected, in board axes.

    chosen : as of `select_triads`. Raises UnreadableInput for acceleration that is not in m/s²;
    rates that are not in rad/s stay as they are.
    """
    channels = dict(recording.channels)
    for name, channel in recording.channels.items():
        if channel.triad not in chosen:
            continue
        triad = chosen[channel.triad]
        if channel.quantity == "acceleration":
            if channel.unit != "m/s2":
                raise UnreadableInput(
                    f"the acceleration of {channel.triad} has no scale (unit {channel.unit})",
                    where=recording.path,
                    remedy="give --acc-unit, or --acc-unit counts with --lsb",
                )
            channels[name] = replace(channel, values=triad.force(channel.values))
        elif channel.quantity == "angular_rate" and channel.unit == "rad/s":
            channels[name] = replace(channel, values=triad.rate(channel.values))
    return channels
