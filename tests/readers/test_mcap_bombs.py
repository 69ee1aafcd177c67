"""Files made to cost memory or time: each ends soon, in a clear error or with what is readable."""

from __future__ import annotations

import struct
import time
import tracemalloc
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from google.protobuf import descriptor_pb2

from imucalib.errors import UnreadableInput
from imucalib.readers import read
from imucalib.readers.mcap import MAGIC, MAX_CHUNK, RECORD_HEADER
from imucalib.readers.messages.layout import Layout, LayoutError, parse_definition
from worlds.mcap_logs import START, write_log


def chunk(packed: bytes, size: int, compression: bytes) -> bytes:
    head = struct.pack("<QQQI", START, START, size, 0) + struct.pack("<I", len(compression))
    content = head + compression + struct.pack("<Q", len(packed)) + packed
    return RECORD_HEADER.pack(6, len(content)) + content


def refused_cheaply(path: Path) -> str:
    tracemalloc.start()
    start = time.process_time()
    try:
        with pytest.raises(UnreadableInput) as caught:
            read(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 4 * MAX_CHUNK
    assert time.process_time() - start < 20.0
    return str(caught.value)


@pytest.mark.parametrize("compression", [b"zstd", b"lz4"])
@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("claims", [1 << 20, 2 << 30])
def test_a_chunk_of_two_gigabytes_is_not_unpacked(
    compression: bytes, cut: bool, claims: int, tmp_path: Path
) -> None:
    zeros = bytes(1 << 24)
    if compression == b"zstd":
        packed = zstandard.ZstdCompressor().compress(zeros) * 128
    else:
        packed = lz4.frame.compress(bytes(1 << 28))
    data = chunk(packed, claims, compression)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(MAGIC + (data[: int(0.9 * len(data))] if cut else data))
    refused_cheaply(path)


def nested(name: str, inner: str, depth: int) -> str:
    parts = [f"{inner}[4096] a"]
    for k in range(depth):
        parts.append(f"{'=' * 80}\nMSG: p/{inner}{k or ''}\n{inner}{k + 1}[4096] a")
    return "\n".join(parts) + f"\n{'=' * 80}\nMSG: p/{inner}{depth}\n"


def test_nested_arrays_of_empty_structures_end() -> None:
    definition = parse_definition("p/Root", nested("Root", "T", 6), ros1=True)
    start = time.process_time()
    with pytest.raises(LayoutError, match="elements"):
        Layout(definition, bytes(8))
    assert time.process_time() - start < 2.0


def test_a_recursive_definition_in_a_file_is_an_error_of_the_file(tmp_path: Path) -> None:
    schema = ("p/msg/Imu", "ros2msg", b"Imu a\nfloat64 x\n")
    path = write_log(
        tmp_path / "a.mcap", {"/imu": [(START, b"\0\1\0\0" + bytes(300))]}, schema=schema
    )
    with pytest.raises(UnreadableInput, match="circle"):
        read(path)


def test_a_protobuf_of_its_own_type_ends(tmp_path: Path) -> None:
    files = descriptor_pb2.FileDescriptorSet()
    file = files.file.add(name="p.proto", package="p", syntax="proto3")
    kind = file.message_type.add(name="Imu")
    for k in range(12):
        kind.field.add(name=f"f{k}", number=k + 1, label=1, type=11, type_name=".p.Imu")
    kind.field.add(name="n", number=100, label=1, type=1)
    schema = ("p.Imu", "protobuf", files.SerializeToString())
    path = write_log(
        tmp_path / "a.mcap", {"/imu": [(START, b"")]}, schema=schema, encoding="protobuf"
    )
    refused_cheaply(path)
