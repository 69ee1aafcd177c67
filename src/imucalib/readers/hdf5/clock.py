"""Where a field of an HDF5 file lies, and the clock that belongs to it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from imucalib.errors import UsageError
from imucalib.readers.columns import understand
from imucalib.readers.hdf5.attributes import RATE_NAMES, number_of, text_of, unit_of
from imucalib.recording.mapping import FieldMapping

TIME_NAMES = ("time", "timestamp", "timestamps", "t", "times", "stamp", "time_ns", "timestamp_ns",
         "time_us", "timestamp_us", "time_ms", "timestamp_ms")  # fmt: skip


@dataclass(frozen=True)
class Place:
    """Where numbers lie: dataset, then a field of a compound, then the triad in (N, K, 3)."""

    path: str
    column: str = ""
    triad: int = -1
    transposed: bool = False


@dataclass(frozen=True)
class Found:
    """One channel of the file.

    parts : one place of (N, 3), or three of (N,); a temperature has one
    time : place of the stamps, or None; rate : of the attributes, when there are no stamps
    scale, offset : that the file states for its numbers to be in `unit`; 1 and 0 when none
    numbered : whether `triad` is only a number, since nothing in the file names it
    epoch : ns since 1970 from which the stamps count, where their unit states it
    """

    quantity: str
    triad: str
    parts: tuple[Place, ...]
    rows: int
    unit: str = ""
    scale: float = 1.0
    time: Place | None = None
    time_unit: str = ""
    rate: float | None = None
    preset: str = ""
    epoch: int | None = None
    offset: float = 0.0
    numbered: bool = False

    @property
    def address(self) -> str:
        """Its dataset, and which of the triads in it."""
        first = self.parts[0]
        whole = first.path if len(self.parts) == 1 else first.path.rpartition("/")[0]
        return f"{whole}[{first.triad}]" if first.triad >= 0 else whole


def _words(path: str) -> list[str]:
    return [w for w in path.strip("/").split("/") if w]


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
        stamps = node_at(nodes, mapping.time, "time")
        unit = mapping.time_unit or unit_of(stamps) or field.time_unit
        return replace(field, time=Place(stamps.name), time_unit=unit)
    in_table = _column_of_time(node, field, mapping)
    if in_table is not None:
        return in_table
    folder = node.name.rpartition("/")[0]
    while True:
        for path, stamps in nodes.items():
            head, _, name = path.rpartition("/")
            fits = stamps.size == field.rows and stamps.dtype.kind in "iuf"
            if head == folder and name.lower() in TIME_NAMES and fits:
                unit = mapping.time_unit or unit_of(stamps) or field.time_unit
                suffix = name.lower().rpartition("_")[2]
                unit = unit or (suffix if suffix in ("ns", "us", "ms") else "")
                return replace(field, time=Place(path), time_unit=unit)
        holder = file[folder] if folder else file
        rate = number_of(node, *RATE_NAMES) or number_of(holder, *RATE_NAMES)
        if rate and rate > 0:
            return replace(field, rate=rate)
        if not folder:
            return field
        folder = folder.rpartition("/")[0]


def _column_of_time(node: Any, field: Found, mapping: FieldMapping) -> Found | None:
    """The field with the time column of the table that it is in, if it is in one."""
    for column in understand(list(node.dtype.names or ())):
        if column.quantity == "time":
            name = node.dtype.names[column.index]
            unit = mapping.time_unit or column.unit
            return replace(field, time=Place(node.name, name), time_unit=unit)
    return None
