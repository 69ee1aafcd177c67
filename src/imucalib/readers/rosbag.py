"""Recordings in ROS bags: ROS 1 .bag, ROS 2 .db3 and bag folders, through the package rosbags.

rosbags unpacks the containers; messages are decoded by the layouts that MCAP files use.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Schema

from imucalib.errors import UnreadableInput, UsageError
from imucalib.file_hash import sha256_of
from imucalib.readers.messages.recording import LogReader
from imucalib.readers.messages.records import (
    MESSAGE_HEAD,
    Damage,
    MessageBlock,
    MessageLog,
    Topic,
)
from imucalib.recording.mapping import FieldMapping

SQLITE = b"SQLite format 3\0"
_ROS1 = b"#ROSBAG V"
_BATCH = 4096  # messages of a block
_BATCH_BYTES = 1 << 22  # a block ends early where messages are large (images)
_RECORD = struct.Struct("<BQHIQQ")
_FORMATS = {"MSG": "ros2msg", "IDL": "ros2idl", "NONE": ""}


class BagLog(MessageLog):
    """A bag file or folder as a log of messages, in order of time.

    A bag is read through its index, so a damaged index makes it unreadable, and damage met on the
    way ends the pass: what came before is kept, what was lost is in `damages`.
    """

    format = "rosbag"

    def blocks(self) -> Iterator[MessageBlock]:
        """The messages, some thousand at a time."""
        self._begin()
        with self._open() as (bag, connections):
            self.topics = {n: _topic(n, c) for n, c in enumerate(connections)}
            total, done = sum(c.msgcount for c in connections), 0
            keys = {(c.topic, c.id): n for n, c in enumerate(connections)}
            messages = bag.messages() if connections else iter(())
            while batch := self._batch(messages, keys, done, total):
                done += len(batch)
                yield _block(batch)

    def indexed_topics(self) -> dict[int, Topic]:
        """Topics of the bag's index."""
        with self._open() as (_, connections):
            return {n: _topic(n, c) for n, c in enumerate(connections)}

    def sha256(self) -> str:
        """Hash of the file; of a folder, the hash over its files' names and hashes, in order."""
        if not self.path.is_dir():
            return super().sha256()
        whole = hashlib.sha256()
        for file in sorted(p for p in self.path.iterdir() if p.is_file()):
            whole.update(f"{sha256_of(file)}  {file.name}\n".encode())
        return whole.hexdigest()

    def _batch(
        self, messages: Iterator[Any], keys: dict[tuple[str, int], int], done: int, total: int
    ) -> list[tuple[int, int, int, bytes]]:
        batch: list[tuple[int, int, int, bytes]] = []
        size = 0
        try:
            for connection, time, data in islice(messages, _BATCH):
                row = done + len(batch)
                batch.append((keys[connection.topic, connection.id], row, time, bytes(data)))
                size += len(data)
                if size > _BATCH_BYTES:
                    break
        except Exception as error:  # rosbags raises almost anything on damaged bytes
            lost = max(total - done - len(batch), 0)
            self.report(Damage(-1, 0, f"{type(error).__name__}: {error}"[:160], messages=lost))
        if not batch and done < total and not self.damages:
            reason = "the bag ends before its index does"
            self.report(Damage(-1, 0, reason, messages=total - done))
        return batch

    @contextmanager
    def _open(self) -> Iterator[tuple[Any, list[Any]]]:
        """The open bag, and its connections."""
        bag = _reader(self.path)
        files = self.path.glob("*.db3") if self.path.is_dir() else [self.path]
        for file in files:
            _refuse_cut_database(file)
        try:
            bag.open()
        except Exception as error:  # rosbags raises almost anything on damaged bytes
            raise _unreadable(self.path, error) from error
        try:
            yield bag, list(bag.connections)
        finally:
            bag.close()


def _reader(path: Path) -> Any:
    """The unopened reader of rosbags; UsageError without the extra."""
    try:
        from rosbags import rosbag1, rosbag2
    except ImportError as error:
        raise UsageError(
            "ROS bags need the package rosbags, which is not installed",
            where=str(path),
            remedy="install it with: pip install 'imucalib[ros]'",
        ) from error
    try:
        if not path.is_dir():
            with path.open("rb") as file:
                if file.read(len(_ROS1)) == _ROS1:
                    return rosbag1.Reader(path)
        return rosbag2.Reader(path)
    except Exception as error:  # as above: whatever it raises, the bag cannot be opened
        raise _unreadable(path, error) from error


def _refuse_cut_database(path: Path) -> None:
    """SQLite reads the pages that a cut file lacks as zeros, so nothing of it can be trusted.

    Source: SQLite file format, section 1.3 (page size, file change counter, size in pages).
    """
    with path.open("rb") as file:
        head = file.read(100)
    if len(head) < 100 or not head.startswith(SQLITE):
        return
    page = int.from_bytes(head[16:18], "big")
    stated = (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big")
    size = path.stat().st_size
    if head[24:28] == head[92:96] and size < stated:
        raise UnreadableInput(
            f"the database is cut: it has {size} of {stated} bytes",
            where=str(path),
            remedy="copy it again, or recover it with the .recover command of sqlite3",
        )


def _unreadable(path: Path, error: Exception) -> UnreadableInput:
    detail = str(error) or type(error).__name__
    remedy = "copy it again from its source"
    if "index" in detail:
        remedy = "rebuild its index with 'rosbag reindex' (ROS 1) or 'ros2 bag reindex'"
    elif path.is_dir():
        remedy = "name the .db3 or .mcap file inside it: an MCAP file is read even when damaged"
    return UnreadableInput(
        f"the bag cannot be opened: {detail[:200]}", where=str(path), remedy=remedy
    )


def _topic(number: int, connection: Any) -> Topic:
    definition = connection.msgdef
    encoding = getattr(connection.ext, "serialization_format", "ros1")
    kind = "ros1msg" if encoding == "ros1" else _FORMATS[definition.format.name]
    # rosbags names types as ROS 2 does; a ROS 1 type is package/Type (MCAP specification, "ros1").
    name = connection.msgtype.replace("/msg/", "/") if encoding == "ros1" else connection.msgtype
    schema = Schema(number + 1, definition.data.encode(), kind, name)
    return Topic(number, connection.topic, encoding, schema, _read_metadata(connection.ext))


def _read_metadata(ext: Any) -> dict[str, str]:
    """How a topic is published, as MCAP files of bags state it: without, a latched one (/tf_static)
    reaches nobody who comes late."""
    from rosbags.rosbag2.metadata import dump_qos_v8

    if qos := getattr(ext, "offered_qos_profiles", None):
        return {"offered_qos_profiles": dump_qos_v8(qos)}
    return {"latching": str(ext.latching)} if getattr(ext, "latching", None) else {}


def _block(batch: list[tuple[int, int, int, bytes]]) -> MessageBlock:
    """Messages (channel, sequence, time in ns, payload) as records."""
    parts = []
    for channel, row, time, data in batch:
        size = MESSAGE_HEAD - 9 + len(data)
        parts += [_RECORD.pack(Opcode.MESSAGE, size, channel, row & 0xFFFFFFFF, time, time), data]
    lengths = np.array([MESSAGE_HEAD + len(b[3]) for b in batch], dtype=np.int64)
    return MessageBlock.of_records(b"".join(parts), np.cumsum(lengths) - lengths)


class RosbagReader(LogReader):
    """The reader of ROS bags; needs the extra `ros`."""

    name = "rosbag"
    suffixes = (".bag", ".db3")

    def recognises(self, path: Path, head: bytes) -> bool:
        """A ROS 1 bag, a ROS 2 database, or a folder with a metadata.yaml."""
        folder = not head and path.is_dir()
        database = head.startswith(SQLITE) and path.suffix.lower() == ".db3"
        return folder or database or head.startswith(_ROS1)

    def open(self, path: Path, mapping: FieldMapping, *, strict: bool = False) -> BagLog:
        """The bag."""
        return BagLog(path, strict=strict)


READER = RosbagReader()
