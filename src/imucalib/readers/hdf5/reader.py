"""HDF5 recordings of any layout: fields are found by walking the file (`hdf5.fields`).

A file whose writer was killed is read in SWMR mode; a chunk with a bad checksum costs only its
rows, and the recording says which. Clock, unit and rate of a channel come from looks all over it.
Other formats that have to be held in memory are read as an HDF5 file with their numbers.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.file_hash import sha256_of
from imucalib.readers.fields import conversion
from imucalib.readers.fields.choice import resolve_mapping
from imucalib.readers.fields.contents import Content, describe_unread, listing, norm_of, suggestion
from imucalib.readers.fields.joining import Joined
from imucalib.readers.fields.timebase import (
    Stamps,
    Stepping,
    date_of,
    find_gaps,
    measure_steps,
    stamps_of,
    start_of,
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
from imucalib.readers.hdf5.file import File, FileWalk, open_file
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.onboard import Onboard
from imucalib.recording.recording import Channel, Count, Gap, Recording, corrections_of

_ROWS = 500
_LOOKS, _LOOK = 24, 4096  # looks spread over each field, and their rows
_SIGNATURE = b"\x89HDF\r\n\x1a\n"


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


def _unread(nodes: Sequence[Any], signals: Sequence[FieldChannel], path: Path) -> tuple[str, ...]:
    """The sentence on numbers of the file that no signal reads."""
    places = [p for s in signals for p in (*s.parts, s.time) if p]
    used: dict[str, set[str]] = {}
    for place in places:
        used.setdefault(place.path, set()).add(place.column)
    left = list[Content]()
    for node in nodes:
        names, taken = node.dtype.names, used.get(node.name, set())
        numeric = names or node.dtype.kind in "iuf"
        if numeric and (set(names) - taken if names else not taken):
            left.append(_content(node, path, taken))
    return describe_unread(left)


def _looks(found: FieldChannel) -> list[tuple[int, int]]:
    """Row ranges spread over a field."""
    starts = np.linspace(0, max(0, found.rows - _LOOK), _LOOKS).astype(int)
    return [(int(a), min(found.rows, int(a) + _LOOK)) for a in dict.fromkeys(starts.tolist())]


def _measure_all(
    file: File, found: Sequence[FieldChannel], mapping: FieldMapping
) -> tuple[list[FieldChannel], int | None, list[str]]:
    """The channels with clock, rate and unit, the start (ns since 1970), and notes."""
    notes: list[str] = []
    start_ns = None
    if number_of(file.handle, "start_ns") is not None:
        start_ns = start_of(np.asarray(file.handle.attrs["start_ns"]).flat[0].item(), notes)
    origin: dict[tuple[str, int | None], float | int] = {}

    def measure(one: FieldChannel) -> FieldChannel:
        nonlocal start_ns
        if one.time is not None:
            stamps = _stamps_of(file, one, one.time)
            one = replace(one, time_unit=stamps.unit)
            notes.extend([stamps.note] if stamps.note else [])
            if date_of(stamps.first, stamps.unit, stamps.epoch) is not None:
                dated = bool(origin)
                zero = origin.setdefault((stamps.unit, stamps.epoch), stamps.first)
                own = date_of(zero, stamps.unit, stamps.epoch) or 0
                start_ns = start_ns if dated else own
                one = replace(one, origin=zero, shift=(own - (start_ns or 0)) * 1e-9)
        elif one.rate is None:
            raise UnreadableInput(
                f"{one.parts[0].path} has neither time stamps nor a sample rate",
                where=file.where,
                remedy="give --time (a dataset path) or --rate",
            )
        return _measure(file, one, mapping)

    signals = list(conversion.make_readable(found, measure, notes))
    notes += [s.conversion.note for s in signals if s.conversion.note]
    return signals, start_ns, list(dict.fromkeys(notes))


def _stamps_of(file: File, one: FieldChannel, place: FieldPlace) -> Stamps:
    """What the stamps of a channel say, from looks all over them."""
    node = file.handle[place.path]
    if node.shape[0] != one.rows and node.size != one.rows:
        raise UnreadableInput(
            f"{place.path} has {node.size} stamps for {one.rows} rows of {one.parts[0].path}",
            where=file.where,
        )
    looks = [file.rows(place, a, b).reshape(-1) for a, b in _looks(one)]
    known = [s[np.isfinite(s.astype(np.float64))] for s in looks]
    where, remedy = f"{file.where}: {place.path}", "give --rate, or other stamps with --time"
    return stamps_of(known, one.time_unit, where, who="the file", remedy=remedy)


def _measure(file: File, one: FieldChannel, mapping: FieldMapping) -> FieldChannel:
    """The channel with its rate, gap threshold and unit, from looks all over the field."""
    stated = {"acceleration": mapping.acc_unit, "angular_rate": mapping.gyro_unit}
    if stated.get(one.quantity) == conversion.COUNTS:
        bare = tuple(replace(p, scale=(1.0,), offset=(0.0,)) for p in one.parts)
        one = replace(one, parts=bare)
    looks = [file.values(one, a, b).astype(np.float64, copy=False) for a, b in _looks(one)]
    stamps = [file.times(one, a, b) for a, b in _looks(one)]
    good = [np.isfinite(v).all(axis=1) & np.isfinite(t) for v, t in zip(looks, stamps, strict=True)]
    steps = measure_steps([t[g] for t, g in zip(stamps, good, strict=True)])
    if steps is None:
        if one.rate is None:
            why = "the time never advances" if any(g.any() for g in good) else "holds no number"
            remedy = "give --rate, or other stamps with --time"
            raise UnreadableInput(f"{one.name}: {why}", where=file.where, remedy=remedy)
        steps = Stepping(1.0 / one.rate, 1.75 / one.rate)
    rate = one.rate or 1.0 / steps.step
    where = f"{file.where}: {one.parts[0].path}"
    whole = [v[g] for v, g in zip(looks, good, strict=True)]
    source = conversion.UnitSource(one.unit)
    how = conversion.find_conversion(one.quantity, mapping, source, whole, rate=rate, where=where)
    return replace(one, conversion=how, rate=rate, threshold=steps.threshold)


def _resolve(mapping: FieldMapping, signals: Sequence[FieldChannel]) -> FieldMapping:
    """What was read, as far as one mapping can say it (a dataset of K triads is named once)."""
    if any(len(s.parts) > 1 or s.parts[0].column for s in signals):
        return mapping
    clocks = {s.time.path for s in signals if s.time}
    return resolve_mapping(
        mapping,
        [(s, [s.parts[0].path], s.conversion.source_unit) for s in signals],
        time=clocks.pop() if len(clocks) == 1 else mapping.time,
        preset=mapping.preset or signals[0].preset,
    )


class Held(NamedTuple):
    """What a file says beside the numbers that are held of it.

    notes : what was lost; onboard : by channels, what a flight controller did to them
    """

    notes: tuple[str, ...] = ()
    onboard: Mapping[str, Onboard] = {}


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
        with open_file(path, strict, bool(mapping.allow_external)) as file:
            yield from _blocks_of(file, path, mapping, block_samples)


READER = Hdf5Reader()


def _blocks_of(file: File, path: Path, mapping: FieldMapping, size: int) -> Iterator[Recording]:
    """The fields of an open file in blocks of about `size` rows; errors as in `Reader.blocks`."""
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
    signals, start_ns, notes = _measure_all(file, found, mapping)
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
    last: dict[str, float] = {}
    at, read = ({s.name: 0 for s in signals} for _ in range(2))
    main = max(signals, key=lambda s: s.rows)
    while True:
        until = _time_after(file, main, at[main.name] + size)
        channels, gaps = {}, {}
        for signal in signals:
            stop = _stop(file, signal, main, at[signal.name], size, until)
            channel, new = _channel(file, signal, at[signal.name], stop, last)
            at[signal.name] = stop
            gaps.update({(g.start, g.stop): g for g in new})
            if channel is not None:
                read[signal.name] += channel.t.size
                channels[signal.name] = channel
        ended = all(at[s.name] >= s.rows for s in signals)
        counts = [_count(s, read[s.name]) for s in signals if ended]
        left = [
            f"{count.source}: {rows} rows {why}, left out"
            for count in counts
            for why, rows in count.left.items()
            if rows
        ]
        own = (*notes, *file.lost, *left)
        notes, file.lost = [], []
        block = replace(empty, channels=channels, gaps=tuple(gaps.values()), notes=own)
        yield replace(block, counts=tuple(counts))
        if ended:
            return


def _count(signal: FieldChannel, read: int) -> Count:
    rows = signal.rows
    return Count(signal.name, rows, read, {"lack a value or a stamp": rows - read})


def _time_after(file: File, signal: FieldChannel, row: int) -> float:
    """Time of a row of the main channel, or infinity past its end."""
    if row >= signal.rows:
        return float("inf")
    t = file.times(signal, row, row + 1)
    return float(t[0]) if np.isfinite(t[0]) else float("-inf")


def _stop(
    file: File, signal: FieldChannel, main: FieldChannel, row: int, size: int, until: float
) -> int:
    """Where this channel's block ends: at the main channel's row, or at its time."""
    rows = signal.rows
    same = signal.time == main.time and (signal.time is not None or signal.rate == main.rate)
    if same and rows == main.rows:
        return min(rows, row + size)
    if until == float("inf"):
        return rows
    while row < rows:
        t = file.times(signal, row, min(rows, row + size))
        inside = int(np.searchsorted(t, until))
        row += inside
        if inside < t.size:
            break
    return row


def _channel(
    file: File, one: FieldChannel, start: int, stop: int, last: dict[str, float]
) -> tuple[Channel | None, list[Gap]]:
    """The channel and its gaps."""
    if stop <= start:
        return None, []
    t, raw = file.times(one, start, stop), file.values(one, start, stop)
    rows: Array | range = range(start, stop)
    counted = one.time is None
    if not ((counted or _finite(t)) and _finite(raw)):
        usable = np.isfinite(t) & np.isfinite(raw).all(axis=1)
        if not usable.any():
            return None, []
        t, raw, rows = t[usable], raw[usable], np.arange(start, stop)[usable]
    gaps = []
    if one.quantity != "temperature":
        # Times that are counted have no gap where no row was left out.
        new = slice(0, 1) if counted and isinstance(rows, range) else slice(None)
        gaps = find_gaps(t[new], rows[new], one.threshold, last.get(one.name))
    last[one.name] = float(t[-1])
    return Channel(
        t=t,
        values=one.conversion.apply(raw),
        quantity=one.quantity,
        triad=one.triad,
        rate=one.rate or 0.0,
        names=(one.address,) if one.address else (),
        numbered=one.numbered,
        **one.conversion.units,
    ), gaps


def _finite(values: NDArray[np.generic]) -> bool:
    """Whether all are: a sum that is finite has no other terms, and is faster than a look."""
    if values.dtype.kind in "iu":
        return True
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


def put_channel(
    held: Any, name: str, seconds: Array, columns: Sequence[NDArray[Any]], units: str
) -> None:
    """One channel, "imu0/acceleration", with its own clock in s and its stated unit."""
    values = columns[0] if len(columns) == 1 else np.column_stack(columns)
    group = held.create_group(name)
    group.create_dataset("time", data=seconds).attrs["units"] = "s"
    group.create_dataset("values", data=values.astype(np.float64)).attrs["units"] = units


def table_columns(path: Path, most: int = 0) -> dict[str, Array | list[str]]:
    """Every column by name: a dataset (n,), a field of a compound one, x, y, z of one (n, 3).

    most : rows that are read, all where it is 0
    Raises UnreadableInput for a damaged file and for columns of different length.
    """
    with open_file(path, strict=True) as file:
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
