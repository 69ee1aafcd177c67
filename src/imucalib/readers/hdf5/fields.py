"""What an HDF5 file holds: inertial fields found by its datasets, names and attributes; clocks.

h5py is passed in as objects; this module does not import it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.devices.catalogue import devices
from imucalib.readers.fields.choice import OPTIONS, Field, Vector, choose, join_units
from imucalib.readers.fields.conversion import AS_STORED, Conversion
from imucalib.readers.fields.words import instant_rank, understand
from imucalib.recording.mapping import FieldMapping
from imucalib.units import canonical

RATE_NAMES = ("sampling_rate", "sample_rate", "SampleRate", "rate", "fs")
#: Attributes that name the columns of a dataset.
_LABELS = ("columns", "axes", "axis", "labels", "components", "channels")
_MOST = 4096  # datasets with rows: each costs half a millisecond before it is read
_MOST_OBJECTS = 4 * _MOST  # with groups and datasets without rows: each costs 0.15 ms
_DEEPEST = 32  # groups within groups
_LARGE_CHUNK, _CHUNK_RATIO = 64 << 20, 100  # bytes of a chunk; times what all of them store
_LARGEST_RATIO = 2000  # logical over stored bytes; deflate cannot do more than about 1032


def text_of(value: Any) -> str:
    """An attribute as text: bytes, NUL-padded or a one-element array of them."""
    if isinstance(value, np.ndarray):
        value = value.flat[0] if value.size else ""
    if isinstance(value, bytes):
        value = value.decode("utf-8", errors="replace")
    return str(value).rstrip("\0").strip()


def unit_of(node: Any, column: str = "") -> str:
    """The unit attribute in any of its usual spellings, without "per count"; of a list of them that
    of the column of a table, else one an axis: "m/s2,m/s2,g"."""
    for name in ("units", "unit", "Units", "Unit", "UNITS"):
        if name in node.attrs:
            texts = [text_of(value) for value in _each(node, node.attrs[name], column)]
            each = [re.sub(r" per (count|LSB|lsb)$|/(LSB|count)$", "", text) for text in texts]
            return each[0] if len(set(each)) == 1 else ",".join(each)
    return ""


def _each(node: Any, value: Any, column: str) -> list[Any]:
    """The values of an attribute that belong to a column of a table, or to each of three axes."""
    values = np.asarray(value).reshape(-1)
    names = (column and node.dtype.names) or ()
    if column in names and values.size == len(names):
        return [values[names.index(column)]]
    axes = values.size == 3 and 3 in getattr(node, "shape", ())[-2:]
    return list(values) if axes else list(values[:1]) or [""]


def _numbers_of(node: Any, column: str, names: Sequence[str], *, zero: bool) -> tuple[float, ...]:
    """The first attribute of these names that is finite, one number or one an axis; () for none.

    zero : whether it may be that
    """
    for name in names:
        if name in node.attrs:
            try:
                found = tuple(float(v) for v in _each(node, node.attrs[name], column))
            except (TypeError, ValueError):
                continue
            if np.isfinite(found).all() and (zero or all(found)):
                return found
    return ()


def number_of(node: Any, *names: str) -> float | None:
    """The first attribute of these names that is a finite number."""
    return next(iter(_numbers_of(node, "", names, zero=True)), None)


def fills_of(node: Any, column: str = "") -> list[Any]:
    """Values that stand for "no value": netCDF's `_FillValue` and `missing_value`, and what the
    writer chose for rows that are not written. Zero, which nobody chose, is a value."""
    names = ("_FillValue", "missing_value")
    found = [np.asarray(node.attrs[name]).flat for name in names if name in node.attrs]
    fills = [v for values in found for v in values if np.asarray(v).dtype.kind in "iuf"]
    own = node.fillvalue[column] if column in (node.dtype.names or ()) else node.fillvalue
    return [*fills, own] if np.asarray(own).dtype.kind in "iuf" and own else fills


def valid_of(node: Any, column: str = "") -> tuple[float, float]:
    """The least and the most that is a value: netCDF's `valid_range`, `valid_min`, `valid_max`."""
    both = np.asarray(node.attrs.get("valid_range", ())).reshape(-1)
    if both.size == 2 and both.dtype.kind in "iuf":
        return float(both[0]), float(both[1])
    low, high = (
        _numbers_of(node, column, (name,), zero=True) for name in ("valid_min", "valid_max")
    )
    return min(low, default=-np.inf), max(high, default=np.inf)


@dataclass(frozen=True)
class FieldPlace:
    """Where numbers lie: dataset, then a field of a compound, then the triad in (N, K, 3).

    unit, scale, offset : that the file states for them, one or one an axis: what is stored times
        `scale` plus `offset` is in `unit`
    order : of x, y, z among the three numbers that are stored
    """

    path: str
    column: str = ""
    triad: int = -1
    transposed: bool = False
    unit: str = ""
    scale: tuple[float, ...] = (1.0,)
    offset: tuple[float, ...] = (0.0,)
    order: tuple[int, ...] = (0, 1, 2)

    def unpacked(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """Stored values (n,) or (n, 3) in the unit, of the type that they have where that is it."""
        if set(self.scale) == {1.0} and set(self.offset) == {0.0}:
            return values
        return np.asarray(values * np.array(self.scale) + np.array(self.offset), np.float64)


def place_of(
    node: Any, column: str = "", triad: int = -1, *, transposed: bool = False, named: str = ""
) -> FieldPlace:
    """A place with what the attributes of its dataset state. named : unit that its name states"""
    unit = unit_of(node, column)
    if unit and named not in ("", "counts") and canonical(named) != canonical(unit):
        unit = f"{unit} (its name says {named})"  # no unit that is known: the reader refuses it
    names = ("scale", "scale_factor", "Scale")
    scale = _numbers_of(node, column, names, zero=False) or (1.0,)
    offset = _numbers_of(node, column, ("add_offset",), zero=True) or (0.0,)
    place = FieldPlace(
        node.name, column, triad, transposed, unit=unit or named, scale=scale, offset=offset
    )
    return replace(place, order=_order_of(node, transposed)) if len(node.shape) > 1 else place


def labels_of(node: Any, dimension: int) -> list[str]:
    """The names of the positions along a dimension: of a scale that is attached to it (netCDF's
    coordinate), or of an attribute with as many texts; none where there are none."""
    size = node.shape[dimension]
    scales = list(node.dims[dimension].values())
    texts = [scale[...] for scale in scales if scale.dtype.kind in "SO" and scale.size == size]
    texts += [np.asarray(node.attrs[name]) for name in _LABELS if name in node.attrs]
    each = (values.reshape(-1) for values in map(np.asarray, texts))
    named = (v for v in each if v.size == size and v.dtype.kind in "SUO")
    return [text_of(value) for value in next(named, [])]


def _order_of(node: Any, transposed: bool) -> tuple[int, ...]:
    """Where x, y, z stand among three numbers, by their labels. Raises UnreadableInput for labels
    that are no axes."""
    dimension = 0 if transposed else len(node.shape) - 1
    labels = labels_of(node, dimension) if node.shape[dimension] == 3 else []
    letters = {letter: axis for axis, letter in enumerate("xyz")}
    axes = [m.axis if m.is_axis else letters.get(m.name.lower(), -1) for m in understand(labels)]
    if not labels or axes == [0, 1, 2]:
        return 0, 1, 2
    if sorted(axes) != [0, 1, 2]:
        raise UnreadableInput(
            f"the columns of {node.name} are called {', '.join(labels)}, not x, y, z",
            where=str(node.file.filename),
            remedy="write it with its columns in the order x, y, z and without these names",
        )
    return tuple(axes.index(axis) for axis in range(3))


@dataclass(frozen=True)
class FieldChannel:
    """One channel of the file; what is below `numbered` is found by `reader` from looks at it.

    parts : one place of (N, 3), or three of (N,); a temperature has one
    unit : of all axes, or one an axis: "m/s2,m/s2,g"
    time : place of the stamps, or None
    rate : Hz; None where no attribute states it and the stamps have not been looked at
    numbered : whether `triad` is only a number, since nothing in the file names it
    origin : first stamp of its clock, in `time_unit`
    shift : s from the recording's start to that stamp
    threshold : a longer step is a gap, s
    """

    quantity: str
    triad: str
    parts: tuple[FieldPlace, ...]
    rows: int
    unit: str = ""
    time: FieldPlace | None = None
    time_unit: str = ""
    rate: float | None = None
    preset: str = ""
    numbered: bool = False
    origin: float | int = 0
    shift: float = 0.0
    threshold: float = 0.0
    conversion: Conversion = AS_STORED

    @property
    def name(self) -> str:
        """Of the channel."""
        return f"{self.triad}/{self.quantity}"

    @property
    def address(self) -> str:
        """Its dataset, and which of the triads in it."""
        first = self.parts[0]
        whole = first.path if len(self.parts) == 1 else first.path.rpartition("/")[0]
        return f"{whole}[{first.triad}]" if first.triad >= 0 else whole


def find_channel(vector: Vector, parts: Sequence[FieldPlace], rows: int) -> FieldChannel:
    """The channel that lies at some places, with their unit."""
    units = [part.unit for part in parts]
    if len(parts) == 1 and "," in units[0]:  # one an axis, in the order of the file
        units = [units[0].split(",")[k] for k in parts[0].order]
    unit, numbered = join_units(units), vector.numbered
    return FieldChannel(vector.quantity, vector.triad, tuple(parts), rows, unit, numbered=numbered)


def words_of(path: str) -> list[str]:
    """The parts of a dataset path."""
    return [w for w in path.strip("/").split("/") if w]


def _node_at(nodes: dict[str, Any], address: str, option: str) -> Any:
    """The dataset at an address of the mapping. Raises UsageError when there is none."""
    path = "/" + address.strip().strip("/")
    if path not in nodes:
        raise UsageError(
            f"no dataset '{address}'",
            where=f"mapping: {option}",
            remedy=f"datasets: {', '.join(nodes) or 'none'}",
        )
    return nodes[path]


def _add_device(field: FieldChannel, file: Any) -> FieldChannel:
    """APDM Opal files state no units, and sensors have a label."""
    parts = words_of(field.parts[0].path)
    if len(parts) < 3 or parts[0] != "Sensors" or "Configuration" not in file["Sensors"][parts[1]]:
        return field
    attrs = file["Sensors"][parts[1]]["Configuration"].attrs
    label = text_of(attrs["Label 0"]) if "Label 0" in attrs else parts[1]
    device = devices()["apdm"]
    return replace(
        field,
        unit=field.unit or getattr(device.fields, f"{OPTIONS[field.quantity]}_unit"),
        triad=label.replace("/", "_") or parts[1],
        time_unit=device.fields.time_unit,
        preset=device.name,
    )


def _add_clock(
    field: FieldChannel, nodes: dict[str, Any], file: Any, mapping: FieldMapping
) -> FieldChannel:
    """The field with the nearest time dataset of its length, else with a stated rate."""
    node = nodes[field.parts[0].path]
    if mapping.rate and not mapping.time:
        return replace(field, rate=mapping.rate)

    def stamped(place: FieldPlace, named: str) -> FieldChannel:
        return replace(field, time=place, time_unit=mapping.time_unit or place.unit or named)

    if mapping.time:
        return stamped(_stamps(_node_at(nodes, mapping.time, "time")), field.time_unit)
    if own := _own_clock(node, field.rows, nodes):
        return stamped(*own)
    folder = node.name
    while folder:
        folder = folder.rpartition("/")[0]
        for path, stamps in nodes.items():
            head, _, name = path.rpartition("/")
            fits = stamps.size == field.rows and stamps.dtype.kind in "iuf"
            if head == folder and instant_rank(name) >= 0 and fits:
                (meaning,) = understand([name])
                return stamped(_stamps(stamps), field.time_unit or meaning.unit)
        holder = file[folder] if folder else file
        rate = number_of(node, *RATE_NAMES) or number_of(holder, *RATE_NAMES)
        if rate and rate > 0:
            return replace(field, rate=rate)
    return field


def _own_clock(node: Any, rows: int, nodes: dict[str, Any]) -> tuple[FieldPlace, str] | None:
    """The stamps that a dataset itself names, and the unit of their name: a column of its records,
    or the coordinate of its rows (netCDF)."""
    for column in understand(list(node.dtype.names or ())):
        if column.quantity == "time":
            return place_of(node, node.dtype.names[column.index]), column.unit
    for scale in node.dims[1 if _is_flipped(node) else 0].values():
        if scale.size == rows and scale.dtype.kind in "iuf" and scale.name in nodes:
            return _stamps(scale), understand(words_of(scale.name)[-1:])[0].unit
    return None


def _stamps(node: Any) -> FieldPlace:
    """Stamps (N,), or (1, N) as MATLAB writes a row of them."""
    return place_of(node, transposed=len(node.shape) == 2 and node.shape[0] == 1 < node.shape[1])


def datasets(file: Any, where: str) -> Iterator[Any]:
    """Every numeric or compound dataset with rows, in the file's order."""
    found: list[Any] = []
    visited = 0

    def visit(name: str, node: Any) -> int | None:
        nonlocal visited
        visited += 1
        if name.count("/") > _DEEPEST:
            raise UnreadableInput(
                f"the file nests more than {_DEEPEST} groups",
                where=where,
                remedy="no recording does: copy it again",
            )
        if hasattr(node, "shape") and node.shape and node.size:
            found.append(node)
        if len(found) > _MOST:
            return _MOST
        return _MOST_OBJECTS if visited > _MOST_OBJECTS else None

    most = file.visititems(visit)
    if most:
        raise UnreadableInput(
            f"the file holds more than {most} datasets or groups",
            where=where,
            remedy="write those of one recording to a file of their own",
        )
    for node in found:
        size, stored = node.dtype.itemsize, node.id.get_storage_size()
        if node.size * size > _LARGEST_RATIO * max(stored, 1 << 16) and not node.is_virtual:
            raise UnreadableInput(
                f"{node.name} claims {node.size * size} bytes but stores {stored}",
                where=where,
                remedy="the file's metadata is damaged: copy it again",
            )
        # Each chunk costs its size, whatever is read.
        chunk = math.prod(node.chunks) * size if node.chunks else 0
        if chunk > _LARGE_CHUNK and chunk > _CHUNK_RATIO * stored:
            raise UnreadableInput(
                f"a chunk of {node.name} takes {chunk} bytes, and the file stores {stored}",
                where=where,
                remedy="write it in chunks of some thousand rows",
            )
        yield node


def fields_of(file: Any, held: Iterable[Any], mapping: FieldMapping) -> list[FieldChannel]:
    """All channels in the file's `datasets`, or those that the mapping names; with their clocks."""
    nodes = {node.name: node for node in held}
    each = [
        (node, column, number)
        for node in nodes.values()
        for column in node.dtype.names or ("",)
        for number in _numbers(node)
    ]
    fields = [
        Field((*words_of(n.name), *filter(None, [c])), _width(n, c), _rows(n), number)
        for n, c, number in each
    ]
    stated = {
        quantity: [(k,) for a in addresses for k in _stated(nodes, fields, a, option)]
        for quantity, option in OPTIONS.items()
        if (addresses := getattr(mapping, option))
    }
    found = []
    told = understand([field.name for field in fields])
    for vector in choose(fields, told, mapping, stated):
        places = [
            place_of(n, c, number, transposed=_is_flipped(n), named=told[k].unit)
            for k in vector.parts
            for n, c, number in [each[k]]
        ]
        one = find_channel(vector, places, fields[vector.parts[0]].rows)
        found.append(_add_clock(_add_device(one, file), nodes, file, mapping))
    return found


def _numbers(node: Any) -> Sequence[int]:
    """Which vectors a dataset holds, (n, k, 3); -1 of one that has no more than one."""
    return range(node.shape[1]) if len(node.shape) == 3 and node.shape[2] == 3 else (-1,)


def _is_flipped(node: Any) -> bool:
    return len(node.shape) == 2 and node.shape[1] not in (1, 3) and node.shape[0] == 3


def _rows(node: Any) -> int:
    return int(node.shape[1 if _is_flipped(node) else 0])


def _width(node: Any, column: str) -> int:
    """How many numbers a row has; 0 of what is no number, or no vector."""
    kind = node.dtype[column] if column else node.dtype
    if kind.kind not in "iuf" or kind.shape:
        return 0
    last = node.shape[0] if _is_flipped(node) else (1, *node.shape[1:])[-1]
    return last if last in (1, 3) and len(node.shape) <= 3 else 0


def _stated(nodes: dict[str, Any], fields: Sequence[Field], address: str, option: str) -> list[int]:
    """The fields of the dataset at an address of the mapping. Raises UsageError for none."""
    node = _node_at(nodes, address, option)
    path, width = tuple(words_of(node.name)), 1 if option == "temperature" else 3
    found = [k for k, field in enumerate(fields) if (field.name, field.width) == (path, width)]
    if not found:
        raise UsageError(
            f"dataset {address} has the shape {node.shape}",
            where=f"mapping: {option}",
            remedy=f"name a dataset {'(N,)' if width == 1 else '(N, 3) or (N, K, 3)'}",
        )
    return found
