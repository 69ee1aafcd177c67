"""The summary at the end of an MCAP file: nothing depends on it, two things profit from it.

It defines the channels once more, for a file whose first definitions are lost, and it counts the
messages, so that arrays need not grow.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import NamedTuple

from imucalib.readers.messages import records as mr
from imucalib.readers.messages.records import MalformedRecordError, Schema, Topic


class Summary(NamedTuple):
    """Channels by number, and message counts by channel number."""

    topics: dict[int, Topic]
    counts: dict[int, int]


def read_summary(path: Path) -> Summary:
    """The summary; empty when it is absent, cut or damaged."""
    with open(path, "rb") as file:
        size = file.seek(0, 2)
        file.seek(max(size - 37, 0))
        tail = file.read()
        if len(tail) < 37 or tail[0] != mr.FOOTER or tail[-8:] != mr.MAGIC:
            return Summary({}, {})
        summary = int.from_bytes(tail[9:17], "little")
        if not len(mr.MAGIC) <= summary < size:
            return Summary({}, {})
        file.seek(summary)
        data = file.read(size - 37 - summary)
    expected = int.from_bytes(tail[25:29], "little")
    if expected and zlib.crc32(data + tail[:25]) != expected:
        return Summary({}, {})
    return _parsed(data)


def _parsed(data: bytes) -> Summary:
    schemas: dict[int, Schema] = {}
    topics: dict[int, Topic] = {}
    counts: dict[int, int] = {}
    at = 0
    try:
        while at + 9 <= len(data):
            opcode, length = mr.RECORD_HEADER.unpack_from(data, at)
            content = data[at + 9 : at + 9 + length]
            if opcode == mr.SCHEMA:
                schema = mr.parse_schema(content)
                schemas[schema.id] = schema
            elif opcode == mr.CHANNEL:
                topic = mr.parse_channel(content, schemas)
                topics[topic.id] = topic
            elif opcode == mr.STATISTICS:
                pairs = content[46 : 46 + len(content[46:]) // 10 * 10]
                counts = dict(struct.iter_unpack("<HQ", pairs))
            at += 9 + length
    except MalformedRecordError:
        return Summary({}, {})
    return Summary(topics, counts)
