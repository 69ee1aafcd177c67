"""Text tables of any dialect: actigraph exports, EuRoC, Xsens, loggers of one's own.

The shape, the columns, the clock and the units are decided once, from looks all over the file
(`csv.plan`); then whole blocks of lines go through numpy's C parser.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, zip_longest
from pathlib import Path

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.errors import UnreadableInput
from imucalib.file_hash import sha256_of
from imucalib.readers.csv.plan import TablePlan, bad_stamp, make_plans
from imucalib.readers.csv.rows import ParsedRows, parse
from imucalib.readers.csv.stamps import spread_rows
from imucalib.readers.csv.text import Lines, cells_of, is_number, line_blocks, text_head
from imucalib.readers.fields.joining import Joined
from imucalib.readers.fields.timebase import find_gaps
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Count, Gap, Recording

_SHORTEST = 1.0  # s: no sensor whose noise exceeds its resolution repeats itself for so long


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
                cells = cells_of(line, delimiter)
                if sum(is_number(c) or is_number(c, ",") for c in cells) >= 3:
                    return True
        return False

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Yield the table in blocks of about `block_samples` rows."""
        plans = make_plans(path, mapping)
        tables = [_Table(path, plan).blocks(block_samples, strict) for plan in plans]
        found = tables[0] if len(tables) == 1 else _side_by_side(tables)
        yield from drop_repeats(found) if plans[0].table.facts.device.sleeps else found


READER = CsvReader()


def _side_by_side(tables: Sequence[Iterator[Recording]]) -> Iterator[Recording]:
    """The blocks of sensors that have clocks of their own, of the same rows at a time."""
    told = set[str]()
    for blocks in zip_longest(*tables):
        some = [block for block in blocks if block is not None]
        notes = dict.fromkeys(note for block in some for note in block.notes)
        yield replace(
            some[0],
            channels={name: c for block in some for name, c in block.channels.items()},
            gaps=tuple(sorted({g for block in some for g in block.gaps}, key=lambda g: g.start)),
            notes=tuple(note for note in notes if note not in told),
            counts=tuple(count for block in some for count in block.counts),
        )
        told.update(notes)


class _Table:
    """One table as it is read, block after block.

    row : rows so far; last, sums : of each channel's times the last, their sum and number
    moved : s that stamps without a date have been moved on; last_of_period : their last time
    held : coarse stamps and values of a group that may go on
    whole : rows that have a value of every sensor; idle, missing, unstamped, bad : other rows
    """

    def __init__(self, path: Path, plan: TablePlan) -> None:
        self.path, self.plan = path, plan
        self.row, self.moved, self.last_of_period = 0, 0.0, -np.inf
        self.last: dict[str, float] = {}
        self.sums: dict[str, tuple[float, int]] = {}
        self.held: tuple[Array, Array] | None = None
        self.first_group = True
        self.whole = self.idle = self.missing = self.unstamped = self.bad = 0
        self.first_bad = ""

    def blocks(self, block_samples: int, strict: bool) -> Iterator[Recording]:
        """The table in blocks; the last one's notes say what was lost."""
        plan, lost, crc = self.plan, list[str](), 0
        empty = Recording(
            {},
            str(self.path),
            "csv",
            sha256_of(self.path),
            plan.clock.start_ns,
            notes=plan.notes,
            mapping=plan.resolved.to_dict(),
            corrections=plan.table.facts.corrections,
            device=plan.table.facts.device.name,
            serial=plan.table.facts.serial,
        )
        last: Recording | None = None
        size = block_samples * max(16, 10 * plan.layout.dialect.width)
        for some in chain(line_blocks(self.path, size, strict=strict), [None]):
            lines = some and self._ended(some)
            if lines is not None:
                lost += [lines.note] if lines.note else []
                below = lines.data.partition(b"\n")[2] if lines.first_line == 1 else lines.data
                crc = 0 if plan.table.facts.crc is None else zlib.crc32(below, crc)
            block = self._block(lines and plan.rows_in(lines))
            if block is not None:
                if last is not None:
                    yield last
                    empty = replace(empty, notes=())
                last = replace(empty, channels=block[0], gaps=block[1])
        if last is None:
            raise UnreadableInput("no row of the table could be read", where=str(self.path))
        means = {
            name: (total - self.last[name]) / max(count - 1, 1)
            for name, (total, count) in self.sums.items()
        }
        last, footer = _drop_footer(last, means)
        lost += [f"{self.bad} rows left out; {self.first_bad}"] if self.bad else []
        lost += plan.table.facts.contradicted(self.row, crc)
        if strict and lost:
            raise UnreadableInput(lost[0], where=str(self.path), remedy="copy the file again")
        count = self._count(footer)
        lost += [f"{rows} rows {why}, left out" for why, rows in self._left(footer)[1:] if rows > 0]
        yield replace(last, notes=(*last.notes, *lost), counts=(count,))

    def _left(self, footer: int) -> list[tuple[str, int]]:
        """Why rows were left out, those that cannot be read first."""
        missing = self.missing - (0 if self.plan.clock.unit else self.bad)
        return [
            ("that cannot be read", self.bad),
            ("of zeros (idle sleep)", self.idle),
            ("without a value", max(missing, 0)),
            ("without a time stamp", self.unstamped),
            ("below the table, which step back in time as means do", footer),
        ]

    def _count(self, footer: int) -> Count:
        held = self.row + (self.bad if self.plan.clock.unit else 0)
        names = ", ".join(s.vector.name for s in self.plan.signals)
        return Count(f"rows of {names}", held, self.whole - footer, dict(self._left(footer)))

    def _ended(self, lines: Lines) -> Lines:
        """The lines; a last one that lacks nothing but its end is a row."""
        whole = bool(lines.tail) and self.plan.layout.dialect.is_whole(lines.tail)
        return Lines(lines.tail + b"\n", lines.first_line) if whole else lines

    def _block(self, lines: Lines | None) -> tuple[dict[str, Channel], tuple[Gap, ...]] | None:
        """Channels and gaps of one block of lines; None for what is still held back."""
        t, values = np.empty(0), np.empty((0, len(self.plan.layout.values)))
        if lines is not None and lines.data:
            rows = parse(lines, self.plan.layout, str(self.path))
            t, rows = self._times(rows, lines.first_line)
            values = rows.values
            if rows.bad and not self.bad:
                first = rows.bad[0]
                place = first.where.removeprefix(str(self.path)).lstrip(": ")
                self.first_bad = f"{place}: {first.what}"
            self.bad += len(rows.bad)
        if self.plan.clock.resolution:
            t, values = self._spread(t, values, flush=lines is None)
        if t.size == 0:
            return None
        numbers = self.row + np.arange(t.size)
        self.row += t.size
        keep = np.isfinite(t)
        self.unstamped += int(t.size - np.count_nonzero(keep))
        if self.plan.table.facts.device.sleeps:
            idle = (values == 0.0).all(axis=1)
            self.idle += int(idle.sum())
            keep &= ~idle
        return self._channels(t, values, numbers, keep)

    def _times(self, rows: ParsedRows, line: int) -> tuple[Array, ParsedRows]:
        """Seconds of the rows, and the rows whose stamps are understood."""
        clock = self.plan.clock
        if not clock.unit:
            count = rows.values.shape[0]
            return (self.row + np.arange(count, dtype=np.float64)) / clock.rate, rows
        t, wrong = clock.seconds(rows.stamps)
        if wrong.any():
            bad = [bad_stamp(rows, k, line, str(self.path)) for k in np.flatnonzero(wrong).tolist()]
            if 2 * len(bad) > wrong.size:
                raise bad[0]
            t, rows = t[~wrong], replace(rows.at(~wrong), bad=(*rows.bad, *bad))
        if clock.text is None or clock.text.dated or t.size == 0:
            return t, rows
        period, known = clock.text.period, np.isfinite(t)
        back = np.zeros(t.shape, dtype=np.bool_)
        back[known] = np.diff(t[known], prepend=self.last_of_period) < -period / 2
        if known.any():
            self.last_of_period = float(t[known][-1])
        moved = self.moved + period * np.cumsum(back)
        self.moved = float(moved[-1])
        return np.asarray(t + moved), rows

    def _spread(self, t: Array, values: Array, *, flush: bool) -> tuple[Array, Array]:
        """Coarse stamps spread; the last group waits for the next block, where it may go on."""
        if self.held is not None:
            t = np.concatenate([self.held[0], t])
            values = np.concatenate([self.held[1], values])
            self.held = None
        if not flush and t.size:
            changes = np.flatnonzero(np.diff(t) != 0)
            cut = int(changes[-1]) + 1 if changes.size else 0
            self.held = (t[cut:], values[cut:])
            t, values = t[:cut], values[:cut]
        if t.size:
            clock = self.plan.clock
            t = t + spread_rows(t, clock.resolution, clock.typical, self.first_group)
            self.first_group = False
        return t, values

    def _channels(
        self, t: Array, values: Array, numbers: np.ndarray, keep: Flags
    ) -> tuple[dict[str, Channel], tuple[Gap, ...]] | None:
        channels: dict[str, Channel] = {}
        gaps: dict[tuple[float, float], Gap] = {}
        missing = np.zeros(t.shape, dtype=np.bool_)
        alone = len({s.vector.triad for s in self.plan.signals}) == 1
        for signal in self.plan.signals:
            vector, how = signal.vector, signal.conversion
            whole = signal.at == tuple(range(values.shape[1]))
            raw = values if whole else values[:, signal.at]
            finite = np.isfinite(raw)
            usable = keep if finite.all() else keep & finite.all(axis=1)
            at, known, rows = t, raw, numbers
            if not usable.all():
                at, known, rows = t[usable], raw[usable], numbers[usable]
            if vector.quantity != "temperature":
                missing |= ~usable & keep
                last = self.last.get(vector.name)
                for gap in find_gaps(at, rows, signal.threshold, last):
                    gaps.setdefault((gap.start, gap.stop), gap)
            if at.size:
                self.last[vector.name] = float(at[-1])
                total, count = self.sums.get(vector.name, (0.0, 0))
                self.sums[vector.name] = total + float(at.sum()), count + at.size
                channels[vector.name] = Channel(
                    at,
                    how.apply(known),
                    quantity=vector.quantity,
                    triad=vector.triad,
                    rate=signal.rate,
                    numbered=vector.triad == "imu0" and alone,
                    **how.units,
                )
        self.missing += int(missing.sum())
        self.whole += int(np.count_nonzero(keep & ~missing))
        return (channels, tuple(gaps.values())) if channels else None


def _drop_footer(block: Recording, means: Mapping[str, float]) -> tuple[Recording, int]:
    """The last block without a last row at the mean of the times before it, which is that of the
    means of the columns; and whether there was one.

    means : of each channel's times, the last left out
    """
    channels, cut = dict[str, Channel](), 0
    for name, c in block.channels.items():
        below = c.t.size > 1 and c.t[-1] < c.t[-2] and abs(c.t[-1] - means[name]) * c.rate < 1.0
        cut = max(cut, int(below))
        channels[name] = replace(c, t=c.t[:-1], values=c.values[:-1]) if below else c
    gaps = tuple(g for g in block.gaps if not cut or g.stop >= g.start)
    return replace(block, channels=channels, gaps=gaps), cut


def drop_repeats(blocks: Iterator[Recording]) -> Iterator[Recording]:
    """The same blocks without accelerations that repeat the one before for over a second.

    The device sleeps by whole seconds, so the rest of the stretch's first second stays. The
    stretch at a block's end waits for the next block.
    """
    awake: dict[str, _Awake] = {}
    before: Recording | None = None
    for block in chain(blocks, [None]):
        if before is not None:
            yield _filter(before, awake, last=block is None)
        before = block


def _filter(block: Recording, awake: dict[str, _Awake], *, last: bool) -> Recording:
    channels, gaps, notes = dict(block.channels), list(block.gaps), list(block.notes)
    for name, channel in block.channels.items():
        if channel.quantity == "acceleration":
            state = awake.setdefault(name, _Awake(channel))
            channels[name], found = state.take(channel, last=last)
            gaps += found
            if last and state.repeated:
                notes.append(f"{state.repeated} rows that repeat the last (idle sleep) left out")
    return replace(block, channels=channels, gaps=tuple(gaps), notes=tuple(notes))


class _Awake:
    """The stretch of equal rows at the end of what was seen of one channel.

    t, values : its rows, or its first second once it is too long, with `dropped` rows gone already
    repeated : rows left out so far
    """

    def __init__(self, channel: Channel) -> None:
        self.most = max(2, round(_SHORTEST * channel.rate))
        self.t, self.values = channel.t[:0], channel.values[:0]
        self.dropped = self.repeated = 0

    def take(self, channel: Channel, *, last: bool) -> tuple[Channel, list[Gap]]:
        """The rows that are measurements, and the gaps that the others leave."""
        t = np.concatenate([self.t, channel.t])
        values = np.concatenate([self.values, channel.values])
        changed = np.flatnonzero(np.any(values[1:] != values[:-1], axis=1)) + 1
        starts, stops = np.append(0, changed), np.append(changed, t.size)
        length = stops - starts
        length[0] += self.dropped
        end = t.size if last else int(starts[-1])
        keep, gaps = np.ones(t.size, dtype=np.bool_), []
        for k in np.flatnonzero(length > self.most).tolist():
            a, b = int(starts[k]), int(stops[k])
            first = _second(t, a)
            keep[first:b] = False
            if b <= end:
                self.repeated += int(length[k]) - (first - a)
            if b < t.size:
                reason = "idle sleep: the last reading repeated"
                gaps.append(Gap(float(t[first - 1]), float(t[b]), reason))
        self.t, self.values = t[end:][keep[end:]], values[end:][keep[end:]]
        self.dropped = int(length[-1]) - self.t.size
        return replace(channel, t=t[:end][keep[:end]], values=values[:end][keep[:end]]), gaps


def _second(t: Array, row: int) -> int:
    """The first row after the second (counted from the start) in which a row lies."""
    return int(np.searchsorted(t, np.floor(t[row] + 1e-6) + 1.0 - 1e-6))
