"""The run of a board over several logs: one estimate, one calibration, and how far logs agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.outcome import ErrorSummary, HeldOutError, Limit, Outcome, Run
from imucalib.calibration.provenance import provenance_of
from imucalib.calibration.triads import Triad
from imucalib.calibrators.array.calibration import instrument_block, of_positions
from imucalib.calibrators.array.effect_blocks import covariance_of, effect_blocks, triangle
from imucalib.calibrators.array.estimate.total import (
    GyroScale,
    Total,
    frame_sd,
    gravity_sd,
    gyro_scale,
    size_block,
    total_of,
)
from imucalib.calibrators.array.estimate.turns import Turns
from imucalib.calibrators.array.logs.pooled import Pooled, Repeat, pooled, repeats
from imucalib.calibrators.array.run import ArrayRun
from imucalib.errors import UsageError


def board_details(
    runs: Sequence[ArrayRun],
    found: Pooled,
    total: Total,
    gyros: GyroScale,
    kinds: Sequence[Repeat],
) -> dict[str, Any]:
    """Agreement, pooled positions, what repeats, and what every log has by itself."""
    board = runs[0].board
    mean, sd, drawn = (1e3 * v for v in (total.mean, total.sd, board.drawn))
    new = np.sqrt(np.diag(found.new(np.mean([r.total.motion for r in runs], axis=0))))
    between = 1e3 * np.concatenate([np.zeros(3), found.between]).reshape(-1, 3)
    return {
        "board": board.name,
        "reference": board.imus[0],
        "logs": [_log(run, float(z)) for run, z in zip(runs, found.left_out, strict=True)],
        "agreement": {
            "chi2": found.chi2,
            "degrees_of_freedom": found.freedom,
            "p": found.p,
            "tau_mm": 1e3 * found.tau,
            "left_out_z_rms": float(np.sqrt(np.mean(found.left_out**2))),
            "new_log_sd_mm": float(1e3 * np.sqrt(np.mean(new**2))),
        },
        "positions_mm": [
            {
                "imu": name,
                "mean": mean[k].tolist(),
                "sd": sd[k].tolist(),
                "drawn": drawn[k].tolist(),
                "between_logs": between[k].tolist(),
            }
            for k, name in enumerate(board.imus)
        ],
        **size_block(total, gyros, board),
        **instrument_block(board, runs[0].moving.interval),
        "effects": _effects(runs[0], kinds),
        "repeats": [_kind(one) for one in kinds],
    }


def _log(run: ArrayRun, z: float) -> dict[str, Any]:
    """What belongs to one power-up."""
    made = run.outcome.provenance
    effects = effect_blocks(run.loop) if run.loop is not None else []
    return {
        "input": made.path,
        "sha256": made.sha256,
        "z_rms_of_positions_by_the_others": z,
        "accelerometer_bias_m_per_s2": {t.name: t.bias.tolist() for t in run.calibration.triads},
        "gyro_bias_deg_per_s": {
            t.name: np.rad2deg(t.gyro_bias).tolist() for t in run.calibration.triads
        },
        "beats": [b for e in effects for b in e.get("beats", ()) if b is not None],
    }


def _effects(run: ArrayRun, kinds: Sequence[Repeat]) -> list[dict[str, Any]]:
    """Effects that every log has found, with their pooled values; beats are of each log."""
    pooled = {one.name: one.found for one in kinds}
    blocks = effect_blocks(run.loop) if run.loop is not None else []
    found = []
    for block in blocks:
        if (one := pooled.get(block["effect"])) is None:
            continue
        sd = np.sqrt(np.diag(one.covariance) + one.tau**2)
        # Numbers are pooled one by one; how they go together is the first log's word.
        first = covariance_of(block)
        share = sd / np.sqrt(np.maximum(np.diag(first), 1e-300))
        own = zip(block["parameters"], one.mean, sd, strict=True)
        parameters = [{**p, "value": float(v), "sd": float(s)} for p, v, s in own]
        kept = {k: v for k, v in block.items() if k != "beats"}
        together = first * np.outer(share, share)
        together[np.diag_indices_from(together)] = sd**2
        found.append({**kept, "parameters": parameters, "covariance": triangle(together)})
    return found


def _kind(one: Repeat) -> dict[str, Any]:
    """Numbers that repeat come pooled, others with every log's own."""
    found = one.found
    block: dict[str, Any] = {
        "what": one.name,
        "unit": one.unit,
        "between_logs_rms": one.between,
        "stated_rms": one.stated,
        "tau": found.tau,
        "p": found.p,
        "repeats": one.holds,
        "names": list(one.each),
    }
    if one.holds:
        sd = np.sqrt(np.diag(found.covariance))
        return {**block, "pooled": found.mean.tolist(), "sd": sd.tolist()}
    return {**block, "of_each_log": one.values.tolist()}


_DIFFER = 1e-3  # p of the agreement below which logs are said to differ by more than they state


@dataclass(frozen=True, kw_only=True)
class BoardRun(Run):
    """Several logs put together: motion's positions pooled, total with size and frame; repeats :
    which other numbers hold from log to log"""

    runs: tuple[ArrayRun, ...]
    pooled: Pooled
    total: Total
    gyros: GyroScale
    repeats: tuple[Repeat, ...]


def board_run(runs: tuple[ArrayRun, ...]) -> BoardRun:
    """Raises UsageError unless these are two or more logs of one board."""
    if len(runs) < 2 or len({run.board.imus for run in runs}) > 1:
        raise UsageError("a joint estimate needs two or more logs of one board")
    found = pooled(
        np.array([run.total.by_motion[1:].ravel() for run in runs]),
        np.array([run.total.motion for run in runs]),
    )
    request = runs[0].request
    gyros = _common_scale(runs)
    total = total_of(
        np.concatenate([np.zeros((1, 3)), found.mean.reshape(-1, 3)]),
        found.covariance,
        scale=gyros.value,
        scale_sd=gyros.sd,
        gravity_sd=gravity_sd(request.gravity_source),
        frame_sd=float(np.sqrt(np.mean([frame_sd(run.rests) ** 2 for run in runs]))),
        distances=request.distances,
    )
    kinds = repeats(runs)
    outcome = _outcome(runs, found, total)
    details = board_details(runs, found, total, gyros, kinds)
    return BoardRun(
        outcome=outcome,
        calibration=_calibration(runs, outcome, details, total, gyros),
        details=details,
        runs=runs,
        pooled=found,
        total=total,
        gyros=gyros,
        repeats=kinds,
    )


def _common_scale(runs: Sequence[ArrayRun]) -> GyroScale:
    """Every log's turns together; data sheets say the same in all logs and count once."""
    turns = [run.gyros.turns for run in runs if run.gyros.turns is not None]
    if not turns:
        return runs[0].gyros
    weight = np.array([t.sd**-2.0 for t in turns])
    scale = float(weight @ [t.scale for t in turns] / weight.sum())
    chi2 = float(weight @ [(t.scale - scale) ** 2 for t in turns])
    wide = max(1.0, chi2 / max(len(turns) - 1, 1))
    whole = Turns(
        scale,
        float(np.sqrt(wide / weight.sum())),
        sum(t.count for t in turns),
        float(np.sqrt(np.mean([t.misfit**2 for t in turns]))),
        float(np.median([t.angle for t in turns])),
    )
    return gyro_scale(runs[0].gyros.tolerance, whole)


def _outcome(runs: tuple[ArrayRun, ...], found: Pooled, total: Total) -> Outcome:
    stated = np.array([np.diag(run.total.motion) for run in runs])
    nan = float("nan")
    error = ErrorSummary(
        metric="positions of a log by the others, rms",
        unit="mm",
        raw=nan,
        base=nan,
        final=nan,
        floor=float(1e3 * np.sqrt(np.mean(stated))),
        held_out=HeldOutError(nan, nan, float(1e3 * np.sqrt(np.mean(found.missed**2)))),
    )
    first = runs[0].outcome.provenance
    made = provenance_of(
        path=first.path,
        sha256=first.sha256,
        samples=first.samples,
        mapping=first.mapping,
        settings={
            **first.settings,
            "logs": [
                {"input": run.outcome.provenance.path, "sha256": run.outcome.provenance.sha256}
                for run in runs
            ],
        },
        seed=first.seed,
        gaps=first.gaps,
        command=first.command,
    )
    reasons: tuple[str, ...] = ()
    if found.p < _DIFFER:
        reasons = (
            f"the logs differ by more than they state: χ² {found.chi2:.0f} of {found.freedom} "
            f"(p {found.p:.1g}); {1e3 * found.tau:.2g} mm that differ from log to log are in what "
            "is stated",
        )
    limits = runs[0].request.limits
    return Outcome(
        calibrator="array",
        errors=(error,),
        provenance=made,
        reasons=reasons,
        limits=tuple(
            Limit(name, 1e3 * float(total.sd.max()), limit, "mm")
            for name, limit in limits.items()
            if name == "max-position-sd"
        ),
    )


def _calibration(
    runs: tuple[ArrayRun, ...],
    outcome: Outcome,
    details: dict[str, Any],
    total: Total,
    gyros: GyroScale,
) -> Calibration:
    first = runs[0]
    return of_positions(
        outcome,
        total,
        first.board.imus,
        gravity=first.rests.gravity,
        facts=details,
        triads=tuple(_triad(runs, k, gyros) for k in range(first.board.count)),
    )


def _triad(runs: tuple[ArrayRun, ...], k: int, gyros: GyroScale) -> Triad:
    """One IMU: gains pooled; biases, which are anew at every power-up, as the logs' mean with what
    they differ by."""
    own = [run.calibration.triads[k] for run in runs]
    covariance = np.zeros((12, 12))
    blocks = (
        (slice(0, 9), np.array([t.gain.ravel() for t in own])),
        (slice(9, 12), np.array([t.bias for t in own])),
    )
    means = []
    for at, values in blocks:
        floor = 1e-18 * np.eye(values.shape[1])
        found = pooled(values, np.array([t.covariance[at, at] + floor for t in own]))
        anew = found.tau**2 if at.start else 0.0
        covariance[at, at] = found.covariance + anew * np.eye(values.shape[1])
        means.append(found.mean)
    scale = [(1.0 + gyros.value) / (1.0 + run.gyros.value) for run in runs]
    return Triad(
        name=own[0].name,
        rotation=own[0].rotation,
        gain=means[0].reshape(3, 3),
        bias=means[1],
        gyro_gain=np.mean([s * t.gyro_gain for s, t in zip(scale, own, strict=True)], axis=0),
        gyro_bias=np.mean([t.gyro_bias for t in own], axis=0),
        covariance=covariance,
        noise=float(np.sqrt(np.mean([t.noise**2 for t in own]))),
        gyro_noise=float(np.sqrt(np.mean([t.gyro_noise**2 for t in own]))),
        channel=own[0].channel,
    )
