"""The channels of an HDF5 file, ready to read: clock, unit and rate from looks all over it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers import conversion
from imucalib.readers.conversion import Conversion
from imucalib.readers.hdf5.attributes import number_of
from imucalib.readers.hdf5.clock import Found
from imucalib.readers.hdf5.file import File
from imucalib.readers.timebase import (
    Stepping,
    clock_unit,
    date_of,
    guess_unit,
    seconds_of,
    start_of,
    stepping,
)
from imucalib.recording.mapping import TIME_UNITS, FieldMapping

_LOOKS, _LOOK = 24, 4096  # looks spread over each field, and their rows
_REST_SECONDS = 0.5


@dataclass(frozen=True)
class Signal:
    """One channel ready to read; origin : first stamp of its clock, in `found.time_unit`;
    shift : s from the recording's start to that stamp."""

    found: Found
    conversion: Conversion
    rate: float
    threshold: float
    origin: float | int
    shift: float = 0.0

    @property
    def name(self) -> str:
        return f"{self.found.triad}/{self.found.quantity}"


def times(file: File, signal: Signal, start: int, stop: int) -> Array:
    """Seconds since the start; NaN where a damaged chunk hides them."""
    if signal.found.time is None:
        t = np.arange(start, stop, dtype=np.float64)
        t /= signal.rate
        return t
    place = signal.found.time
    found, held = file.stored(place, start, stop)
    t = seconds_of(place.unpacked(found).reshape(-1), signal.origin, signal.found.time_unit)
    t = t + signal.shift if signal.shift else t
    if held is not None:
        t[~held] = np.nan
    return t


def raw_rows(file: File, found: Found, start: int, stop: int) -> Array:
    """Rows (n, 3), or (n, 1) of a temperature, in the stated unit."""
    return stored_rows(file, found, start, stop).astype(np.float64, copy=False)


def stored_rows(file: File, found: Found, start: int, stop: int) -> NDArray[np.generic]:
    """The same in the type of the file, as far as no factor has to be applied."""
    parts = [file.rows(p, start, stop) for p in found.parts]
    if len(parts) == 1:
        return parts[0].reshape(stop - start, -1)
    return np.stack([p.reshape(-1) for p in parts], axis=1)


def _looks(found: Found) -> list[tuple[int, int]]:
    """Row ranges spread over a field."""
    starts = np.linspace(0, max(0, found.rows - _LOOK), _LOOKS).astype(int)
    return [(int(a), min(found.rows, int(a) + _LOOK)) for a in dict.fromkeys(starts.tolist())]


def signals_of(
    file: File, found: Sequence[Found], mapping: FieldMapping
) -> tuple[list[Signal], int | None, list[str]]:
    notes: list[str] = []
    start_ns = None
    if number_of(file.handle, "start_ns") is not None:
        start_ns = start_of(np.asarray(file.handle.attrs["start_ns"]).flat[0].item(), notes)
    origin: dict[tuple[str, int | None], float | int] = {}

    def signal(one: Found) -> Signal:
        nonlocal start_ns
        clock, first, note = _clock(file, one)
        notes.extend([note] if note else [])
        zero: float | int = 0
        shift = 0.0
        if first is not None and date_of(first, clock.time_unit, clock.epoch) is not None:
            dated = bool(origin)
            zero = origin.setdefault((clock.time_unit, clock.epoch), first)
            own = date_of(zero, clock.time_unit, clock.epoch) or 0
            start_ns = start_ns if dated else own
            shift = (own - (start_ns or 0)) * 1e-9
        base = Signal(
            clock, Conversion("", "", np.ones(1), np.zeros(1)), clock.rate or 1.0, 0.0, zero, shift
        )
        return _measured(file, base, mapping)

    signals = list(conversion.readable(found, signal, notes))
    notes += [s.conversion.note for s in signals if s.conversion.note]
    return signals, start_ns, list(dict.fromkeys(notes))


def _clock(file: File, found: Found) -> tuple[Found, float | int | None, str]:
    """The field with its time unit known, the first stamp, and how the unit was found."""
    if found.time is None:
        if found.rate is None:
            raise UnreadableInput(
                f"{found.parts[0].path} has neither time stamps nor a sample rate",
                where=file.where,
                remedy="give --time (a dataset path) or --rate",
            )
        return found, None, ""
    node = file.handle[found.time.path]
    if node.shape[0] != found.rows and node.size != found.rows:
        raise UnreadableInput(
            f"{found.time.path} has {node.size} stamps for {found.rows} rows of "
            f"{found.parts[0].path}",
            where=file.where,
        )
    looks = [file.rows(found.time, a, b).reshape(-1) for a, b in _looks(found)]
    known = [s[np.isfinite(s.astype(np.float64))] for s in looks]
    first = next((s[0].item() for s in known if s.size), None)
    where = f"{file.where}: {found.time.path}"
    (unit, epoch), note = clock_unit(found.time_unit, where), ""
    if unit not in TIME_UNITS:
        steps = stepping([s.astype(np.float64) for s in known])
        if steps is None or first is None:
            raise UnreadableInput("the time stamps never advance", where=where)
        guessed, note = guess_unit(float(first), steps.step, where)
        if unit and date_of(first, guessed) is None:
            raise UnreadableInput(
                f"the file states the unknown unit of time '{unit[:40]}'", where=where,
                remedy=f"name it with --time-unit: {', '.join(TIME_UNITS)}",
            )  # fmt: skip
        unit = guessed
    return replace(found, time_unit=unit, epoch=epoch), first, note


def _measured(file: File, signal: Signal, mapping: FieldMapping) -> Signal:
    """The signal with its rate, gap threshold and unit, from looks all over the field."""
    found = signal.found
    raw_counts = found.quantity == "acceleration" and mapping.acc_unit == conversion.COUNTS
    raw_counts |= found.quantity == "angular_rate" and mapping.gyro_unit == conversion.COUNTS
    if raw_counts:
        bare = tuple(replace(p, scale=(1.0,), offset=(0.0,)) for p in found.parts)
        found = replace(found, parts=bare)
    looks = [raw_rows(file, found, a, b) for a, b in _looks(found)]
    stamps = [times(file, signal, a, b) for a, b in _looks(found)]
    good = [np.isfinite(v).all(axis=1) & np.isfinite(t) for v, t in zip(looks, stamps, strict=True)]
    steps = stepping([t[g] for t, g in zip(stamps, good, strict=True)])
    if steps is None:
        if found.rate is None:
            why = "the time never advances" if any(g.any() for g in good) else "holds no number"
            remedy = "give --rate, or other stamps with --time"
            raise UnreadableInput(f"{signal.name}: {why}", where=file.where, remedy=remedy)
        steps = Stepping(1.0 / found.rate, 1.75 / found.rate)
    rate = found.rate or 1.0 / steps.step
    where = f"{file.where}: {found.parts[0].path}"
    if found.quantity == "acceleration":
        window = max(3, round(_REST_SECONDS * rate))
        rest = conversion.readings_at_rest([v[g] for v, g in zip(looks, good, strict=True)], window)
        how = conversion.acceleration(mapping, found.unit, rest, where)
    elif found.quantity == "angular_rate":
        how = conversion.angular_rate(mapping, found.unit, where)
    else:
        how = conversion.temperature(mapping, found.unit, np.concatenate(looks)[:, 0], where)
    return replace(signal, found=found, conversion=how, rate=rate, threshold=steps.threshold)


def resolved_mapping(mapping: FieldMapping, signals: Sequence[Signal]) -> FieldMapping:
    """What was read, as far as one mapping can say it (a dataset of K triads is named once)."""

    def paths(quantity: str) -> tuple[str, ...]:
        chosen = [s.found.parts[0].path for s in signals if s.found.quantity == quantity]
        return tuple(dict.fromkeys(chosen))

    def unit(quantity: str) -> str:
        units = {s.conversion.source_unit for s in signals if s.found.quantity == quantity}
        return units.pop() if len(units) == 1 else ""

    if any(len(s.found.parts) > 1 or s.found.parts[0].column for s in signals):
        return mapping
    clocks = {s.found.time.path for s in signals if s.found.time}
    return replace(
        mapping,
        acc=paths("acceleration"), gyro=paths("angular_rate"), temperature=paths("temperature"),
        time=clocks.pop() if len(clocks) == 1 else mapping.time,
        triads=tuple(dict.fromkeys(s.found.triad for s in signals)),
        acc_unit=unit("acceleration"), gyro_unit=unit("angular_rate"),
        temperature_unit=unit("temperature"),
        preset=mapping.preset or signals[0].found.preset,
    )  # fmt: skip
