"""Text tables of any dialect: actigraph exports, EuRoC, Xsens, loggers of one's own.

The shape, the columns, the clock and the units are decided once, from looks all over the file
(`csv.plan`); then whole blocks of lines go through numpy's C parser.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.csv.plan import Plan, bad_stamp, make_plan
from imucalib.readers.csv.rows import Rows, parse
from imucalib.readers.csv.stamps import spread
from imucalib.readers.csv.text import Lines, cells_of, is_number, line_blocks, text_head
from imucalib.readers.joining import Joined
from imucalib.readers.source import sha256_of
from imucalib.readers.timebase import find_gaps
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Gap, Recording

_SHORTEST = 1.0  # s: no sensor whose noise exceeds its resolution repeats itself for so long


def without_repeats(blocks: Iterator[Recording]) -> Iterator[Recording]:
    """The same blocks without accelerations that repeat the one before for over a second.

    The device sleeps by whole seconds, so what is left of the stretch's first second stays. The
    stretch at a block's end waits for the next block.
    """
    awake: dict[str, _Awake] = {}
    before: Recording | None = None
    for block in blocks:
        if before is not None:
            yield _filtered(before, awake, last=False)
        before = block
    if before is not None:
        yield _filtered(before, awake, last=True)


def _filtered(block: Recording, awake: dict[str, _Awake], *, last: bool) -> Recording:
    channels, gaps, notes = dict(block.channels), list(block.gaps), list(block.notes)
    for name, channel in block.channels.items():
        if channel.quantity != "acceleration":
            continue
        state = awake.setdefault(name, _Awake(channel.rate))
        channels[name], found = state.take(channel, last=last)
        gaps += found
        if last and state.repeated:
            notes.append(f"{state.repeated} rows that repeat the last (idle sleep) left out")
    return replace(block, channels=channels, gaps=tuple(gaps), notes=tuple(notes))


class _Awake:
    """The stretch of equal rows at the end of what was seen of one channel.

    held : its rows, or its first second once it is too long, with `dropped` rows gone already
    repeated : rows left out so far
    """

    def __init__(self, rate: float) -> None:
        self.most = max(2, round(_SHORTEST * rate))
        self.repeated = 0
        self._held: tuple[Array, Array] | None = None
        self._dropped = 0

    def take(self, channel: Channel, *, last: bool) -> tuple[Channel, list[Gap]]:
        """The rows that are measurements, and the gaps that the others leave."""
        t, values = channel.t, channel.values
        if self._held is not None:
            t = np.concatenate([self._held[0], t])
            values = np.concatenate([self._held[1], values])
        changed = np.any(values[1:] != values[:-1], axis=1)
        starts = np.concatenate([[0], np.flatnonzero(changed) + 1])
        stops = np.append(starts[1:], t.size)
        length = stops - starts
        length[0] += self._dropped
        long = length > self.most
        end = t.size
        if not last:
            end = int(starts[-1])
            stop = _second(t, end) if long[-1] else t.size
            self._dropped = int(length[-1]) - (stop - end) if long[-1] else 0
            self._held = (t[end:stop].copy(), values[end:stop].copy())
            starts, stops, length, long = starts[:-1], stops[:-1], length[:-1], long[:-1]
        keep = np.ones(end, dtype=np.bool_)
        gaps = []
        for a, b, rows in zip(starts[long], stops[long], length[long], strict=True):
            first = _second(t, int(a))
            keep[first:b] = False
            self.repeated += int(rows) - (first - int(a))
            if b < t.size:
                reason = "idle sleep: the last reading repeated"
                gaps.append(Gap(float(t[first - 1]), float(t[b]), reason))
        return replace(channel, t=t[:end][keep], values=values[:end][keep]), gaps


def _second(t: Array, row: int) -> int:
    """The first row after the second (counted from the start) in which a row lies."""
    return int(np.searchsorted(t, np.floor(t[row] + 1e-6) + 1.0 - 1e-6))


@dataclass
class Position:
    """What one block hands to the next; moved : s that stamps without a date have been moved on;
    bad_rows : left out, first_bad : why and where."""

    row: int = 0
    last: dict[str, float] = field(default_factory=dict)
    moved: float = 0.0
    last_of_period: float = -np.inf
    held: tuple[Array, Array] | None = None
    first_group: bool = True
    idle_rows: int = 0
    missing_rows: int = 0
    bad_rows: int = 0
    first_bad: str = ""


def count_bad(rows: Rows, position: Position, where: str) -> None:
    """Count the rows that were left out, and keep the reason of the first."""
    if rows.bad and not position.bad_rows:
        first = rows.bad[0]
        position.first_bad = f"{first.where.removeprefix(where).lstrip(': ')}: {first.what}"
    position.bad_rows += len(rows.bad)


def times_of(
    rows: Rows, plan: Plan, position: Position, line: int, where: str
) -> tuple[Array, Rows]:
    """Seconds of the rows, and the rows whose stamps are understood."""
    clock = plan.clock
    if not clock.kind:
        count = rows.values.shape[0]
        return (position.row + np.arange(count, dtype=np.float64)) / clock.rate, rows
    t, wrong = clock.seconds(rows.stamps)
    if wrong.any():
        t, rows = t[~wrong], _without(rows, wrong, line, where)
    if clock.text is None or clock.text.dated or t.size == 0:
        return t, rows
    period, known = clock.text.period, np.isfinite(t)
    back = np.zeros(t.shape, dtype=np.bool_)
    back[known] = np.diff(t[known], prepend=position.last_of_period) < -period / 2
    if known.any():
        position.last_of_period = float(t[known][-1])
    moved = position.moved + period * np.cumsum(back)
    position.moved = float(moved[-1])
    return np.asarray(t + moved), rows


def _without(rows: Rows, wrong: NDArray[np.bool_], line: int, where: str) -> Rows:
    """The rows without those whose stamps are not understood; raises when those are most."""
    at = np.flatnonzero(wrong)
    bad = [bad_stamp(rows, int(k), line, where) for k in at]
    if 2 * at.size > wrong.size:
        raise bad[0]
    lines = rows.lines[~wrong] if rows.lines is not None else None
    return Rows(rows.stamps[~wrong], rows.values[~wrong], (*rows.bad, *bad), lines)


def spread_stamps(
    t: Array, values: Array, plan: Plan, position: Position, *, flush: bool
) -> tuple[Array, Array]:
    """Coarse stamps spread; the last group waits for the next block, where it may go on."""
    if position.held is not None:
        t = np.concatenate([position.held[0], t])
        values = np.concatenate([position.held[1], values])
        position.held = None
    if t.size == 0:
        return t, values
    if not flush:
        changes = np.flatnonzero(np.diff(t) != 0)
        cut = int(changes[-1]) + 1 if changes.size else 0
        position.held = (t[cut:], values[cut:])
        t, values = t[:cut], values[:cut]
    if t.size:
        clock = plan.clock
        moved = spread(t, clock.resolution, clock.typical, position.first_group)
        position.first_group = False
        t = t + moved
    return t, values


class CsvReader(Joined):
    """Reader of text tables; see `imucalib.readers.Reader`."""

    name = "csv"
    suffixes = (".csv", ".txt", ".tsv", ".log", ".dat", ".csv.gz", ".txt.gz", ".tsv.gz", ".log.gz")
    at_once = 1 << 17

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
            plan = make_plan(path, mapping)
            found = _table(path, plan, block_samples, strict)
            yield from without_repeats(found) if plan.idle else found
        except OSError as error:
            raise UnreadableInput(
                f"the file cannot be read: {error.strerror or error}", where=str(path)
            ) from error


READER = CsvReader()


def _table(path: Path, plan: Plan, block_samples: int, strict: bool) -> Iterator[Recording]:
    empty = Recording(
        {},
        str(path),
        "csv",
        sha256_of(path),
        plan.clock.start_ns,
        notes=plan.notes,
        mapping=plan.resolved.to_dict(),
        corrections=plan.corrections,
    )
    position = Position()
    before: Recording | None = None
    lost: list[str] = []
    crc = 0
    size = block_samples * max(16, 10 * plan.layout.width)
    for some in line_blocks(path, size, strict=strict):
        # A last line that lacks nothing but its end is a row.
        ended = some.tail and plan.dialect.is_whole(some.tail)
        lines = Lines(some.tail + b"\n", some.first_line) if ended else some
        lost += [lines.note] if lines.note else []
        below = lines.data.partition(b"\n")[2] if lines.first_line == 1 else lines.data
        crc = zlib.crc32(below, crc) if plan.stated else 0
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
    t: Array,
    values: Array,
    numbers: Array,
    keep: NDArray[np.bool_],
    *,
    plan: Plan,
    position: Position,
) -> _Block | None:
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
            last = position.last.get(signal.name)
            for gap in find_gaps(at, rows, signal.threshold, last):
                gaps.setdefault((gap.start, gap.stop), gap)
        if at.size:
            position.last[signal.name] = float(at[-1])
            how, of = signal.conversion, signal
            values_si = how.apply(known)
            channels[signal.name] = Channel(at, values_si, how.unit, of.quantity, of.triad, of.rate)
    position.missing_rows += int(missing.sum())
    return (channels, tuple(gaps.values())) if channels else None
