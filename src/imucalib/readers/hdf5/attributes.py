"""Attributes of HDF5 objects in the spellings that are in use."""

from __future__ import annotations

from typing import Any

import numpy as np

RATE_NAMES = ("sampling_rate", "sample_rate", "SampleRate", "rate", "fs")


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
            each = [_unit(text) for text in _each(node, node.attrs[name], column)]
            return each[0] if len(set(each)) == 1 else ",".join(each)
    return ""


def _unit(value: Any) -> str:
    text = text_of(value)
    for tail in (" per count", " per LSB", "/LSB", "/count", " per lsb"):
        text = text.removesuffix(tail)
    return text


def _each(node: Any, value: Any, column: str) -> list[Any]:
    """The values of an attribute that belong to a column of a table, or to each of three axes."""
    values = np.asarray(value).reshape(-1)
    names = node.dtype.names or ()
    if column in names and values.size == len(names):
        return [values[names.index(column)]]
    return list(values) if values.size == 3 and 3 in node.shape[-2:] else list(values[:1]) or [""]


def numbers_of(node: Any, column: str, names: tuple[str, ...], usual: float) -> tuple[float, ...]:
    """The first attribute of these names, one number or one an axis; else the usual one."""
    for name in names:
        if name in node.attrs:
            try:
                found = tuple(float(v) for v in _each(node, node.attrs[name], column))
            except (TypeError, ValueError):
                continue
            if found and np.isfinite(found).all() and all(v != 0.0 for v in found if usual):
                return found
    return (usual,)


def fills_of(node: Any, column: str = "") -> list[Any]:
    """Values that stand for "no value": netCDF's `_FillValue` and `missing_value`, and what the
    writer chose for rows that are not written. Zero, which nobody chose, is a value."""
    names = ("_FillValue", "missing_value")
    found = [np.asarray(node.attrs[name]).flat for name in names if name in node.attrs]
    fills = [v for values in found for v in values if np.asarray(v).dtype.kind in "iuf"]
    own = node.fillvalue[column] if column in (node.dtype.names or ()) else node.fillvalue
    return [*fills, own] if np.asarray(own).dtype.kind in "iuf" and own else fills


def number_of(node: Any, *names: str) -> float | None:
    """The first attribute of these names that is a finite number."""
    for name in names:
        if name in node.attrs:
            try:
                number = float(np.asarray(node.attrs[name]).flat[0])
            except (TypeError, ValueError, IndexError):
                continue
            if np.isfinite(number):
                return number
    return None
