"""Blocks of one recording back into one recording."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from imucalib.errors import UnreadableInput
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


def _joined(pieces: list[Channel]) -> Channel:
    if len(pieces) == 1:
        return pieces[0]
    t = np.concatenate([p.t for p in pieces])
    return replace(pieces[0], t=t, values=np.concatenate([p.values for p in pieces]))
