"""An MCAP file written a whole chunk at a time, with CRCs, message indexes and a summary.

The official writer takes one message a call (about 0.1 million a second); here a chunk arrives as
arrays. Source: MCAP format specification, version 0 (https://mcap.dev/spec).
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from imucalib.readers.messages import records as mr
from imucalib.readers.messages.records import MAGIC, RECORD_HEADER
from imucalib.recording.correction import Correction

_HEADER, _CHUNK_INDEX, _SUMMARY_OFFSET = 0x01, 0x08, 0x0E
_ATTACHMENT_INDEX, _METADATA_INDEX = 0x0A, 0x0D


class McapFile:
    """An MCAP file that is being written; `close` adds the summary."""

    def __init__(self, path: Path, profile: str, library: str) -> None:
        self._file: BinaryIO = open(path, "wb")  # noqa: SIM115 - closed by close or abandon
        self._crc = 0
        self._at = 0
        self._chunks: list[bytes] = []  # their index records: of days there are many
        self._span: tuple[int, int] | None = None  # ns, first and last
        self._counts: dict[int, int] = {}
        self._definitions: dict[tuple[int, int], bytes] = {}
        self._extras: dict[int, list[bytes]] = {_ATTACHMENT_INDEX: [], _METADATA_INDEX: []}
        self._put(MAGIC)
        self._record(_HEADER, _text(profile) + _text(library))

    def schema(self, number: int, name: str, encoding: str, data: bytes) -> None:
        """Define a schema."""
        content = struct.pack("<H", number) + _text(name) + _text(encoding) + _sized(data)
        self._define(mr.SCHEMA, number, content)

    def channel(
        self, number: int, schema: int, topic: str, encoding: str, metadata: dict[str, str]
    ) -> None:
        """Define a channel of a schema (0 for none)."""
        pairs = b"".join(_text(k) + _text(v) for k, v in metadata.items())
        head = struct.pack("<HH", number, schema)
        content = head + _text(topic) + _text(encoding) + _sized(pairs)
        self._define(mr.CHANNEL, number, content)

    def chunk(
        self,
        data: bytes,
        starts: NDArray[np.int64],
        channels: NDArray[np.int64],
        log_times: NDArray[np.uint64],
    ) -> None:
        """Write message records as one chunk. starts, channels, log_times (ns) : (n,) each."""
        from imucalib.readers.mcap import zstd

        if starts.size == 0:
            return
        packed = zstd.compress(data)
        first, last = int(log_times.min()), int(log_times.max())
        head = struct.pack("<QQQI", first, last, len(data), zlib.crc32(data))
        at = self._at
        self._record(mr.CHUNK, head + _text("zstd") + struct.pack("<Q", len(packed)) + packed)
        length, index = self._at - at, {}
        for number in np.unique(channels).tolist():
            rows = np.flatnonzero(channels == number)
            rows = rows[np.argsort(log_times[rows], kind="stable")]
            entries = np.empty((rows.size, 2), dtype="<u8")
            entries[:, 0], entries[:, 1] = log_times[rows], starts[rows]
            index[number] = self._at
            body = struct.pack("<HI", number, entries.nbytes) + entries.tobytes()
            self._record(mr.MESSAGE_INDEX, body)
            self._counts[number] = self._counts.get(number, 0) + rows.size
        head = struct.pack("<QQQQ", first, last, at, length)
        where = b"".join(struct.pack("<HQ", *pair) for pair in index.items())
        sizes = struct.pack("<QQ", len(packed), len(data))
        tail = struct.pack("<Q", self._at - at - length)
        self._chunks.append(head + _sized(where) + tail + _text("zstd") + sizes)
        low, high = self._span or (first, last)
        self._span = min(low, first), max(high, last)

    def attachment(self, content: bytes) -> None:
        """Write an attachment record with its content as another file has it."""
        at = self._at
        self._record(mr.ATTACHMENT, content)
        name, end = mr.text_at(content, 16)
        media, end = mr.text_at(content, end)
        head = struct.pack("<QQ", at, self._at - at) + content[:16] + content[end : end + 8]
        self._extras[_ATTACHMENT_INDEX].append(head + _text(name) + _text(media))

    def metadata(self, content: bytes) -> None:
        """Write a metadata record with its content as another file has it."""
        at = self._at
        self._record(mr.METADATA, content)
        head = struct.pack("<QQ", at, self._at - at)
        self._extras[_METADATA_INDEX].append(head + _text(mr.text_at(content, 0)[0]))

    def marks(self, corrections: tuple[Correction, ...]) -> None:
        """Write which calibrations were applied, as a metadata record; nothing when none was."""
        if corrections:
            texts = [_text(str(k)) + _text(c.to_text()) for k, c in enumerate(corrections)]
            self.metadata(_text(mr.CORRECTIONS) + _sized(b"".join(texts)))

    def close(self) -> None:
        """Write the summary and the footer, and make sure that they are on the disk."""
        import os

        self._record(mr.DATA_END, struct.pack("<I", self._crc))
        start = self._at
        self._crc = 0
        groups = []
        for kind in (mr.SCHEMA, mr.CHANNEL):
            contents = [c for (k, _), c in self._definitions.items() if k == kind]
            groups.append((kind, contents))
        groups.append((mr.STATISTICS, [self._statistics()]))
        groups.append((_CHUNK_INDEX, self._chunks))
        groups += self._extras.items()
        offsets = []
        for kind, contents in groups:
            begin = self._at
            for content in contents:
                self._record(kind, content)
            if contents:
                offsets.append(struct.pack("<BQQ", kind, begin, self._at - begin))
        offset_start = self._at
        for content in offsets:
            self._record(_SUMMARY_OFFSET, content)
        head = RECORD_HEADER.pack(mr.FOOTER, 20) + struct.pack("<QQ", start, offset_start)
        self._put(head)
        self._put(struct.pack("<I", self._crc) + MAGIC)
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()

    def abandon(self) -> None:
        """Close the file without finishing it."""
        self._file.close()

    def _statistics(self) -> bytes:
        kinds = [kind for kind, _ in self._definitions]
        first, last = self._span or (0, 0)
        counts = b"".join(struct.pack("<HQ", *pair) for pair in self._counts.items())
        numbers = (sum(self._counts.values()), kinds.count(mr.SCHEMA), kinds.count(mr.CHANNEL))
        extras = [len(self._extras[kind]) for kind in (_ATTACHMENT_INDEX, _METADATA_INDEX)]
        head = struct.pack("<QHIIIIQQ", *numbers, *extras, len(self._chunks), first, last)
        return head + _sized(counts)

    def _define(self, kind: int, number: int, content: bytes) -> None:
        if self._definitions.get((kind, number)) != content:
            self._definitions[kind, number] = content
            self._record(kind, content)

    def _record(self, opcode: int, content: bytes) -> None:
        self._put(RECORD_HEADER.pack(opcode, len(content)))
        self._put(content)

    def _put(self, data: bytes) -> None:
        self._file.write(data)
        self._crc = zlib.crc32(data, self._crc)
        self._at += len(data)


def _text(text: str) -> bytes:
    return _sized(text.encode())


def _sized(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data
