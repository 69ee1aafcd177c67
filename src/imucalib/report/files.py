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
from imucalib.calibration.outcome import Run
from imucalib.calibrators.result import CardFacts, Figure, SeriesFacts, Shown, Worth, describe_run
from imucalib.data import json_text
from imucalib.errors import ImucalError, UsageError
from imucalib.exports import Made
from imucalib.recording.yaml_text import load
from imucalib.report.render.document import Document, Series

if TYPE_CHECKING:
    from imucalib.calibration.angles import Angles
    from imucalib.calibrators.array.run import ArrayRun
    from imucalib.core.angle_conventions import Conventions

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
        return describe_run(self.run) | page_dict(self.document)


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


def describe_page(document: Document) -> Shown:
    """What only the document holds: its card, and its figures as series, five digits each."""
    card, figures = document.card, []
    for title, plot in document.plots:
        series = tuple(map(_series, plot.series))
        labels = "x=x_label y=y_label"
        figures.append(Figure.of(plot, labels, section=title, series=series))
    shown = None
    if card is not None:
        worth = tuple(Worth.of(one, "detail=whole") for one in card.good_to)
        found = tuple(text.text for text in card.found)
        shown = CardFacts.of(card, good_to=worth, found=found)
    return Shown(shown, tuple(figures))


def page_dict(document: Document) -> dict[str, Any]:
    """The same as plain types."""
    return describe_page(document).as_dict()


def _series(series: Series) -> SeriesFacts:
    """Values (n,), the edges of bands and bars, and the names of points, where they exist."""
    low, high = (None if e is None else _round_numbers(e) for e in (series.low, series.high))
    return SeriesFacts(
        label=series.label,
        x=_round_numbers(series.x),
        y=_round_numbers(series.y),
        low=low,
        high=high,
        names=series.names or None,
    )


def _round_numbers(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{v:.5g}") for v in values)


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
