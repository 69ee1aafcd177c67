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


def unit_of(node: Any) -> str:
    """The unit attribute in any of its usual spellings, without "per count"."""
    for name in ("units", "unit", "Units", "Unit", "UNITS"):
        if name in node.attrs:
            text = text_of(node.attrs[name])
            for tail in (" per count", " per LSB", "/LSB", "/count", " per lsb"):
                text = text.removesuffix(tail)
            return text
    return ""


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
