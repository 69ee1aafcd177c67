"""Where a field of an HDF5 file lies, and the clock that belongs to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.errors import UsageError
from imucalib.readers.columns import understand
from imucalib.readers.hdf5.attributes import (
    RATE_NAMES,
    number_of,
    numbers_of,
    text_of,
    unit_of,
)
from imucalib.recording.mapping import FieldMapping
from imucalib.units import canonical

TIME_NAMES = ("time", "timestamp", "timestamps", "t", "times", "stamp", "time_ns", "timestamp_ns",
         "time_us", "timestamp_us", "time_ms", "timestamp_ms")  # fmt: skip


_SCALES, _OFFSETS = ("scale", "scale_factor", "Scale"), ("add_offset",)


@dataclass(frozen=True)
class Place:
    """Where numbers lie: dataset, then a field of a compound, then the triad in (N, K, 3).

    unit, scale, offset : that the file states for them, one or one an axis: what is stored times
        `scale` plus `offset` is in `unit`
    """

    path: str
    column: str = ""
    triad: int = -1
    transposed: bool = False
    unit: str = ""
    scale: tuple[float, ...] = (1.0,)
    offset: tuple[float, ...] = (0.0,)

    @property
    def packed(self) -> bool:
        """Whether what is stored is not yet in the unit."""
        return any(s != 1.0 for s in self.scale) or any(o != 0.0 for o in self.offset)

    def unpacked(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """Stored values (n,) or (n, 3) in the unit, of the type that they have where that is it."""
        if not self.packed:
            return values
        return np.asarray(values * np.array(self.scale) + np.array(self.offset), np.float64)


def place_of(
    node: Any, column: str = "", triad: int = -1, *, transposed: bool = False, named: str = ""
) -> Place:
    """A place with what the attributes of its dataset state. named : unit that its name states"""
    unit = unit_of(node, column)
    if unit and named not in ("", "counts") and canonical(named) != canonical(unit):
        unit = f"{unit} (its name says {named})"  # no unit that is known: the reader refuses it
    scale, offset = (numbers_of(node, column, names, usual)
                     for names, usual in ((_SCALES, 1.0), (_OFFSETS, 0.0)))  # fmt: skip
    return Place(
        node.name, column, triad, transposed=transposed, unit=unit or named, scale=scale,
        offset=offset,
    )  # fmt: skip


@dataclass(frozen=True)
class Found:
    """One channel of the file.

    parts : one place of (N, 3), or three of (N,); a temperature has one
    time : place of the stamps, or None; rate : of the attributes, when there are no stamps
    unit : of all axes, or one an axis: "m/s2,m/s2,g"
    numbered : whether `triad` is only a number, since nothing in the file names it
    epoch : ns since 1970 from which the stamps count, where their unit states it
    """

    quantity: str
    triad: str
    parts: tuple[Place, ...]
    rows: int
    unit: str = ""
    time: Place | None = None
    time_unit: str = ""
    rate: float | None = None
    preset: str = ""
    epoch: int | None = None
    numbered: bool = False

    @property
    def address(self) -> str:
        """Its dataset, and which of the triads in it."""
        first = self.parts[0]
        whole = first.path if len(self.parts) == 1 else first.path.rpartition("/")[0]
        return f"{whole}[{first.triad}]" if first.triad >= 0 else whole


def found_in(quantity: str, triad: str, parts: Sequence[Place], rows: int) -> Found:
    """The channel that lies at some places, with their unit."""
    units = [part.unit for part in parts]
    unit = units[0] if len(set(units)) == 1 else ",".join(units)
    return Found(quantity, triad, tuple(parts), rows, unit)


def words_of(path: str) -> list[str]:
    """The parts of a dataset path."""
    return [w for w in path.strip("/").split("/") if w]


def node_at(nodes: dict[str, Any], address: str, option: str) -> Any:
    """The dataset at an address of the mapping. Raises UsageError when there is none."""
    path = "/" + address.strip().strip("/")
    if path not in nodes:
        raise UsageError(
            f"no dataset '{address}'",
            where=f"mapping: {option}",
            remedy=f"datasets: {', '.join(nodes) or 'none'}",
        )
    return nodes[path]


def with_device(field: Found, file: Any) -> Found:
    """APDM Opal files state no units: they are m/s², rad/s and µs; sensors have a label."""
    parts = words_of(field.parts[0].path)
    if len(parts) < 3 or parts[0] != "Sensors" or "Configuration" not in file["Sensors"][parts[1]]:
        return field
    attrs = file["Sensors"][parts[1]]["Configuration"].attrs
    label = text_of(attrs["Label 0"]) if "Label 0" in attrs else parts[1]
    unit = field.unit or {"acceleration": "m/s2", "angular_rate": "rad/s"}.get(
        field.quantity, "degC"
    )
    name = label.replace("/", "_") or parts[1]
    return replace(field, unit=unit, triad=name, time_unit="us", preset="apdm")


def with_clock(field: Found, nodes: dict[str, Any], file: Any, mapping: FieldMapping) -> Found:
    """The field with the nearest time dataset of its length, else with a stated rate."""
    node = nodes[field.parts[0].path]
    rate = mapping.rate
    if rate and not mapping.time:
        return replace(field, rate=rate)
    if mapping.time:
        place = _stamps(node_at(nodes, mapping.time, "time"))
        unit = mapping.time_unit or place.unit or field.time_unit
        return replace(field, time=place, time_unit=unit)
    in_table = _column_of_time(node, field, mapping)
    if in_table is not None:
        return in_table
    folder = node.name.rpartition("/")[0]
    while True:
        for path, stamps in nodes.items():
            head, _, name = path.rpartition("/")
            fits = stamps.size == field.rows and stamps.dtype.kind in "iuf"
            if head == folder and name.lower() in TIME_NAMES and fits:
                place, suffix = _stamps(stamps), name.lower().rpartition("_")[2]
                unit = mapping.time_unit or place.unit or field.time_unit
                unit = unit or (suffix if suffix in ("ns", "us", "ms") else "")
                return replace(field, time=place, time_unit=unit)
        holder = file[folder] if folder else file
        rate = number_of(node, *RATE_NAMES) or number_of(holder, *RATE_NAMES)
        if rate and rate > 0:
            return replace(field, rate=rate)
        if not folder:
            return field
        folder = folder.rpartition("/")[0]


def _stamps(node: Any) -> Place:
    """Stamps (N,), or (1, N) as MATLAB writes a row of them."""
    return place_of(node, transposed=len(node.shape) == 2 and node.shape[0] == 1 < node.shape[1])


def _column_of_time(node: Any, field: Found, mapping: FieldMapping) -> Found | None:
    """The field with the time column of the table that it is in, if it is in one."""
    for column in understand(list(node.dtype.names or ())):
        if column.quantity == "time":
            name = node.dtype.names[column.index]
            place = place_of(node, name)
            unit = mapping.time_unit or place.unit or column.unit
            return replace(field, time=place, time_unit=unit)
    return None
