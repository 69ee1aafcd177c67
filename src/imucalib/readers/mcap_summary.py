"""The summary at the end of an MCAP file: a second source of channel definitions."""

from __future__ import annotations

import zlib
from pathlib import Path

from imucalib.readers import mcap_records as mr
from imucalib.readers.mcap_records import MalformedRecordError, Schema, Topic


def known_topics(path: Path) -> dict[int, Topic]:
    """Channels from the summary at the file's end, empty when it is absent or damaged.

    A fallback for a file whose only channel definitions were in a chunk that is lost.
    """
    with open(path, "rb") as file:
        size = file.seek(0, 2)
        file.seek(max(size - 37, 0))
        tail = file.read()
        if len(tail) < 37 or tail[0] != mr.FOOTER or tail[-8:] != mr.MAGIC:
            return {}
        summary = int.from_bytes(tail[9:17], "little")
        if not len(mr.MAGIC) <= summary < size:
            return {}
        file.seek(summary)
        data = file.read(size - 37 - summary)
    expected = int.from_bytes(tail[25:29], "little")
    if expected and zlib.crc32(data + tail[:25]) != expected:
        return {}
    return _channels(data)


def _channels(data: bytes) -> dict[int, Topic]:
    schemas: dict[int, Schema] = {}
    topics: dict[int, Topic] = {}
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
            at += 9 + length
    except MalformedRecordError:
        return {}
    return topics
