"""What several logs say together, in plain types, for report.json and calibration.yaml."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from imucalib.calibrators.array.calibration import instrument_block
from imucalib.calibrators.array.effect_blocks import covariance_of, effect_blocks, triangle
from imucalib.calibrators.array.estimate.blocks import size_block
from imucalib.calibrators.array.estimate.size import GyroScale
from imucalib.calibrators.array.estimate.total import Total
from imucalib.calibrators.array.logs.pooled import Pooled
from imucalib.calibrators.array.logs.repeats import Repeat
from imucalib.calibrators.array.run import ArrayRun


def board_details(
    runs: Sequence[ArrayRun], found: Pooled, total: Total, gyros: GyroScale,
    kinds: Sequence[Repeat],
) -> dict[str, Any]:  # fmt: skip
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
            {"imu": name, "mean": mean[k].tolist(), "sd": sd[k].tolist(),
             "drawn": drawn[k].tolist(), "between_logs": between[k].tolist()}
            for k, name in enumerate(board.imus)
        ],
        **size_block(total, gyros, board),
        **instrument_block(board, runs[0].moving.interval),
        "effects": _effects(runs[0], kinds),
        "repeats": [_kind(one) for one in kinds],
    }  # fmt: skip


def _log(run: ArrayRun, z: float) -> dict[str, Any]:
    """What belongs to one power-up."""
    made = run.outcome.provenance
    effects = effect_blocks(run.loop) if run.loop is not None else []
    return {
        "input": made.path,
        "sha256": made.sha256,
        "z_rms_of_positions_by_the_others": z,
        "accelerometer_bias_m_per_s2": {
            t.name: t.bias.tolist() for t in run.calibration.triads
        },
        "gyro_bias_deg_per_s": {
            t.name: np.rad2deg(t.gyro_bias).tolist() for t in run.calibration.triads
        },
        "beats": [b for e in effects for b in e.get("beats", ()) if b is not None],
    }  # fmt: skip


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
