"""What is known of devices: each module of this folder that has a `DEVICE` describes one.

A device is found by its file being here: how the lines above its tables name it, what its columns
and units are where a file does not say, and what only its header says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

from imucalib.core.discovery import modules_of
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.fields.source import REFUSED, file_kind
from imucalib.recording.mapping import FieldMapping


@dataclass(frozen=True)
class DeviceStart:
    """start_ns : start of the recording as in Recording, or None; notes : what was supposed

    rate (Hz), units (of quantities) : where only the device's own form of the header says them
    """

    start_ns: int | None = None
    notes: tuple[str, ...] = ()
    rate: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Device:
    """One source of recordings.

    name : of the preset (`--preset`) and in what was resolved
    fields : columns and units of its tables; columns by number serve tables without headings
    words : any of these above a table, in lower case, names the device; none: never recognised
    heading : how many of the first lines are a heading although they look like rows, which names
        the device too
    start : the start time from the lines above the table; None where they do not say it
    scales : counts a g that its models have, where the files do not say which
    refuse : (those lines, where) -> raises UnreadableInput for exports that hold no raw data
    sleeps : rows of zeros, or the last reading repeated, mean "not recorded"
    source : of the first lines of a true export, which lie in `examples`
    """

    name: str
    fields: FieldMapping = field(default_factory=FieldMapping)
    words: tuple[str, ...] = ()
    heading: Callable[[Sequence[str]], int] = lambda lines: 0
    start: Callable[[str], DeviceStart] | None = None
    scales: tuple[float, ...] = ()
    refuse: Callable[[str, str], None] = lambda text, where: None
    sleeps: bool = False
    source: str = ""

    @property
    def example(self) -> str:
        """The first lines of a true export, or "" where none is known."""
        path = Path(__file__).parent / "examples" / f"{self.name}.txt"
        return path.read_text(encoding="utf-8") if self.source else ""


@cache
def devices() -> dict[str, Device]:
    """Every device by name, in the order of the files."""
    package = __name__.rpartition(".")[0]
    found = (m.DEVICE for m in modules_of(package) if hasattr(m, "DEVICE"))
    return {device.name: device for device in found}


#: A table of no device that is known.
UNKNOWN = Device("")


def device_named_in(text: str) -> Device:
    """The device that the lines above a table name, or `UNKNOWN`."""
    lower, lines = text.lower(), text.split("\n")
    found = (d for d in devices().values() if any(w in lower for w in d.words) or d.heading(lines))
    return next(found, UNKNOWN)


def rows_of_heading(lines: Sequence[str]) -> int:
    """How many of the first lines are some device's heading although they look like rows."""
    return max(d.heading(lines) for d in devices().values())


def with_preset(mapping: FieldMapping) -> FieldMapping:
    """The mapping, filled from its preset. Raises UsageError for an unknown preset."""
    if not mapping.preset:
        return mapping
    device = devices().get(mapping.preset)
    if device is None:
        raise UsageError(
            f"unknown preset '{mapping.preset}'",
            where="mapping: preset",
            remedy=f"use one of: {', '.join(devices())}",
        )
    return mapping.fill_from(replace(device.fields, preset=device.name))


def refuse_foreign(path: Path, head: bytes) -> None:
    """Raise UnreadableInput, with the true name, for a known format that is not read, and for a
    file that is no recording."""
    kind = file_kind(head, REFUSED)
    if kind is not None:
        raise UnreadableInput(f"this is {kind.name}", where=str(path), remedy=kind.remedy)
