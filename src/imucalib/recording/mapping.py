"""How a file's fields become channels: what the user states, and the record of how it was read.

A reader starts from the user's `FieldMapping` (every unset field is found by the reader), and
stores the resolved one in `Recording.mapping`, so any result can be reproduced from its file.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.atomic_file import replace_atomically
from imucalib.errors import UnreadableInput, UsageError
from imucalib.recording.yaml_text import dump, load

#: Options and keywords that have another name than the field that they state.
OPTION_FIELDS = {"unit": "acc_unit", "lsb": "lsb_per_g", "gyro_lsb": "lsb_per_dps"}
#: Seconds in one unit of a numeric time stamp; "text" is a date or a time of day.
TIME_UNITS: dict[str, float] = {
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "100us": 1e-4,
    "min": 60.0,
    "h": 3600.0,
    "d": 86_400.0,
    "excel": 86_400.0,
    "datenum": 86_400.0,
    "julian": 86_400.0,
    "filetime": 1e-7,
    "ticks": 1e-7,
}
#: Seconds since 1970 of stamp zero, of the units that count from a date of their own: days of a
#: spreadsheet (from 1899-12-30), of MATLAB (year 0), Julian days; 100 ns of Windows (1601), .NET.
TIME_ZEROS: dict[str, int] = {
    "excel": -25_569 * 86_400,
    "datenum": -719_529 * 86_400,
    "julian": -210_866_760_000,
    "filetime": -11_644_473_600,
    "ticks": -62_135_596_800,
}


@dataclass(frozen=True)
class FieldMapping:
    """Overrides of the user before reading; the whole resolved mapping after it.

    A field address is, by format: CSV, a column name or number counted from 1, three to a triad;
    HDF5, a dataset path, one to a triad (or one dataset (N, K, 3) for K triads); MCAP, "topic" or
    "topic:field.path" of a 3-vector, one to a triad.

    acc, gyro, temperature, time : field addresses; time empty means "from `rate`"; of a CSV, time
        may be several columns that make a stamp together, "Date,Time"
    triads : names of the sensors, in the order of `acc`, then of `gyro` where these differ
        ("imu0", "imu1", ... when empty)
    acc_unit, gyro_unit, temperature_unit : units of the file; "counts" for raw integers
    lsb_per_g, lsb_per_dps : counts per g and per deg/s, one value or one an axis
    acc_offset, gyro_offset : counts at zero, subtracted before scaling, one value or one an axis
    rate : samples a second; when stated, time stamps are ignored unless `time` is named too
    time_unit : a key of TIME_UNITS or "text"
    time_format : strptime format of text stamps that are not ISO 8601
    where : "column=value" of a text table: only rows that have it are read, all of several
    axis_map : sensor axes of the output in terms of the file's, for example "x,-y,z"
    skip : lines before the header or, with `header` False, before the first data row
    header : whether a line of column names exists
    decimal, delimiter : of a CSV; delimiter " " stands for any run of blanks
    preset : the device (`readers/devices`) that filled what was not stated
    sensor : the one that is read, of several; what belongs to others is left out
    max_chunk : of an MCAP file, bytes that one packed chunk may unpack to
    allow_external : of an HDF5 file, whether its data may lie in other files
    """

    acc: tuple[str, ...] = ()
    gyro: tuple[str, ...] = ()
    temperature: tuple[str, ...] = ()
    time: str = ""
    triads: tuple[str, ...] = ()
    acc_unit: str = ""
    gyro_unit: str = ""
    temperature_unit: str = ""
    lsb_per_g: tuple[float, ...] = ()
    lsb_per_dps: tuple[float, ...] = ()
    acc_offset: tuple[float, ...] = ()
    gyro_offset: tuple[float, ...] = ()
    rate: float | None = None
    time_unit: str = ""
    time_format: str = ""
    where: tuple[str, ...] = ()
    axis_map: str = ""
    skip: int | None = None
    header: bool | None = None
    decimal: str = ""
    delimiter: str = ""
    preset: str = ""
    sensor: str = ""
    max_chunk: int | None = None
    allow_external: bool | None = None

    def __post_init__(self) -> None:
        parse_axis_map(self.axis_map)
        for name in ("lsb_per_g", "lsb_per_dps"):
            if any(not np.isfinite(v) or v == 0 for v in getattr(self, name)):
                raise UsageError(f"{name} must be finite and not zero", where=f"mapping: {name}")
        if self.rate is not None and not (np.isfinite(self.rate) and self.rate > 0):
            raise UsageError(f"rate {self.rate} is not a positive number", where="mapping: rate")
        if self.skip is not None and self.skip < 0:
            raise UsageError(f"skip {self.skip} is negative", where="mapping: skip")
        if self.time_unit not in ("", "text", *TIME_UNITS):
            what, choices = (
                f"unknown time unit '{self.time_unit}'",
                ", ".join((*TIME_UNITS, "text")),
            )
            raise UsageError(what, where="mapping: time_unit", remedy=f"use one of: {choices}")
        for condition in self.where:
            if not all(part.strip() for part in condition.partition("=")):
                what, remedy = f"'{condition}' is not COLUMN=VALUE", "write it like serial=A12"
                raise UsageError(what, where="mapping: where", remedy=remedy)
        if self.decimal not in ("", ".", ","):
            what = f"decimal mark '{self.decimal}' is neither . nor ,"
            raise UsageError(what, where="mapping: decimal")

    def to_dict(self) -> dict[str, Any]:
        """The stated fields only, as plain lists, numbers and strings."""
        stated = self._stated().items()
        return {name: list(v) if isinstance(v, tuple) else v for name, v in stated}

    def fill_from(self, other: FieldMapping) -> FieldMapping:
        """This mapping, with every field that is not stated taken from `other`."""
        return replace(other, **self._stated())

    def _stated(self) -> dict[str, Any]:
        every = ((f.name, getattr(self, f.name)) for f in fields(self))
        return {name: value for name, value in every if value not in ((), "", None)}


def from_dict(data: Mapping[str, object], where: str = "mapping") -> FieldMapping:
    """A mapping from plain data; lists may be given as "a,b,c". Raises UsageError on a bad key."""
    known = {f.name for f in fields(FieldMapping)}
    found = {}
    for key, value in data.items():
        if key not in known:
            raise UsageError(
                f"unknown field '{key}'", where=where, remedy=f"known: {', '.join(sorted(known))}"
            )
        try:
            if value is not None:
                found[key] = _READ.get(key, str)(value)
        except (TypeError, ValueError) as error:
            raise UsageError(f"'{value}' is not a valid {key}", where=where) from error
    return FieldMapping(**found)


def _parts(value: Any) -> Sequence[Any]:
    parts = value.split(",") if isinstance(value, str) else value
    return parts if isinstance(parts, list | tuple) else [parts]


def _as_bool(value: object) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"{value!r} is not true or false")
    return value


#: Of each field that is not a text, what makes it of plain data.
_READ: dict[str, Callable[[Any], Any]] = {
    **dict.fromkeys(
        ("acc", "gyro", "temperature", "triads", "where"),
        lambda value: tuple(str(part).strip() for part in _parts(value)),
    ),
    **dict.fromkeys(
        ("lsb_per_g", "lsb_per_dps", "acc_offset", "gyro_offset"),
        lambda value: tuple(float(part) for part in _parts(value)),
    ),
    "rate": float,
    "skip": int,
    "max_chunk": int,
    "header": _as_bool,
    "allow_external": _as_bool,
}


@dataclass(frozen=True)
class AxisMap:
    """Signed permutation of three axes: output axis i is sign[i] * input axis order[i]."""

    order: tuple[int, int, int] = (0, 1, 2)
    sign: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def apply(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map values (..., 3); the input itself when the map changes nothing."""
        if self == UNCHANGED:
            return values
        return np.asarray(values[..., self.order] * np.array(self.sign))


UNCHANGED = AxisMap()


def parse_axis_map(text: str) -> AxisMap:
    """Parse "x,-y,z"; empty means unchanged. Raises UsageError unless it names each axis once."""
    if not text.strip():
        return UNCHANGED
    parts = [p.strip().lower() for p in text.split(",")]
    names = [p.lstrip("+-") for p in parts]
    if sorted(names) != ["x", "y", "z"] or any(
        len(p) - len(n) > 1 for p, n in zip(parts, names, strict=True)
    ):
        raise UsageError(
            f"axis map '{text}' does not name x, y and z once each",
            where="mapping: axis_map",
            remedy='write it like "x,-y,z"',
        )
    order = ["xyz".index(n) for n in names]
    sign = [-1.0 if p.startswith("-") else 1.0 for p in parts]
    return AxisMap((order[0], order[1], order[2]), (sign[0], sign[1], sign[2]))


def load_mapping(path: str | os.PathLike[str]) -> FieldMapping:
    """Read a mapping from YAML. Raises UnreadableInput for bad YAML, UsageError for a bad field."""
    data = load(Path(path), "write one with 'imucal inspect FILE --save-mapping'")
    if not isinstance(data, dict):
        raise UnreadableInput("the mapping is not a list of 'field: value' lines", where=str(path))
    return from_dict({str(k): v for k, v in data.items()}, where=str(path))


def save_mapping(mapping: FieldMapping, path: str | os.PathLike[str]) -> None:
    """Write the stated fields as YAML, whole or not at all. Raises UsageError."""
    with replace_atomically(path) as temporary:
        temporary.write_text(dump(mapping.to_dict()), encoding="utf-8")
