"""The files of an array run, each written whole or not at all; the YAML first."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.atomic_file import replaced_atomically
from imucalib.calibration.file import write_whole
from imucalib.calibrators.array.calibrate import ArrayRun
from imucalib.calibrators.array.calibration import array_calibration, provenance
from imucalib.calibrators.array.logs import Repeatability
from imucalib.recording.yaml_text import dump
from imucalib.report.array.document import array_document
from imucalib.report.array.loop import loop_dict
from imucalib.report.render.html import render_html


def write_array_reports(run: ArrayRun, folder: Path) -> tuple[Path, ...]:
    """Write calibration.yaml, report.json and report.html into a folder; returns their paths."""
    yaml, data, page = (folder / n for n in ("calibration.yaml", "report.json", "report.html"))
    write_whole(yaml, dump(array_calibration(run)))
    content = json.dumps(array_dict(run), indent=2, ensure_ascii=False, allow_nan=False)
    write_whole(data, content + "\n")
    write_whole(page, render_html(array_document(run)))
    return yaml, data, page


def array_dict(run: ArrayRun) -> dict[str, Any]:
    """report.json: the calibration, and how it came about."""
    rests = run.rests
    return {
        **array_calibration(run),
        "exit_code": run.exit_code,
        "static": {
            "rests": rests.poses,
            "residual_m_per_s2": rests.residual,
            "residual_before_search_m_per_s2": rests.before,
            "verdict": rests.loop.verdict if rests.loop else "not searched",
            "steps": [s.effect for s in rests.loop.steps] if rests.loop else [],
            "records": [r.where for r in rests.loop.records] if rests.loop else [],
        },
        "moving": dict(run.moving.counts),
        "loop": loop_dict(run.loop) if run.loop else {"verdict": "not run"},
        "notes": list(run.notes),
    }


def repeatability_dict(found: Repeatability) -> dict[str, Any]:
    """Pooled positions of several logs, plain types."""
    return {
        "z_rms": found.z_rms,
        "inflation": found.inflation,
        "mean_mm": (1e3 * found.mean).tolist(),
        "sd_mm": (1e3 * found.sd).tolist(),
        "between_logs_mm": (1e3 * found.between).tolist(),
    }


def write_draws(run: ArrayRun, path: Path) -> None:
    """Draws as HDF5 in the layout of ArviZ's netCDF files: /posterior/position_mm with the
    dimensions chain, draw, imu, axis as netCDF4 dimension scales."""
    import h5py

    draws = 1e3 * run.final.draws
    c, n, a, _ = draws.shape
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced_atomically(path) as temporary, h5py.File(temporary, "w") as file:
        group = file.create_group("posterior")
        made = provenance(run)
        group.attrs["inference_library"] = "imucalib"
        group.attrs["inference_library_version"] = made["versions"]["imucalib"]
        group.attrs["created_at"] = made["time"]
        text = h5py.string_dtype()
        scales = {
            "chain": np.arange(c),
            "draw": np.arange(n),
            "imu": np.array(run.board.imus, dtype=object),
            "axis": np.array(list("xyz"), dtype=object),
        }
        data = group.create_dataset("position_mm", data=draws, compression="gzip", shuffle=True)
        data.attrs["units"] = "mm"
        for k, (name, values) in enumerate(scales.items()):
            kind = text if values.dtype == object else np.int64
            scale = group.create_dataset(name, data=values, dtype=kind)
            scale.make_scale(name)
            data.dims[k].attach_scale(scale)
        assert data.shape[2] == a
