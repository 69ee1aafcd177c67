"""Text tables of any dialect: actigraph exports, EuRoC, Xsens, loggers of one's own.

The shape, the columns, the clock and the units are decided once, from looks all over the file
(`csv_plan`); then whole blocks of lines go through numpy's C parser.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.csv.dialect import cells_of, is_number
from imucalib.readers.csv.idle_sleep import without_repeats
from imucalib.readers.csv.parse import parse
from imucalib.readers.csv.plan import Plan, Signal, make_plan
from imucalib.readers.csv.position import Position, count_bad, spread_stamps, times_of
from imucalib.readers.csv.source import Lines, line_blocks, text_head
from imucalib.readers.joining import join
from imucalib.readers.source import sha256_of
from imucalib.readers.timebase import find_gaps
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Gap, Recording


class CsvReader:
    """Reader of text tables; see `imucalib.readers.Reader`."""

    name = "csv"
    suffixes = (".csv", ".txt", ".tsv", ".log", ".dat", ".csv.gz", ".txt.gz", ".tsv.gz", ".log.gz")

    def recognises(self, path: Path, head: bytes) -> bool:
        """Text in which some line holds three numbers."""
        lines = text_head(head).decode("utf-8", errors="replace").split("\n")[:-1]
        for line in lines[-20:] + lines[:120]:
            for delimiter in (",", ";", "\t", " "):
                numbers = [
                    c for c in cells_of(line, delimiter) if is_number(c) or is_number(c, ",")
                ]
                if len(numbers) >= 3:
                    return True
        return False

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Yield the table in blocks of about `block_samples` rows."""
        try:
            yield from _blocks(path, mapping, block_samples, strict)
        except OSError as error:
            raise UnreadableInput(
                f"the file cannot be read: {error.strerror or error}", where=str(path)
            ) from error

    def read(self, path: Path, mapping: FieldMapping, *, strict: bool) -> Recording:
        """Read the whole table."""
        return join(self.blocks(path, mapping, block_samples=1 << 17, strict=strict), str(path))


READER = CsvReader()


def _blocks(
    path: Path, mapping: FieldMapping, block_samples: int, strict: bool
) -> Iterator[Recording]:
    plan = make_plan(path, mapping)
    found = _table(path, plan, block_samples, strict)
    yield from without_repeats(found) if plan.idle else found


def _table(path: Path, plan: Plan, block_samples: int, strict: bool) -> Iterator[Recording]:
    empty = Recording(
        {}, str(path), "csv", sha256_of(path), plan.clock.start_ns,
        notes=plan.notes, mapping=plan.resolved.to_dict(), corrections=plan.corrections,
    )  # fmt: skip
    position = Position()
    before: Recording | None = None
    lost: list[str] = []
    crc = 0
    size = block_samples * _bytes_per_row(plan)
    for lines in (_ended(x, plan) for x in line_blocks(path, size, strict=strict)):
        lost += [lines.note] if lines.note else []
        crc = zlib.crc32(_below_first(lines), crc) if plan.stated else 0
        block = _block(
            plan.chosen(_data_lines(lines, plan)), plan, position, str(path), flush=False
        )
        if block is None:
            continue
        if before is not None:
            yield before
            empty = replace(empty, notes=())
        before = replace(empty, channels=block[0], gaps=block[1])
    rest = _block(None, plan, position, str(path), flush=True)
    if rest is not None:
        if before is not None:
            yield before
            empty = replace(empty, notes=())
        before = replace(empty, channels=rest[0], gaps=rest[1])
    if before is None:
        raise UnreadableInput("no row of the table could be read", where=str(path))
    if position.bad_rows:
        lost.append(f"{position.bad_rows} rows left out; {position.first_bad}")
    lost += plan.stated.contradicted(position.row, crc) if plan.stated else []
    if strict and lost:
        raise UnreadableInput(lost[0], where=str(path), remedy="copy the file again")
    yield replace(before, notes=(*before.notes, *lost, *_left_out(plan, position)))


def _bytes_per_row(plan: Plan) -> int:
    return max(16, 10 * plan.layout.width)


def _ended(lines: Lines, plan: Plan) -> Lines:
    """The lines, the last one with the end that it lacks where nothing else is missing."""
    whole = lines.tail and plan.dialect.is_whole(lines.tail)
    return Lines(lines.tail + b"\n", lines.first_line) if whole else lines


def _below_first(lines: Lines) -> bytes:
    """The lines without the file's first."""
    return lines.data.partition(b"\n")[2] if lines.first_line == 1 else lines.data


def _left_out(plan: Plan, position: Position) -> list[str]:
    notes = []
    if position.idle_rows:
        notes.append(f"{position.idle_rows} rows of zeros (idle sleep) left out")
    missing = position.missing_rows - (0 if plan.clock.kind else position.bad_rows)
    if missing > 0:
        notes.append(f"{missing} rows without a value left out")
    return notes


def _data_lines(lines: Lines, plan: Plan) -> Lines:
    """The lines without those above the table."""
    above = plan.dialect.data_line - lines.first_line
    if above <= 0:
        return lines
    parts = lines.data.split(b"\n", above)
    return Lines(parts[-1] if len(parts) > above else b"", plan.dialect.data_line, lines.note)


_Block = tuple[dict[str, Channel], tuple[Gap, ...]]


def _block(
    lines: Lines | None, plan: Plan, position: Position, where: str, *, flush: bool
) -> _Block | None:
    """Channels and gaps of one block of lines, or of what is still held back."""
    if lines is not None and lines.data:
        rows = parse(lines, plan.layout, where)
        t, rows = times_of(rows, plan, position, lines.first_line, where)
        values = rows.values
        count_bad(rows, position, where)
    else:
        t, values = np.empty(0), np.empty((0, len(plan.layout.values)))
    if plan.clock.resolution:
        t, values = spread_stamps(t, values, plan, position, flush=flush)
    if t.size == 0:
        return None
    numbers = position.row + np.arange(t.size, dtype=np.float64)
    position.row += t.size
    keep = np.isfinite(t)
    if plan.idle:
        idle = (values == 0.0).all(axis=1)
        position.idle_rows += int(idle.sum())
        keep &= ~idle
    return _channels(t, values, numbers, keep, plan=plan, position=position)


def _channels(
    t: Array, values: Array, numbers: Array, keep: NDArray[np.bool_], *, plan: Plan,
    position: Position,
) -> _Block | None:  # fmt: skip
    channels: dict[str, Channel] = {}
    gaps: dict[tuple[float, float], Gap] = {}
    missing = np.zeros(t.shape, dtype=np.bool_)
    for signal in plan.signals:
        whole = signal.at == tuple(range(values.shape[1]))
        raw = values if whole else values[:, signal.at]
        finite = np.isfinite(raw)
        usable = keep if finite.all() else keep & finite.all(axis=1)
        at, known, rows = t, raw, numbers
        if not usable.all():
            at, known, rows = t[usable], raw[usable], numbers[usable]
        if signal.quantity != "temperature":
            missing |= ~usable & keep
            for gap in _gaps_of(signal, at, rows, position):
                gaps.setdefault((gap.start, gap.stop), gap)
        if at.size:
            channels[signal.name] = _channel(signal, at, known)
    position.missing_rows += int(missing.sum())
    return (channels, tuple(gaps.values())) if channels else None


def _gaps_of(signal: Signal, t: Array, numbers: Array, position: Position) -> list[Gap]:
    gaps = find_gaps(t, numbers, signal.threshold, position.last.get(signal.name))
    if t.size:
        position.last[signal.name] = float(t[-1])
    return gaps


def _channel(signal: Signal, t: Array, raw: Array) -> Channel:
    converted = signal.conversion.apply(raw)
    how = signal.conversion
    return Channel(t, converted, how.unit, signal.quantity, signal.triad, signal.rate)
