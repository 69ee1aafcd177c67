"""The input file before any format is known: can it be opened at all, and of what kind is a file
that is no recording."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from imucalib.errors import UnreadableInput
from imucalib.question import paste

HEAD_BYTES = 65536  #: what `recognises` gets to see
#: Bytes within which a zip archive's end record lies (22 and a comment of 64 KiB), and of its
#: directory: some 10,000 files.
_ARCHIVE_END, _MOST_DIRECTORY = 22 + (1 << 16), 1 << 20
_TABLE = "export the table as CSV, and give that"
_OTHER = "give the recording or table itself"
_READ = "and read that: imucal inspect FILE.csv"
_UNPACK = "unpack it, and give one file of it"


def head_of(path: Path) -> bytes:
    """The first HEAD_BYTES of a regular, non-empty, readable file; UnreadableInput otherwise."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        detail = getattr(error, "strerror", None) or str(error)
        raise UnreadableInput(
            f"the file cannot be opened: {detail}", where=str(path), remedy="check the path"
        ) from error
    if stat.S_ISDIR(mode):
        raise UnreadableInput(
            "this is a directory",
            where=str(path),
            remedy=f"name a file of it, or take all: imucal batch {paste(path)} -o out",
        )
    if not stat.S_ISREG(mode):
        raise UnreadableInput(
            "this is not a regular file (a pipe, socket or device)",
            where=str(path),
            remedy="save the stream to a file first",
        )
    try:
        with path.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
    except OSError as error:
        raise UnreadableInput(
            f"the file cannot be read: {error.strerror}",
            where=str(path),
            remedy="check its permissions",
        ) from error
    if not head:
        raise UnreadableInput(
            "the file is empty (0 bytes)", where=str(path), remedy="copy it again from its source"
        )
    return head


def small_directory(path: Path) -> bool:
    """Whether a zip archive's directory, which is held in memory, is that of some files: a hundred
    million names make a bomb of it. False also where there is none."""
    with path.open("rb") as stream:
        stream.seek(max(0, stream.seek(0, os.SEEK_END) - _ARCHIVE_END))
        tail = stream.read()
    at = tail.rfind(b"PK\x05\x06")
    return at >= 0 and int.from_bytes(tail[at + 12 : at + 16], "little") <= _MOST_DIRECTORY


@dataclass(frozen=True)
class Kind:
    """name : of such a file; remedy : the next step; head : what it begins with"""

    name: str
    remedy: str
    head: re.Pattern[bytes]


def _kinds(rows: Sequence[tuple[bytes, str, str]]) -> tuple[Kind, ...]:
    return tuple(Kind(name, remedy, re.compile(head, re.S | re.I)) for head, name, remedy in rows)


#: Of which no reader may have a guess: text that is no table, documents, pictures, programs.
REFUSED = _kinds(
    [
        (
            rb"\s*(<!doctype html|<html)",
            "a web page",
            "a report is looked at in a browser; " + _OTHER,
        ),
        (rb"# imucal calibration", "a calibration", "imucal validate, apply and export take it"),
        (
            rb"\s*\{\s*\"schema\": \"imucal/",
            "a report of imucal",
            "its page is report.html; " + _OTHER,
        ),
        (rb"\s*<\?xml", "XML", _TABLE),
        (
            rb"version https://git-lfs",
            "a pointer of Git LFS, not the file",
            "fetch it: git lfs pull",
        ),
        (rb"%PDF-", "a PDF document", _TABLE),
        (rb"\x89PNG\r\n|\xff\xd8\xff|GIF8[79]a|BM.{4}\0\0\0\0|RIFF.{4}WEBP", "a picture", _OTHER),
        (rb".{4}ftyp", "a film", _OTHER),
        (rb"\x7fELF|MZ|\xcf\xfa\xed\xfe", "a program", _OTHER),
        (rb"PAR1", "a Parquet table", _TABLE),
        (rb"ARROW1|FEA1", "a Feather table", _TABLE),
        (rb"\x93NUMPY", "an array of NumPy (.npy)", "write it with numpy.savetxt, or as HDF5"),
        (rb"\x80[\x02-\x05]", "a pickle of Python", _TABLE + "; a pickle may hold code"),
        (rb"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a document of Office 97 (.xls, .doc)", _TABLE),
        (
            rb"GENEA.*\0",  # the device of Unilever Discover: five letters, text, binary pages
            "a GENEA recording (.bin of the device before GENEActiv), which is not read",
            "convert it to CSV, for example with the R package GGIRread (readGenea), " + _READ,
        ),
        (
            rb".{512}MDTC",  # remarks, then the recognition string
            "a Matrix recording (.bin of Parmay Tech), which is not read",
            "export it as CSV with the maker's program or GGIRread (readParmayMatrix), " + _READ,
        ),
        (rb"7z\xbc\xaf|Rar!|.{257}ustar|BZh\d1AY|\xfd7zXZ", "a packed archive", _UNPACK),
    ]
)
#: Of which some reader may read some: named where none does.
UNREAD = _kinds(
    [
        (rb"PK\x03\x04.*word/", "a document of Word", _TABLE),
        (rb"PK\x03\x04.*xl/", "a spreadsheet", f"imucal lab reads its positions; else {_TABLE}"),
        (rb"PK\x03\x04", "a zip archive", _UNPACK),
        (rb"\x1f\x8b", "a file packed with gzip", _UNPACK),
        (rb"SQLite format 3\0", "a database of SQLite", _TABLE),
        (rb"\s*[{\[]", "JSON", _TABLE),
    ]
)


def file_kind(head: bytes, kinds: tuple[Kind, ...]) -> Kind | None:
    """The kind of file that begins so, or None."""
    return next((kind for kind in kinds if kind.head.match(head)), None)
