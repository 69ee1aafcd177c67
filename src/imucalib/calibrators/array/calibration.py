"""The calibration file of an array: positions with their covariance, and every triad's first order.

It has its own schema: the shared one describes a single triad by effects of the catalogue.
"""

from __future__ import annotations

import platform
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from imucalib import __version__
from imucalib.calibrators.array.calibrate import ArrayRun
from imucalib.calibrators.array.corrected import gyro_gains
from imucalib.calibrators.array.frame import BASE
from imucalib.calibrators.array.loop.ages import beats
from imucalib.calibrators.array.loop.at_rest import AT_REST
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.rests import RestFit
from imucalib.effects.record_error import is_record_error
from imucalib.units import DEG

SCHEMA = "imucal/array-calibration"
VERSION = 1
FORMULA = (
    "In board axes (axes of the board file applied): force = inv(gain) (reading - bias), "
    "rate = inv(gyro_gain) (reading - gyro_bias); force_k = s + (Ω(ω)² + Ω(dω/dt)) position_k. "
    "Every effect listed adds what its equation says; gyro_gain holds the gain effects already"
)


def array_calibration(run: ArrayRun) -> dict[str, Any]:
    """Plain types, ready for YAML and JSON."""
    scale, scale_sd = run.final.scale
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "calibrator": "array",
        "status": "marginal" if run.reasons else "ok",
        "reasons": list(run.reasons),
        "formula": FORMULA,
        "board": run.board.name,
        "reference": run.board.imus[0],
        "gravity_m_per_s2": run.request.gravity,
        "positions_mm": _positions(run),
        "covariance_mm2": (1e6 * run.final.covariance).tolist(),
        "size": {
            "relative_to_drawing": scale,
            "sd": scale_sd,
            "sd_from_gyro_tolerance": run.moving.gyros.scale_sd,
        },
        "triads": _triads(run),
        "accelerometer_sigma_in_motion_m_per_s2": run.final.noise,
        "effects": [*rest_effects(run.rests), *(effect_list(run.loop) if run.loop else [])],
        "diagnostics": diagnostics(run),
        "provenance": provenance(run),
    }


def rest_effects(rests: RestFit) -> list[dict[str, Any]]:
    """What was found at rest, with values and standard deviations, plain types."""
    fit = rests.fit
    slices = fit.model.slices(fit.observations.context)
    return [
        {
            "effect": AT_REST + effect.name,
            "declared": False,
            "channel": effect.channel,
            "equation": effect.equation,
            "parameters": [
                {"name": p.name, "unit": p.unit, "value": float(v), "sd": float(s)}
                for p, v, s in zip(
                    fit.parameters[slices[effect.name]], fit.theta[slices[effect.name]],
                    fit.sd[slices[effect.name]], strict=True,
                )
            ],
        }
        for effect in fit.model.effects
        if effect.name not in BASE and not is_record_error(effect.name)
    ]  # fmt: skip


def effect_list(loop: MotionLoop) -> list[dict[str, Any]]:
    """Accepted effects with values and standard deviations, plain types."""
    state = loop.final
    return [
        {
            **_beats(loop, term.aged),
            "effect": term.name,
            "declared": term.name in loop.asked.declare,
            "channel": term.effect.channel,
            "equation": term.effect.equation,
            "parameters": [
                {"name": p.name, "unit": p.unit, "value": float(v), "sd": float(s)}
                for p, v, s in zip(
                    term.parameters(state.setup.imus), term.theta, state.sd_of(term), strict=True
                )
            ],
        }
        for term in state.found
    ]


def _beats(loop: MotionLoop, aged: bool) -> dict[str, Any]:
    """Clocks of the gyros in this recording: they start anew with the power."""
    if not aged or loop.ages is None:
        return {}
    state = loop.final.setup
    return {
        "beats": [
            None if beat is None else {
                "imu": imu, "hz": beat.frequency, "phase_turns": beat.phase, "at_s": beat.at,
                "wander_turns": beat.wander,
            }
            for imu, beat in zip(state.imus, beats(loop.ages, state.t), strict=True)
        ]
    }  # fmt: skip


def _positions(run: ArrayRun) -> list[dict[str, Any]]:
    mean, sd = 1e3 * run.final.mean, 1e3 * run.final.sd
    drawn = 1e3 * run.board.drawn
    return [
        {"imu": name, "mean": mean[k].tolist(), "sd": sd[k].tolist(), "drawn": drawn[k].tolist()}
        for k, name in enumerate(run.board.imus)
    ]


def _triads(run: ArrayRun) -> list[dict[str, Any]]:
    rests = run.rests
    offset = rests.offset(np.array([rests.stop]))[0]
    gains = run.moving.gyros.gain if run.loop is None else gyro_gains(run.loop.final)
    return [
        {
            "imu": name,
            "gain": rests.gain[k].tolist(),
            "gain_sd": rests.gain_sd[k].tolist(),
            "bias_m_per_s2": offset[k].tolist(),
            "noise_m_per_s2": float(rests.noise[k]),
            "gyro_gain": gains[k].tolist(),
            "gyro_bias_deg_per_s": (rests.gyro_bias[0, k] / DEG).tolist(),
            "gyro_noise_deg_per_s": float(rests.gyro_noise[k] / DEG),
        }
        for k, name in enumerate(run.board.imus)
    ]


def diagnostics(run: ArrayRun) -> dict[str, Any]:
    """What the sampler says of itself."""
    found = run.final.convergence
    return {
        "sampler": run.final.sampler,
        "chains": run.final.unknowns.shape[0],
        "draws": run.final.unknowns.shape[1],
        "acceptance": run.final.accepted,
        "largest_rhat": float(np.max(found.rhat)),
        "smallest_bulk_ess": float(np.min(found.bulk)),
        "smallest_tail_ess": float(np.min(found.tail)),
        "largest_mcse_mm": float(1e3 * np.max(found.mcse[: run.final.prior.positions])),
        "samples": run.final.data.samples,
    }


def provenance(run: ArrayRun) -> dict[str, Any]:
    """Enough to compute the result again."""
    import scipy

    request = run.request
    return {
        "path": Path(run.recording.path).name,
        "sha256": run.recording.sha256,
        "settings": {
            "sampler": request.sampler,
            "samples": request.samples,
            "motion_prior": request.motion,
            "determinant_exponent": request.exponent,
            "accelerometer_sigma": request.accelerometer_sigma,
            "gyro_covariance": request.gyro_covariance,
            "prior_sd_mm": 1e3 * run.board.prior_sd,
            "gravity_source": request.gravity_source,
        },
        "seed": request.seed,
        "versions": {
            "imucalib": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
        },
        "time": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
    }
