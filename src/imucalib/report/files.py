"""What a finished run leaves behind: one document, one report.json, and files as one unit.

report.json is the machine's report, with the same keys for every calibrator.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib.arrays import Array
from imucalib.atomic_file import replace_atomically
from imucalib.calibration.file import to_yaml, write_together
from imucalib.calibration.findings import Findings, FoundStep
from imucalib.calibration.outcome import Run
from imucalib.calibration.plain import fields, json_text, listed, plain
from imucalib.errors import ImucalError, UsageError
from imucalib.exports import Made
from imucalib.loop.found import Score
from imucalib.recording.yaml_text import load
from imucalib.report.document import Document, Series
from imucalib.significant_digits import per_cent

if TYPE_CHECKING:
    from imucalib.calibration.angles import Angles
    from imucalib.calibrators.array.run import ArrayRun
    from imucalib.calibrators.lab.conventions import Conventions

SCHEMA = "imucal/report/2"
_PARAMETER = "name effect value sd unit"
_ANGLES = {
    "time_s": "%.6f",
    "inclination_deg": "%.4f",
    "inclination_sd_deg": "%.4f",
    "inclination_calibration_sd_deg": "%.4f",
    "tool_face_deg": "%.4f",
    "tool_face_sd_deg": "%.4f",
    "tool_face_calibration_sd_deg": "%.4f",
    "norm_error_mg": "%.3f",
    "still": "%d",
}


@dataclass(frozen=True)
class Report:
    """A run and its document; report.json's content is made once. name : of the folder that it has
    where there are several"""

    run: Run
    document: Document
    name: str = ""

    @cached_property
    def content(self) -> dict[str, Any]:
        return {**report_dict(self.run), **shown_dict(self.document)}


def demand_folder(folder: Path, inputs: Sequence[Path]) -> None:
    """Raise UsageError unless results of `inputs` may be written into a folder; before the work.

    Results of a run on one of the inputs may be replaced; another's, or what no run wrote, may not.
    """
    place = next(p for p in (folder, *folder.parents) if p.exists())
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        what = "no folder can be written here" if place.is_dir() else "this is a file, no folder"
        raise UsageError(what, where=str(place), remedy="name another folder with -o")
    target = folder / "calibration.yaml"
    if not os.path.lexists(target):
        return
    try:
        made = load(target)["provenance"]["input"]
    except (ImucalError, KeyError, TypeError):
        made = None
    if made not in {path.name for path in inputs}:
        held = f"the calibration of {made}" if made else "a file that is no calibration of imucal"
        raise UsageError(
            f"it holds {held}", where=str(target), remedy="name another folder, or give --force"
        )


def write_report(report: Report, folder: Path, exported: Sequence[Made] = ()) -> tuple[Path, ...]:
    """Write calibration.yaml, report.json, report.html and exports into a folder, all or none;
    returns their paths."""
    from imucalib.report.render.html import render_html

    texts = {
        "calibration.yaml": to_yaml(report.run.calibration),
        "report.json": json_text(report.content) + "\n",
        "report.html": render_html(report.document),
        **{one.file: one.text for one in exported},
    }
    write_together({folder / name: text for name, text in texts.items()})
    return tuple(folder / name for name in texts)


def report_dict(run: Run) -> dict[str, Any]:
    """The report as plain types.

    Numbers that do not exist (no held-out part) are null, never NaN, which is no JSON.
    """
    outcome, calibration, found = run.outcome, run.calibration, run.outcome.findings
    content: dict[str, Any] = {
        "schema": SCHEMA,
        **fields(outcome, "calibrator status exit_code reasons"),
        "sensor": outcome.sensor.as_dict(),
        "parameters": listed(calibration.parameters, _PARAMETER),
        "covariance": _covariance(run),
        "loop": {
            "errors": [error.as_dict() for error in outcome.errors],
            "advice": list(map(str, outcome.advice)),
            **_found(found or Findings("not run")),
        },
        "limits": listed(outcome.limits, "name value limit unit broken"),
        "undecided": list(map(str, outcome.undecided)),
        "left": listed(outcome.left, "name value accepted unit beyond"),
        "notes": outcome.notes,
        "provenance": outcome.provenance.as_dict(),
    }
    if calibration.triads:
        content["triads"] = [triad.as_dict() for triad in calibration.triads]
    else:
        content["matrices"] = calibration.matrices().as_dict()
    whole: dict[str, Any] = plain(content) | plain(run.details)
    return whole


def _covariance(run: Run) -> dict[str, Any]:
    covariance, fit = run.calibration.covariance, run.outcome.fit
    if fit is None:
        return {"estimated_noise": covariance}
    return {
        "estimated_noise": covariance,
        **fields(fit, "chi2 dof noise_factor=noise.factor condition"),
    }


def _found(found: Findings) -> dict[str, Any]:
    # Why each effect was not added.
    reasons = {s.name: _why(s, found) for s in found.scores if s.kind == "effect"}
    reasons |= dict(found.rejected)
    reasons |= {name: f"not tested: {why}" for name, why in found.missing.items()}
    records, scores = found.records, found.scores
    return {
        "verdict": found.verdict,
        "p_nothing_missing": found.complete,
        "gain": None if found.gain is None else vars(found.gain),
        "declared": [{"effect": name, "size": size} for name, size in found.declared],
        **fields(found, "only without"),
        "record_errors": listed(records, "where channel size sd unit likely probability"),
        "steps": [_step(step) for step in found.steps],
        "unexplained": listed(
            found.unexplained, "name driver=follows kind probability evidence_nats=evidence"
        ),
        "rejected": [{"effect": name, "reason": why} for name, why in reasons.items()],
        "refuted": found.refuted,
        "not_testable": [vars(u) for u in found.not_testable],
        "candidates": listed(
            scores,
            "name kind evidence_nats=evidence probability left lambda_at_typical_size=strength "
            "size_m_per_s2=size",
        ),
    }


def _step(step: FoundStep) -> dict[str, Any]:
    return {
        **fields(step, "effect size probability"),
        "in_its_place": [{"effect": name, "share": share} for name, share in step.rivals],
        **fields(step, "evidence_nats=evidence held_out_nats=held_out"),
        "checks": listed(step.checks, "metric unit before after"),
        **fields(step, "aliases certain formula"),
        "parameters": listed(step.parameters, _PARAMETER),
    }


def _why(score: Score, found: Findings) -> str:
    if score.absorbed:
        return "absorbed by the fitted parameters: these data cannot show it"
    numbers = f"{per_cent(score.probability)} likely, {score.evidence:.2f} nats by itself"
    best = found.scores[0]
    if score.evidence > 0.0 and score.evidence < best.evidence:
        return f"{best.name} explains more: {numbers}"
    return f"no evidence: {numbers}"


def shown_dict(document: Document) -> dict[str, Any]:
    """What only the document holds: its card, and its figures as series, five digits each."""
    card, plots = document.card, []
    for title, plot in document.plots:
        series = [_series(s) for s in plot.series]
        words = fields(plot, "title x=x_label y=y_label caption")
        plots.append({"section": title, **words, "series": series})
    shown = card and {
        "good_to": [
            {**fields(worth, "quantity value"), "detail": worth.whole} for worth in card.good_to
        ],
        "found": [text.text for text in card.found],
        **fields(card, "to_do command"),
    }
    return dict(plain({"card": shown, "figures": plots}))


def _series(series: Series) -> dict[str, Any]:
    """Values (n,), the edges of bands and bars, and the names of points, where they exist."""
    edges = {"low": series.low, "high": series.high}
    return {
        "label": series.label,
        "x": _round_numbers(series.x),
        "y": _round_numbers(series.y),
        **{name: _round_numbers(edge) for name, edge in edges.items() if edge is not None},
        **({"names": series.names} if series.names else {}),
    }


def _round_numbers(values: Array) -> list[float]:
    return [float(f"{v:.5g}") for v in values]


def write_angles(found: Angles, conventions: Conventions, path: Path) -> None:
    """One row a sample or rest, CSV, angles in the bench's conventions; "nan" for a tool-face
    close to the vertical."""
    inclination, tool_face = conventions.outside(found.inclination, found.tool_face)
    columns = [found.t, inclination, found.inclination_sd, found.inclination_calibration_sd]
    columns += [tool_face, found.tool_face_sd, found.tool_face_calibration_sd]
    cells = np.column_stack([*columns, found.norm_error, found.still])
    form, header = list(_ANGLES.values()), ",".join(_ANGLES)
    with replace_atomically(path) as temporary:
        np.savetxt(temporary, cells, delimiter=",", header=header, comments="", fmt=form)


def write_draws(run: ArrayRun, path: Path) -> None:
    """Draws as HDF5 in the layout of ArviZ's netCDF files: /posterior/position_mm with the
    dimensions chain, draw, imu, axis as netCDF4 dimension scales."""
    import h5py

    draws, made = 1e3 * run.drawn.draws, run.outcome.provenance
    path.parent.mkdir(parents=True, exist_ok=True)
    with replace_atomically(path) as temporary, h5py.File(temporary, "w") as file:
        group = file.create_group("posterior")
        group.attrs["inference_library"] = "imucalib"
        group.attrs["inference_library_version"] = made.versions["imucalib"]
        group.attrs["created_at"] = made.time
        scales = {
            "chain": np.arange(draws.shape[0]),
            "draw": np.arange(draws.shape[1]),
            "imu": np.array(run.board.imus, dtype=object),
            "axis": np.array(list("xyz"), dtype=object),
        }
        data = group.create_dataset("position_mm", data=draws, compression="gzip", shuffle=True)
        data.attrs["units"] = "mm"
        for k, (name, values) in enumerate(scales.items()):
            kind = h5py.string_dtype() if values.dtype == object else np.int64
            scale = group.create_dataset(name, data=values, dtype=kind)
            scale.make_scale(name)
            data.dims[k].attach_scale(scale)
