"""Blocks of one recording back into one recording; files of one device into one."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from imucalib.errors import UnreadableInput, UsageError
from imucalib.recording.recording import Channel, Gap, Recording


def join(blocks: Iterable[Recording], where: str) -> Recording:
    """Concatenate the blocks of one file, channel by channel; notes and gaps in their order.

    Raises UnreadableInput when there is no block at all.
    """
    first: Recording | None = None
    parts: dict[str, list[Channel]] = {}
    gaps: list[Gap] = []
    notes: list[str] = []
    for block in blocks:
        first = first or block
        for name, channel in block.channels.items():
            parts.setdefault(name, []).append(channel)
        gaps.extend(block.gaps)
        notes.extend(note for note in block.notes if note not in notes)
    if first is None:
        raise UnreadableInput(
            "the file holds no samples", where=where, remedy="check how it was recorded"
        )
    channels = {name: _joined(pieces) for name, pieces in parts.items()}
    return replace(first, channels=channels, gaps=tuple(gaps), notes=tuple(notes))


def together(recordings: Sequence[Recording]) -> Recording:
    """One recording of files that one device wrote, each of other sensors, with clocks of one zero.

    Raises UsageError for a channel that two of them have, and for clocks that have no date in one
    of them or that do not overlap.
    """
    first, *others = recordings
    names = [name for one in recordings for name in one.channels]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        files = [Path(one.path).name for one in recordings if twice in one.channels]
        raise UsageError(
            f"{twice} is in {' and in '.join(files)}", where=first.path,
            remedy="join files of different sensors; name what each holds, or convert it alone",
        )  # fmt: skip
    if len({one.start_ns is None for one in recordings}) > 1:
        bare = next(one.path for one in recordings if one.start_ns is None)
        raise UsageError(
            "its clock has no date, those of the others have one", where=bare,
            remedy="join files whose stamps count from one zero",
        )  # fmt: skip
    start = min((one.start_ns for one in recordings if one.start_ns is not None), default=None)
    moved = [_moved(one, (one.start_ns or 0) - (start or 0)) for one in recordings]
    spans = [_span(one) for one in moved]
    for one, (low, high) in zip(moved[1:], spans[1:], strict=True):
        if low > spans[0][1] or high < spans[0][0]:
            raise UsageError(
                f"it spans {low:.6g} to {high:.6g} s, {first.path} {spans[0][0]:.6g} to "
                f"{spans[0][1]:.6g} s: their clocks do not overlap", where=one.path,
                remedy="join files of the same moments whose stamps count from one zero",
            )  # fmt: skip
    notes = [f"{Path(one.path).name}: {note}" for one in recordings for note in one.notes]
    marks = tuple(dict.fromkeys(mark for one in recordings for mark in one.corrections))
    return replace(
        first,
        channels={name: channel for one in moved for name, channel in one.channels.items()},
        path=", ".join(one.path for one in recordings),
        sha256=hashlib.sha256("".join(one.sha256 for one in recordings).encode()).hexdigest(),
        start_ns=start,
        gaps=tuple(sorted({g for one in moved for g in one.gaps}, key=lambda g: g.start)),
        notes=tuple(notes) if others else first.notes,
        mapping=first.mapping if not others else {},
        corrections=marks,
    )


def _moved(recording: Recording, ns: int) -> Recording:
    if not ns:
        return recording
    shift = ns * 1e-9
    channels = {name: replace(c, t=c.t + shift) for name, c in recording.channels.items()}
    gaps = tuple(replace(g, start=g.start + shift, stop=g.stop + shift) for g in recording.gaps)
    return replace(recording, channels=channels, gaps=gaps)


def _span(recording: Recording) -> tuple[float, float]:
    times = [c.t for c in recording.channels.values() if c.t.size]
    return min(float(t.min()) for t in times), max(float(t.max()) for t in times)


def _joined(pieces: list[Channel]) -> Channel:
    if len(pieces) == 1:
        return pieces[0]
    t = np.concatenate([p.t for p in pieces])
    return replace(pieces[0], t=t, values=np.concatenate([p.values for p in pieces]))
