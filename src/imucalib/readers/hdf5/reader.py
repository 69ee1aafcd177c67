"""HDF5 recordings of any layout: fields are found by walking the file (`hdf5.fields`).

A file whose writer was killed is read in SWMR mode; a chunk with a bad checksum costs only its
rows, and the recording says which. Clock, unit and rate of a channel come from looks all over it.
Other formats that have to be held in memory are read as an HDF5 file with their numbers.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.file_hash import sha256_of
from imucalib.readers.fields import conversion
from imucalib.readers.fields.choice import resolve_mapping
from imucalib.readers.fields.contents import Content, listing, norm_of, suggestion, unread
from imucalib.readers.fields.conversion import AS_STORED, Conversion
from imucalib.readers.fields.joining import Joined
from imucalib.readers.fields.timebase import (
    Stepping,
    date_of,
    find_gaps,
    seconds_of,
    stamps_of,
    start_of,
    stepping,
)
from imucalib.readers.hdf5.fields import (
    FieldChannel,
    FieldPlace,
    datasets,
    fields_of,
    number_of,
    text_of,
    unit_of,
)
from imucalib.readers.hdf5.file import File, FileWalk, opened
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.onboard import Onboard
from imucalib.recording.recording import Channel, Count, Gap, Recording, corrections_of

_ROWS = 500


def _content(node: Any, path: Path, used: Container[str] = ()) -> Content:
    """A dataset with its shape, type and unit, and the norm or median of its first rows.

    used : columns of a table that are not told
    """
    shape = " x ".join(map(str, node.shape[1:]))
    names = [name for name in node.dtype.names or () if name not in used]
    fields = f" of {', '.join(names)}" if names else ""
    unit = unit_of(node)
    kind = f"{shape + ' ' if shape else ''}{node.dtype if not fields else 'records'}{fields}"
    found = Content(node.name, f"{kind} in {unit}" if unit else kind, node.shape[0])
    try:
        FileWalk(str(path)).spans(node, path)
        if not fields and node.dtype.kind in "iuf" and node.shape[1:] in ((), (3,)):
            values = np.asarray(node[:_ROWS], dtype=np.float64)
            if values.ndim == 2:
                return replace(found, norm=norm_of(values))
            return replace(found, median=float(np.median(values[np.isfinite(values)])))
    except UnreadableInput as error:
        return replace(found, why=f"it {error.what.removeprefix(f'{node.name} ')}")
    except (OSError, RuntimeError):
        return replace(found, why="its first rows cannot be read")
    return found


def _unread(nodes: Sequence[Any], signals: Sequence[FieldSignal], path: Path) -> tuple[str, ...]:
    """The sentence on numbers of the file that no signal reads."""
    places = [p for s in signals for p in (*s.found.parts, s.found.time) if p]
    used: dict[str, set[str]] = {}
    for place in places:
        used.setdefault(place.path, set()).add(place.column)
    left = list[Content]()
    for node in nodes:
        names, taken = node.dtype.names, used.get(node.name, set())
        numeric = names or node.dtype.kind in "iuf"
        if numeric and (set(names) - taken if names else not taken):
            left.append(_content(node, path, taken))
    return unread(left)


_LOOKS, _LOOK = 24, 4096  # looks spread over each field, and their rows


@dataclass(frozen=True)
class FieldSignal:
    """One channel ready to read.

    origin : first stamp of its clock, in `found.time_unit`; shift : s from the recording's start to
    that stamp; rate : Hz; threshold : a longer step is a gap, s
    """

    file: File
    found: FieldChannel
    origin: float | int = 0
    shift: float = 0.0
    rate: float = 1.0
    threshold: float = 0.0
    conversion: Conversion = AS_STORED

    @property
    def name(self) -> str:
        return f"{self.found.triad}/{self.found.quantity}"

    def times(self, start: int, stop: int) -> Array:
        """Seconds since the start; NaN where a damaged chunk hides them."""
        place = self.found.time
        if place is None:
            return np.arange(start, stop, dtype=np.float64) / self.rate
        key = place, start, stop, self.origin, self.found.time_unit, self.shift
        if self.file.times is None or self.file.times[0] != key:  # channels of one clock
            self.file.times = key, self._times(place, start, stop)
        return self.file.times[1]

    def _times(self, place: FieldPlace, start: int, stop: int) -> Array:
        found, held = self.file.stored(place, start, stop)
        t = seconds_of(place.unpacked(found).reshape(-1), self.origin, self.found.time_unit)
        t = t + self.shift if self.shift else t
        if held is not None:
            t[~held] = np.nan
        return t

    def stored(self, start: int, stop: int) -> NDArray[np.generic]:
        """Rows (n, 3), or (n, 1) of a temperature, in the stated unit and the type of the file, as
        far as no factor has to be applied."""
        parts = [self.file.rows(p, start, stop) for p in self.found.parts]
        if len(parts) == 1:
            order, whole = self.found.parts[0].order, parts[0].reshape(stop - start, -1)
            return whole if order == (0, 1, 2) else whole[:, order]
        return np.stack([p.reshape(-1) for p in parts], axis=1)


def _looks(found: FieldChannel) -> list[tuple[int, int]]:
    """Row ranges spread over a field."""
    starts = np.linspace(0, max(0, found.rows - _LOOK), _LOOKS).astype(int)
    return [(int(a), min(found.rows, int(a) + _LOOK)) for a in dict.fromkeys(starts.tolist())]


def _signals_of(
    file: File, found: Sequence[FieldChannel], mapping: FieldMapping
) -> tuple[list[FieldSignal], int | None, list[str]]:
    notes: list[str] = []
    start_ns = None
    if number_of(file.handle, "start_ns") is not None:
        start_ns = start_of(np.asarray(file.handle.attrs["start_ns"]).flat[0].item(), notes)
    origin: dict[tuple[str, int | None], float | int] = {}

    def signal(one: FieldChannel) -> FieldSignal:
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
        return _measure(FieldSignal(file, clock, zero, shift, clock.rate or 1.0), mapping)

    signals = list(conversion.readable(found, signal, notes))
    notes += [s.conversion.note for s in signals if s.conversion.note]
    return signals, start_ns, list(dict.fromkeys(notes))


def _clock(file: File, found: FieldChannel) -> tuple[FieldChannel, float | int | None, str]:
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
    where, remedy = f"{file.where}: {found.time.path}", "give --rate, or other stamps with --time"
    stamps = stamps_of(known, found.time_unit, where, who="the file", remedy=remedy)
    return replace(found, time_unit=stamps.unit, epoch=stamps.epoch), stamps.first, stamps.note


def _measure(signal: FieldSignal, mapping: FieldMapping) -> FieldSignal:
    """The signal with its rate, gap threshold and unit, from looks all over the field."""
    found, file = signal.found, signal.file
    stated = {"acceleration": mapping.acc_unit, "angular_rate": mapping.gyro_unit}
    if stated.get(found.quantity) == conversion.COUNTS:
        bare = tuple(replace(p, scale=(1.0,), offset=(0.0,)) for p in found.parts)
        found = replace(found, parts=bare)
        signal = replace(signal, found=found)
    looks = [signal.stored(a, b).astype(np.float64, copy=False) for a, b in _looks(found)]
    stamps = [signal.times(a, b) for a, b in _looks(found)]
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
    whole = [v[g] for v, g in zip(looks, good, strict=True)]
    source = conversion.UnitSource(found.unit)
    how = conversion.of_looks(found.quantity, mapping, source, whole, rate=rate, where=where)
    return replace(signal, conversion=how, rate=rate, threshold=steps.threshold)


def _resolve(mapping: FieldMapping, signals: Sequence[FieldSignal]) -> FieldMapping:
    """What was read, as far as one mapping can say it (a dataset of K triads is named once)."""
    if any(len(s.found.parts) > 1 or s.found.parts[0].column for s in signals):
        return mapping
    clocks = {s.found.time.path for s in signals if s.found.time}
    return resolve_mapping(
        mapping,
        [(s.found, [s.found.parts[0].path], s.conversion.source_unit) for s in signals],
        time=clocks.pop() if len(clocks) == 1 else mapping.time,
        preset=mapping.preset or signals[0].found.preset,
    )


class Held(NamedTuple):
    """What a file says beside the numbers that are held of it.

    notes : what was lost; onboard : by channels, what a flight controller did to them
    """

    notes: tuple[str, ...] = ()
    onboard: Mapping[str, Onboard] = {}


_SIGNATURE = b"\x89HDF\r\n\x1a\n"


class Hdf5Reader(Joined):
    """Reader of HDF5 files; see `imucalib.readers.Reader`."""

    name = "hdf5"
    suffixes = (".h5", ".hdf5", ".hdf", ".he5", ".nxs", ".mat")
    at_once = 1 << 20

    def recognises(self, path: Path, head: bytes) -> bool:
        """The HDF5 signature, at the start or after a user block."""
        return any(head[k : k + 8] == _SIGNATURE for k in (0, 512, 1024, 2048, 4096))

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Yield the fields in blocks of about `block_samples` rows."""
        with opened(path, strict, bool(mapping.allow_external)) as file:
            yield from _blocks_of(file, path, mapping, block_samples)

    def blocks_of(
        self, path: Path, mapping: FieldMapping, channel: str, *, block_samples: int
    ) -> Iterator[Recording]:
        """The same blocks of one channel, without reading the others."""
        with opened(path, False, bool(mapping.allow_external)) as file:
            yield from _blocks_of(file, path, mapping, block_samples, only=channel)


READER = Hdf5Reader()


def _blocks_of(
    file: File, path: Path, mapping: FieldMapping, size: int, *, only: str = ""
) -> Iterator[Recording]:
    """The fields of an open file, or one of them, in blocks of about `size` rows; errors as in
    `Reader.blocks`."""
    nodes = list(datasets(file.handle, file.where))
    found = fields_of(file.handle, nodes, mapping)
    if not any(f.quantity != "temperature" for f in found):
        held = [_content(node, path) for node in nodes]
        raise UnreadableInput(
            f"no inertial dataset was found among:{listing(held) or ' none'}\n",
            where=file.where,
            remedy="Name them with --acc, --gyro and --time or --rate (dataset paths)"
            + suggestion(held),
        )
    signals, start_ns, notes = _signals_of(file, found, mapping)
    marks = corrections_of(text_of(file.handle.attrs.get("corrections", "")).split("\n"))
    empty = Recording(
        {},
        str(path),
        "hdf5",
        sha256_of(path),
        start_ns,
        mapping=_resolve(mapping, signals).to_dict(),
        corrections=marks,
        device=text_of(file.handle.attrs.get("device", "")),
        serial=text_of(file.handle.attrs.get("serial", "")),
    )
    notes += map(str, marks)
    notes += _unread(nodes, signals, path)
    signals = [s for s in signals if only in ("", s.name)]
    last: dict[str, float] = {}
    at, read = ({s.name: 0 for s in signals} for _ in range(2))
    main = max(signals, key=lambda s: s.found.rows)
    while True:
        until = _time_after(main, at[main.name] + size)
        channels, gaps = {}, {}
        for signal in signals:
            stop = _stop(signal, main, at[signal.name], size=size, until=until)
            channel, new = _channel(signal, at[signal.name], stop, last)
            at[signal.name] = stop
            gaps.update({(g.start, g.stop): g for g in new})
            if channel is not None:
                read[signal.name] += channel.t.size
                channels[signal.name] = channel
        ended = all(at[s.name] >= s.found.rows for s in signals)
        counts = [_count(s, read[s.name]) for s in signals if ended]
        left = [note for count in counts for note in _left_out(count)]
        own = (*notes, *file.lost, *left)
        notes, file.lost = [], []
        block = replace(empty, channels=channels, gaps=tuple(gaps.values()), notes=own)
        yield replace(block, counts=tuple(counts))
        if ended:
            return


def _count(signal: FieldSignal, read: int) -> Count:
    rows = signal.found.rows
    return Count(signal.name, rows, read, {"lack a value or a stamp": rows - read})


def _left_out(count: Count) -> Iterator[str]:
    for why, rows in count.left.items():
        if rows:
            yield f"{count.source}: {rows} rows {why}, left out"


def _time_after(signal: FieldSignal, row: int) -> float:
    """Time of a row of the main channel, or infinity past its end."""
    if row >= signal.found.rows:
        return float("inf")
    t = signal.times(row, row + 1)
    return float(t[0]) if np.isfinite(t[0]) else float("-inf")


def _stop(signal: FieldSignal, main: FieldSignal, row: int, *, size: int, until: float) -> int:
    """Where this channel's block ends: at the main channel's row, or at its time."""
    rows = signal.found.rows
    same = signal.found.time == main.found.time and signal.found.rate == main.found.rate
    if same and rows == main.found.rows:
        return min(rows, row + size)
    if until == float("inf"):
        return rows
    while row < rows:
        t = signal.times(row, min(rows, row + size))
        inside = int(np.searchsorted(t, until))
        row += inside
        if inside < t.size:
            break
    return row


def _channel(
    signal: FieldSignal, start: int, stop: int, last: dict[str, float]
) -> tuple[Channel | None, list[Gap]]:
    """The channel and its gaps."""
    if stop <= start:
        return None, []
    found = signal.found
    t, raw = signal.times(start, stop), signal.stored(start, stop)
    rows: Array | range = range(start, stop)
    counted = found.time is None
    if not ((counted or _finite(t)) and _finite(raw)):
        usable = np.isfinite(t) & np.isfinite(raw).all(axis=1)
        if not usable.any():
            return None, []
        t, raw, rows = t[usable], raw[usable], np.arange(start, stop)[usable]
    gaps = []
    if found.quantity != "temperature":
        # Times that are counted have no gap where no row was left out.
        new = slice(0, 1) if counted and isinstance(rows, range) else slice(None)
        gaps = find_gaps(t[new], rows[new], signal.threshold, last.get(signal.name))
    last[signal.name] = float(t[-1])
    return Channel(
        t=t,
        values=signal.conversion.apply(raw),
        quantity=found.quantity,
        triad=found.triad,
        rate=signal.rate,
        names=(found.address,) if found.address else (),
        numbered=found.numbered,
        **signal.conversion.units,
    ), gaps


def _finite(values: NDArray[np.generic]) -> bool:
    """Whether all are: a sum that is finite has no other terms, and is faster than a look."""
    if values.dtype.kind in "iu":
        return True
    with np.errstate(invalid="ignore", over="ignore"):
        return bool(np.isfinite(np.sum(values)) or np.isfinite(values).all())


class HeldReader(Joined):
    """A reader that holds a file's numbers in memory, and reads them as those of an HDF5 file."""

    name = ""
    at_once = 1 << 20

    @abstractmethod
    def fill(self, held: Any, path: Path, *, strict: bool) -> Held:
        """Put the numbers into `held`, an HDF5 file that is nowhere but in memory. Raises
        UnreadableInput; with `strict` for what is damaged, too."""

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Yield blocks of about `block_samples` rows."""
        import h5py

        with h5py.File(f"{path.name}-in-memory", "w", driver="core", backing_store=False) as held:
            own = self.fill(held, path, strict=strict)
            notes = own.notes
            for block in _blocks_of(File(held, str(path), strict), path, mapping, block_samples):
                channels = {
                    key: replace(one, onboard=own.onboard.get(key))
                    for key, one in block.channels.items()
                }
                found = replace(block, channels=channels, format=self.name)
                yield replace(found, notes=(*notes, *block.notes))
                notes = ()


def put_channel(held: Any, name: str, seconds: Array, values: Array, units: str) -> None:
    """One channel, "imu0/acceleration", with its own clock in s and its stated unit."""
    group = held.create_group(name)
    group.create_dataset("time", data=seconds).attrs["units"] = "s"
    group.create_dataset("values", data=values).attrs["units"] = units


def table_columns(path: Path, most: int = 0) -> dict[str, Array | list[str]]:
    """Every column by name: a dataset (n,), a field of a compound one, x, y, z of one (n, 3).

    most : rows that are read, all where it is 0
    Raises UnreadableInput for a damaged file and for columns of different length.
    """
    with opened(path, strict=True) as file:
        nodes = list(datasets(file.handle, str(path)))
        for node in nodes:
            file.demand_whole(node)
        found = dict(part for node in nodes for part in _columns(node, most))
    if len({len(v) for v in found.values()}) > 1:
        sizes = ", ".join(f"{name} {len(v)}" for name, v in found.items())
        raise UnreadableInput(f"datasets of different length ({sizes})", where=str(path))
    return found


def _columns(node: Any, most: int) -> Iterator[tuple[str, Array | list[str]]]:
    values = np.asarray(node[:most] if most and node.shape else node[...])
    if values.dtype.names:
        for field in values.dtype.names:
            yield field, _column(values[field])
    elif values.ndim == 1 and values.dtype.kind in "iufSO":
        yield node.name.rsplit("/", maxsplit=1)[-1], _column(values)
    elif values.ndim == 2 and values.shape[1] == 3 and values.dtype.kind in "iuf":
        yield from zip("xyz", values.T.astype(np.float64), strict=True)


def _column(values: Any) -> Array | list[str]:
    if values.dtype.kind in "iuf":
        return np.asarray(values, np.float64)
    return [text_of(value) for value in values]
