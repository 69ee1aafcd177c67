"""Files made to cost: each ends in a clear error within 5 CPU seconds and 300 MB."""

from __future__ import annotations

import copy
import gzip
import json
import os
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import lz4.frame
import numpy as np
import pytest
import zstandard
from google.protobuf import descriptor_pb2

from imucalib.readers import readers
from imucalib.readers.mcap import MAGIC
from worlds.every_format import WRITE
from worlds.logger_files import GENE_HEADER, ax_header
from worlds.mcap_logs import SEPARATOR, write_log
from worlds.turned import turned

SECONDS, MEGABYTES, ZEROS = 5.0, 300, 400 << 20
CHILD = """
import json, sys, time
from imucalib.errors import UnreadableInput
from imucalib.readers import blocks
start = time.process_time()
try:
    for block in blocks(sys.argv[1]):
        pass
    said = ""
except UnreadableInput as error:
    said = str(error)
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(json.dumps([said, time.process_time() - start, int(peak.split()[1]) / 1024]))
"""


def ros(definition: str, payload: bytes = bytes(68)) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        messages = [(1000 * k + 1, b"\0\1\0\0" + payload) for k in range(50)]
        write_log(path, {"/imu": messages}, schema=("a/A", "ros2msg", definition.encode()))

    return make


def types(*bodies: str) -> str:
    first, *others = bodies
    named = (f"{SEPARATOR}\nMSG: a/B{k}\n{body}" for k, body in enumerate(others))
    return first + "".join(named)


def many_datasets(path: Path) -> None:
    with h5py.File(path, "w", libver="latest") as file:
        for k in range(20_000):
            file[f"acc{k}"] = k


def deep_groups(path: Path) -> None:
    with h5py.File(path, "w") as file:
        group: h5py.Group = file
        for _ in range(3000):
            group = group.create_group("g")
        group["acc"] = np.zeros((5, 3))


def one_chunk(path: Path) -> None:
    with h5py.File(path, "w") as file:
        shape = (1 << 23, 3)
        held = file.create_dataset("acc", shape, "f8", chunks=shape, compression="gzip")
        held[:10] = 1.0
        held.attrs["sampling_rate"] = 100.0


def sparse(head: bytes) -> Callable[[Path], None]:
    """Some bytes, then zeros that take no room on the disk: as a logger's preallocated file."""

    def make(path: Path) -> None:
        path.write_bytes(head)
        os.truncate(path, len(head) + ZEROS)

    return make


def many_names(path: Path) -> None:
    """A zip archive whose directory names a member half a million times."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("info.txt", "x")
        for k in range(500_000):
            archive.filelist.append(copy.copy(archive.filelist[0]))
            archive.filelist[-1].filename = f"member {k:060d}"


def zipped(content: bytes) -> Callable[[Path], None]:
    return lambda path: (path.write_bytes(gzip.compress(content, 6)), None)[1]


def chunk(compression: str, claims: int, share: float) -> Callable[[Path], None]:
    """An MCAP file whose one chunk unpacks to two gigabytes, the end cut off where share < 1."""

    def make(path: Path) -> None:
        if compression == "zstd":
            packed = zstandard.compress(bytes(1 << 24)) * 128
        else:
            packed = lz4.frame.compress(bytes(1 << 28))
        name = compression.encode()
        head = struct.pack("<QQQII", 1, 1, claims, 0, len(name)) + name
        content = head + struct.pack("<Q", len(packed)) + packed
        data = struct.pack("<BQ", 6, len(content)) + content
        path.write_bytes(MAGIC + data[: int(share * len(data))])

    return make


def own_type(path: Path) -> None:
    """A protobuf message of twelve of its own type."""
    files = descriptor_pb2.FileDescriptorSet()
    kind = files.file.add(name="p.proto", package="p", syntax="proto3").message_type.add(name="Imu")
    for k in range(12):
        kind.field.add(name=f"f{k}", number=k + 1, label=1, type=11, type_name=".p.Imu")
    kind.field.add(name="n", number=100, label=1, type=1)
    schema = ("p.Imu", "protobuf", files.SerializeToString())
    write_log(path, {"/imu": [(1, b"")]}, schema=schema, encoding="protobuf")


PAGES = GENE_HEADER.format(rate=50, zone="+01:00", pages=1).encode()
FILES: dict[str, Callable[[Path], None]] = {
    "self.mcap": ros(types("a/A child\nfloat64 x\n")),
    "circle.mcap": ros(types("a/B0 b\n", "a/B1 c\n", "a/B0 d\nfloat64 x\n")),
    "arrays.mcap": ros(types("a/B0 b\n", *(f"a/B{k}[4096] c\n" for k in range(1, 12)), "int8 z\n")),
    "empty.mcap": ros(types("a/B0 b\n", *(f"a/B{k}[4096] c\n" for k in range(1, 12)), "")),
    "wide.mcap": ros(
        types("a/B0 b\n", *("".join(f"a/B{k} c{i}\n" for i in range(50)) for k in range(1, 9)),
              "float64 x\n")
    ),
    "sequence.mcap": ros(types("a/B0[] b\n", "uint8[] c\n"), b"\xff" * 4 + bytes(64)),
    **{
        f"{compression}_{claims >> 20}_{share}.mcap": chunk(compression, claims, share)
        for compression in ("zstd", "lz4")
        for claims in (1 << 20, 2 << 30)
        for share in (0.9, 1.0)
    },
    "own_type.mcap": own_type,
    "many.h5": many_datasets,
    "deep.h5": deep_groups,
    "chunk.h5": one_chunk,
    "line.csv.gz": zipped(b"1," * (60 << 20)),
    "columns.csv": lambda path: (path.write_text("x," * 200_000 + "\n" + "1," * 200_000), None)[1],
    "zeros.cwa.gz": zipped(ax_header() + bytes(1 << 27)),
    "pages.bin.gz": zipped(PAGES + b"Recorded Data\n" * (2 << 20)),
    "names.gt3x": many_names,
    "names.csv": many_names,
    "header.bin.gz": zipped(b"Device Identity\n" + b"\n" * (1 << 26)),
}  # fmt: skip


def _of(path: Path) -> tuple[str, float, float]:
    """What a reading of a file says, in which CPU seconds and megabytes."""
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-500:]
    said, seconds, megabytes = json.loads(done.stdout)
    return said, seconds, megabytes


NEEDS_LINUX = pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="asks Linux for the memory"
)
#: Of each way of costing one file in the fast tier.
FAST = {"circle.mcap", "empty.mcap", "own_type.mcap", "zstd_1_0.9.mcap", "lz4_2048_1.0.mcap"}


@NEEDS_LINUX
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in FAST else pytest.mark.slow) for n in FILES]
)
def test_a_file_made_to_cost_ends_soon(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    FILES[name](path)
    said, seconds, megabytes = _of(path)
    assert said.startswith(str(path)), "no error"
    assert seconds < SECONDS
    assert megabytes < MEGABYTES


@pytest.mark.slow
@NEEDS_LINUX
@pytest.mark.parametrize("suffix", sorted({r.suffixes[0] for r in readers()}))
def test_zeros_under_any_name_end_soon(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"zeros{suffix}"
    sparse(b"")(path)
    said, seconds, megabytes = _of(path)
    assert said.startswith(str(path)), "no error"
    assert seconds < SECONDS
    assert megabytes < MEGABYTES


@pytest.mark.slow
@NEEDS_LINUX
@pytest.mark.parametrize("cut", [0, 7])
@pytest.mark.parametrize("name", WRITE)
def test_a_log_with_a_tail_of_zeros_costs_a_block(name: str, cut: int, tmp_path: Path) -> None:
    path = WRITE[name](tmp_path, *turned(2))
    data = path.read_bytes()
    sparse(data[: len(data) - cut])(path)
    _, seconds, megabytes = _of(path)
    assert seconds < SECONDS
    assert megabytes < MEGABYTES
