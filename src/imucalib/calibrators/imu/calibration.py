"""The calibration of an IMU: both sensors' parameters with one covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.calibration.gyroscope import BIAS, GAIN, STAGE
from imucalib.calibration.outcome import Outcome
from imucalib.calibrators.imu.calibrate import ImuResult
from imucalib.estimators.lateness import lateness
from imucalib.estimators.turns import ACCELEROMETER, LOWER, TurnFit
from imucalib.estimators.turns import GAIN as GAINS
from imucalib.inspection.noise import SensorNoise, noise_blocks
from imucalib.units import DEG, MG

#: Effects of the accelerometer that the turns bear on.
_LINEAR = ("bias", "scale", "non_orthogonality")
#: Relative step of a derivative.
_STEP = 1e-6


def imu_calibration(result: ImuResult, outcome: Outcome, details: Mapping[str, Any]) -> Calibration:
    """The accelerometer's calibration as the turns leave it, with the gyroscope's parameters."""
    made, fit = result.accelerometer.calibration, result.fit
    names = [p.effect for p in made.parameters]
    own = np.flatnonzero(np.isin(names, _LINEAR))
    others = np.flatnonzero(~np.isin(names, _LINEAR))
    theta = np.array([made.parameters[int(k)].value for k in own])
    moved = _linear(theta, fit, made.gravity)
    last = fit.state.first_up - 3
    kept = np.r_[: ACCELEROMETER + GAINS + fit.state.theta.size, last : last + 3]
    joint = fit.covariance[np.ix_(kept, kept)]
    slope = np.eye(kept.size)
    slope[:ACCELEROMETER, :ACCELEROMETER] = _slopes(theta, fit, made.gravity)
    slope[-3:, -3:] /= DEG
    joint = slope @ joint @ slope.T
    # What other effects are off by moves the linear ones with them.
    beside = made.covariance[np.ix_(others, others)]
    share = np.linalg.lstsq(beside, made.covariance[np.ix_(others, own)], rcond=None)[0].T
    joint[:ACCELEROMETER, :ACCELEROMETER] += share @ beside @ share.T
    across = np.zeros((kept.size, others.size))
    across[:ACCELEROMETER] = share @ beside
    covariance = np.block([[joint, across], [across.T, beside]])
    gyro = _gyro_parameters(result, joint)
    accelerometer = [
        replace(made.parameters[int(k)], value=float(v), sd=float(np.sqrt(joint[i, i])))
        for i, (k, v) in enumerate(zip(own, moved, strict=True))
    ]
    rest = [made.parameters[int(k)] for k in others]
    parameters = (*accelerometer, *rest, *gyro)
    order = np.r_[
        np.arange(ACCELEROMETER),
        np.arange(kept.size, len(covariance)),
        np.arange(ACCELEROMETER, kept.size),
    ]
    covariance = covariance[np.ix_(order, order)]
    return replace(
        made,
        calibrator="imu",
        parameters=parameters,
        covariance=0.5 * (covariance + covariance.T),
        status=outcome.status,
        reasons=(*outcome.reasons, *outcome.undecided),
        facts={
            **{k: v for k, v in made.facts.items() if k not in ("errors", "provenance")},
            "errors": [error.as_dict() for error in outcome.errors],
            "imu": dict(details["imu"]),
            "noise_density": {"imu0": dict(details["noise_density"])},
            "provenance": outcome.provenance.as_dict(),
        },
    )


def _linear(theta: Array, fit: TurnFit, gravity: float) -> Array:
    """(9,) bias (mg), scale and cross terms of the readings, by those (9,) of the readings that the
    turns were fitted to: S f + c with f as L (f' - b) leaves it."""
    sensitivity, offset = _pieces(theta)
    inverse = np.linalg.inv(fit.state.lower)
    whole = sensitivity @ inverse
    bias = offset + sensitivity @ fit.state.bias * gravity
    return np.array([*(bias / MG), *(np.diag(whole) - 1.0), whole[1, 0], whole[2, 0], whole[2, 1]])


def _pieces(theta: Array) -> tuple[Array, Array]:
    """S and c (m/s²), as the effects bias, scale and non_orthogonality have them."""
    sensitivity = np.diag(1.0 + theta[3:6])
    sensitivity[[1, 2, 2], [0, 0, 1]] = theta[6:9]
    return sensitivity, MG * theta[:3]


def _slopes(theta: Array, fit: TurnFit, gravity: float) -> Array:
    """(9, 9) of `_linear` by the turns' bias and `LOWER`."""
    out = np.zeros((ACCELEROMETER, ACCELEROMETER))
    start = _linear(theta, fit, gravity)
    for k in range(ACCELEROMETER):
        bias, lower = fit.state.bias.copy(), fit.state.lower.copy()
        if k < 3:
            bias[k] += _STEP
        else:
            lower[LOWER[k - 3]] += _STEP
        moved = replace(fit, state=replace(fit.state, bias=bias, lower=lower))
        out[:, k] = (_linear(theta, moved, gravity) - start) / _STEP
    return out


def _gyro_parameters(result: ImuResult, joint: Array) -> list[StoredParameter]:
    state = result.fit.state
    sd = np.sqrt(np.diag(joint))[ACCELEROMETER:]
    names = [(f"gyro_gain_{a}{b}", GAIN, "1") for a in "xyz" for b in "xyz"]
    for term in () if result.refused else result.found.terms:
        each = [term.effect.each[int(k)] for k in term.own]
        names += [(p.name, term.name, p.unit) for p in each]
    names += [(f"gyro_rest_bias_{a}", BIAS, "deg/s") for a in "xyz"]
    values = np.r_[state.gain.ravel(), state.theta, state.drift[-1] / DEG]
    return [
        StoredParameter(name, effect, STAGE, float(v), float(s), unit)
        for (name, effect, unit), v, s in zip(names, values, sd, strict=True)
    ]


def imu_details(result: ImuResult) -> dict[str, Any]:
    """What only an IMU has to say, for report.json; `imu` also for the YAML."""
    imu, fit = result.imu, result.fit
    held = result.held_out
    return {
        **result.accelerometer.details,
        "imu": {
            "frame": "of the accelerometer: x along its x axis, y in the plane of its x and y",
            "sample_interval_s": 1.0 / result.noise[0].rate if result.noise else None,
            "turns": len(imu.turns.turns),
            "turns_left_out": list(imu.left_out),
            "rests": imu.turns.rests,
            "gyroscope_noise": _gyro_noise(result.noise),
            "bias_walk_deg_per_s_per_root_s": (fit.noise.walk / DEG).tolist(),
            "gyroscope_late_s": dict(zip(("value", "sd"), lateness(fit), strict=True)),
            "turn_floor_deg": fit.noise.floor / DEG,
            "turn_error_per_angle": fit.noise.per_angle,
        },
        "noise_density": {
            key: value
            for block in noise_blocks(result.noise).values()
            for key, value in block.items()
        },
        "held_out_turns_deg": {
            name: getattr(held, name).tolist() for name in ("raw", "base", "final")
        },
    }


def _gyro_noise(noise: Sequence[SensorNoise]) -> dict[str, Any]:
    """Of the gyroscope at rest, by axis: white noise and the bias instability, or what each is at
    most where the rests do not show it; such a white noise has no sd."""
    axes = next((s.axes for s in noise if s.quantity == "angular_rate"), ())
    shown = [axis.instability.value for axis in axes]
    return {
        "rest_s": max((axis.curve.longest for axis in axes), default=0.0),
        "white_deg_per_s_per_root_hz": [
            (axis.white.value or axis.at_most("white")) / DEG for axis in axes
        ],
        "white_sd": [axis.white.sd / DEG if axis.white.sd else None for axis in axes],
        "bias_instability_deg_per_s": [
            (value or axis.at_most("instability")) / DEG
            for value, axis in zip(shown, axes, strict=True)
        ],
        "upper_limit": None in shown,
    }
