"""What a notebook holds, as calibrators take it: tables and arrays, and options by their names."""

from __future__ import annotations

import csv
import difflib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypedDict

import numpy as np

from imucalib.errors import UsageError
from imucalib.recording.mapping import OPTION_FIELDS, FieldMapping, from_dict
from imucalib.units import local_gravity

#: Headings of an array's columns, by their number: of positions, and of a recording in time.
TABLE = {3: ("x", "y", "z"), 5: ("inclination", "tool_face", "x", "y", "z")}
_ACC, _GYRO = ("acc_x", "acc_y", "acc_z"), ("gyr_x", "gyr_y", "gyr_z")
RECORDING = {
    3: _ACC,
    4: ("time (s)", *_ACC),
    6: (*_ACC, *_GYRO),
    7: ("time (s)", *_ACC, *_GYRO),
}


class Reading(TypedDict, total=False):
    """How a recording or table is read, by the names of the command's options."""

    acc: str
    gyro: str
    temperature: str
    time: str
    unit: str
    gyro_unit: str
    temperature_unit: str
    time_unit: str
    time_format: str
    lsb: float
    gyro_lsb: float
    rate: float
    axis_map: str
    preset: str
    acc_offset: str
    skip: int
    decimal: str
    delimiter: str


def mapping_of(base: FieldMapping | None, reading: Mapping[str, Any]) -> FieldMapping:
    """A mapping with single options over it. Raises UsageError for an option that there is not."""
    known = Reading.__annotations__
    for name in reading:
        if name not in known:
            close = difflib.get_close_matches(name, known, 1)
            remedy = f"did you mean {close[0]}" if close else f"there are: {', '.join(known)}"
            raise UsageError(f"no option '{name}'", remedy=remedy)
    stated = {OPTION_FIELDS.get(name, name): value for name, value in reading.items()}
    return from_dict(stated, "keywords").filled_from(base or FieldMapping())


def gravity_of(given: float | None, latitude: float | None, height: float) -> dict[str, Any]:
    """Fields of a request that a stated gravity, m/s², or place (deg, m) replaces."""
    if given is not None and latitude is not None:
        raise UsageError("gravity and latitude exclude each other", remedy="leave one out")
    if given is not None:
        return {"gravity": given, "gravity_source": "as given"}
    if latitude is None:
        return {}
    source = f"normal gravity at latitude {latitude:g}, height {height:g} m"
    return {"gravity": local_gravity(latitude, height), "gravity_source": source}


@contextmanager
def as_file(data: Any, headings: Mapping[int, tuple[str, ...]]) -> Iterator[Path]:
    """The path of a file, or of a file that holds a table for as long as it is read: a DataFrame,
    columns by name, or an array (n, k) whose k columns are `headings[k]`. Raises UsageError."""
    if isinstance(data, str | Path):
        yield Path(data)
        return
    columns = _columns(data, headings)
    with TemporaryDirectory(prefix="imucal-") as folder:
        path = Path(folder) / "given.csv"
        with path.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))
        yield path


def _columns(data: Any, headings: Mapping[int, tuple[str, ...]]) -> dict[str, list[Any]]:
    """Name -> cells as text that reads back to the same number."""
    if isinstance(data, Mapping) or hasattr(data, "columns"):
        names = list(data) if isinstance(data, Mapping) else list(data.columns)
        return {str(name): _cells(np.asarray(data[name])) for name in names}
    values = np.asarray(data, np.float64)
    if values.ndim != 2 or values.shape[1] not in headings:
        allowed = "; ".join(f"{k}: {', '.join(names)}" for k, names in headings.items())
        raise UsageError(
            f"an array of shape {values.shape} has no known columns",
            remedy=f"give a DataFrame, or an array with columns of {allowed}",
        )
    return {n: _cells(c) for n, c in zip(headings[values.shape[1]], values.T, strict=True)}


def _cells(values: Any) -> list[Any]:
    if values.dtype.kind == "M":
        return list(np.datetime_as_string(values))
    if values.dtype.kind == "f":
        return ["" if np.isnan(v) else repr(float(v)) for v in values]
    return [str(v) for v in values]
