"""What an HDF5 file holds: inertial fields found by walking its datasets, names and attributes.

h5py is passed in as objects; this module does not import it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.columns import understand
from imucalib.readers.hdf5.clock import (
    TIME_NAMES,
    Found,
    Place,
    found_in,
    node_at,
    place_of,
    with_clock,
    with_device,
    words_of,
)
from imucalib.recording.mapping import FieldMapping

_QUANTITY = {
    "accelerometer": "acceleration", "acceleration": "acceleration", "accel": "acceleration",
    "acc": "acceleration", "linear_acceleration": "acceleration", "accelerations": "acceleration",
    "gyroscope": "angular_rate", "gyro": "angular_rate", "gyr": "angular_rate",
    "angular_velocity": "angular_rate", "angular_rate": "angular_rate",
    "angular_velocities": "angular_rate", "omega": "angular_rate",
    "temperature": "temperature", "temp": "temperature",
}  # fmt: skip
_GENERIC = {"sensors", "data", "raw", "calibrated", "imu", "readings", "table", "", "value",
            "values", "processed", "x"}  # fmt: skip
_MOST = 4096  # datasets with rows: each costs half a millisecond before it is read
_MOST_OBJECTS = 4 * _MOST  # with groups and datasets without rows: each costs 0.15 ms
_DEEPEST = 32  # groups within groups
_LARGE_CHUNK, _CHUNK_RATIO = 64 << 20, 100
_LARGEST_RATIO = 2000  # logical over stored bytes; deflate cannot do more than about 1032


def datasets(file: Any, where: str) -> Iterator[Any]:
    """Every numeric or compound dataset with rows, in the file's order."""
    found: list[Any] = []
    visited = 0

    def visit(name: str, node: Any) -> int | None:
        nonlocal visited
        visited += 1
        if name.count("/") > _DEEPEST:
            raise UnreadableInput(
                f"the file nests more than {_DEEPEST} groups", where=where,
                remedy="no recording does: copy it again",
            )  # fmt: skip
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
        logical, stored = node.size * node.dtype.itemsize, node.id.get_storage_size()
        if logical > _LARGEST_RATIO * max(stored, 1 << 16) and not node.is_virtual:
            raise UnreadableInput(
                f"{node.name} claims {logical} bytes but stores {stored}",
                where=where,
                remedy="the file's metadata is damaged: copy it again",
            )
        _demand_small_chunks(node, stored, where)
        yield node


def _demand_small_chunks(node: Any, stored: int, where: str) -> None:
    """Refuse chunks that are large and nearly empty: each costs its size, whatever is read."""
    chunk = math.prod(node.chunks or ()) * node.dtype.itemsize if node.chunks else 0
    if chunk > _LARGE_CHUNK and chunk > _CHUNK_RATIO * stored:
        raise UnreadableInput(
            f"a chunk of {node.name} takes {chunk} bytes, and the file stores {stored}",
            where=where,
            remedy="write it in chunks of some thousand rows",
        )


def fields_of(file: Any, held: Iterable[Any], mapping: FieldMapping) -> list[Found]:
    """All channels in the file's `datasets`, or those that the mapping names; with their clocks."""
    nodes = {node.name: node for node in held}
    if mapping.acc or mapping.gyro:
        found = list(_stated(nodes, mapping))
        found += list(_temperatures_beside(nodes, found))
    else:
        found = [f for node in nodes.values() for f in _vectors(node)]
        found += list(_single_axes(nodes))
    if mapping.temperature:
        found = [f for f in found if f.quantity != "temperature"]
        found += list(_stated_temperatures(nodes, mapping))
    return [with_clock(with_device(f, file), nodes, file, mapping) for f in _unique(found)]


def _unique(found: list[Found]) -> list[Found]:
    seen: dict[tuple[str, str], Found] = {}
    for field in found:
        seen.setdefault((field.triad, field.quantity), field)
    return list(seen.values())


def _quantity_of(path: str) -> tuple[str, int]:
    """Quantity that the path names, and which of its parts does; "" and -1 when none."""
    parts = words_of(path)
    for k in range(len(parts) - 1, -1, -1):
        name = parts[k].lower()
        for tail in ("_counts", "_raw", "_data", "_xyz"):
            name = name.removesuffix(tail)
        if name in _QUANTITY:
            return _QUANTITY[name], k
    return "", -1


def _triad_name(parts: list[str], number: int) -> str:
    left = [p for p in parts if p.lower() not in _GENERIC]
    base = "_".join(left)
    if number >= 0:
        return f"{base}_imu{number}" if base else f"imu{number}"
    return base or "imu0"


def _vectors(node: Any) -> Iterator[Found]:
    """The channels in one dataset whose path names the quantity."""
    if node.dtype.kind not in "iuf":
        return
    quantity, at = _quantity_of(node.name)
    if not quantity or words_of(node.name)[-1].lower() in TIME_NAMES:
        return
    above, shape = words_of(node.name)[:at], node.shape
    if quantity == "temperature":
        if len(shape) == 1 or (len(shape) == 2 and shape[1] == 1):
            yield found_in(quantity, _triad_name(above, -1), [place_of(node)], shape[0])
        return
    if len(shape) == 2 and 3 in shape:
        flipped = shape[1] != 3
        place = place_of(node, transposed=flipped)
        yield found_in(quantity, _triad_name(above, -1), [place], shape[1 if flipped else 0])
    if len(shape) == 3 and shape[2] == 3:
        for k in range(shape[1]):
            name = _triad_name(above, k)
            one = found_in(quantity, name, [place_of(node, triad=k)], shape[0])
            yield replace(one, numbered=name == f"imu{k}")


def _single_axes(nodes: dict[str, Any]) -> Iterator[Found]:
    """Triads whose axes are datasets of their own, or columns of a table."""
    groups: dict[str, list[tuple[str, str, Any]]] = {}
    for path, node in nodes.items():
        if node.dtype.names:
            for name in node.dtype.names:
                groups.setdefault(path, []).append((name, name, node))
        elif len(node.shape) == 1:
            folder, _, name = path.rpartition("/")
            groups.setdefault(folder, []).append((name, "", node))
    for folder, members in groups.items():
        axes: dict[tuple[str, str], dict[int, tuple[Place, Any]]] = {}
        for column, (_, field, node) in zip(
            understand([m[0] for m in members]), members, strict=True
        ):
            if column.axis >= 0:
                triads = axes.setdefault((column.quantity, column.triad), {})
                triads.setdefault(column.axis, (place_of(node, field, named=column.unit), node))
        for (quantity, triad), three in axes.items():
            if len(three) == 3 and len({node.shape for _, node in three.values()}) == 1:
                name = _triad_name(words_of(folder), -1) if triad == "imu0" else triad
                parts = [three[k][0] for k in range(3)]
                yield found_in(quantity, name, parts, three[0][1].shape[0])


def _stated(nodes: dict[str, Any], mapping: FieldMapping) -> Iterator[Found]:
    for quantity, option in (("acceleration", "acc"), ("angular_rate", "gyro")):
        count = 0
        for address in getattr(mapping, option):
            node = node_at(nodes, address, option)
            whole = _all_triads(node, quantity)
            if not whole:
                raise UsageError(
                    f"dataset {address} has the shape {node.shape}",
                    where=f"mapping: {option}",
                    remedy="name a dataset (N, 3) or (N, K, 3)",
                )
            for field in whole:
                known = count < len(mapping.triads)
                named = mapping.triads[count] if known else f"imu{count}"
                yield replace(field, triad=named, numbered=not known)
                count += 1


def _all_triads(node: Any, quantity: str) -> list[Found]:
    """The triads in one dataset, whatever its name says."""
    shape = node.shape
    if node.dtype.kind not in "iuf":
        return []
    if len(shape) == 3 and shape[2] == 3:
        places = [place_of(node, triad=k) for k in range(shape[1])]
    elif len(shape) == 2 and 3 in shape:
        places = [place_of(node, transposed=shape[1] != 3)]
    else:
        return []
    rows = shape[1] if places[0].transposed else shape[0]
    return [found_in(quantity, "", [p], rows) for p in places]


def _temperatures_beside(nodes: dict[str, Any], stated: list[Found]) -> Iterator[Found]:
    """Temperatures in the folder of a stated triad, or of a file with one triad."""
    triads = tuple(dict.fromkeys(f.triad for f in stated))
    for node in nodes.values():
        for field in _vectors(node):
            if field.quantity == "temperature":
                near = [f.triad for f in stated if _holder(f) == _holder(field)]
                for triad in dict.fromkeys(near) or triads[: len(triads) == 1]:
                    yield replace(field, triad=triad)


def _holder(field: Found) -> list[str]:
    """The folder of the sensor that a field belongs to."""
    parts = words_of(field.parts[0].path)
    _, at = _quantity_of(field.parts[0].path)
    return parts[: at if at >= 0 else -1]


def _stated_temperatures(nodes: dict[str, Any], mapping: FieldMapping) -> Iterator[Found]:
    for k, address in enumerate(mapping.temperature):
        node = node_at(nodes, address, "temperature")
        triad = mapping.triads[k] if k < len(mapping.triads) else f"imu{k}"
        yield found_in("temperature", triad, [place_of(node)], node.shape[0])
