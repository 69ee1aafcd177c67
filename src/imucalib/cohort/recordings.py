"""Which recordings a study has: files, folders, globs and manifests, sniffed by content."""

from __future__ import annotations

import csv
import glob
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from imucalib.errors import ImucalError, UnreadableInput
from imucalib.readers import reader_for, readers
from imucalib.readers.fields.source import HEAD_BYTES

#: Lines of a text that are looked at.
_LINES = 100


def recordings_of(inputs: Sequence[str]) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """The recordings that arguments name: a recording; a folder, with all below it; a glob; or a
    manifest, which is text whose lines, or whose column "path", name files. They are absolute
    paths, each once, in the order given; with words of where they come from and what was left out.

    Raises UnreadableInput for what is not there, names nothing, or is named twice in a manifest.
    """
    found, said = dict[Path, None](), list[str]()
    for text in inputs:
        parts = _glob(text)
        for path in parts:
            named, words = _of_one(path)
            found.update(dict.fromkeys(named))
            said += words
        if parts != [Path(text)]:
            said.append(f"{text}: {len(parts)} matches")
    if not found:
        raise UnreadableInput("no recording in it", where=", ".join(inputs))
    return tuple(found), tuple(said)


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))


def _glob(text: str) -> list[Path]:
    """The path itself, or what a pattern that the shell did not expand matches."""
    if os.path.exists(text) or not glob.has_magic(text):
        return [Path(text)]
    matches = [Path(name) for name in sorted(glob.glob(text, recursive=True))]
    if not matches:
        raise UnreadableInput("nothing matches", where=text, remedy="correct the pattern")
    return matches


def _of_one(path: Path) -> tuple[list[Path], list[str]]:
    if path.is_dir():
        return _in_folder(path)
    if not path.exists():
        raise UnreadableInput(
            "no such file or folder",
            where=str(path),
            remedy="name recordings, a folder of them, or a manifest: a path a line",
        )
    names = _manifest(path)
    if names is None:
        return [_absolute(path)], []
    found = [_absolute(path.parent / name) for name in names]
    if twice := sorted(str(p) for p, times in Counter(found).items() if times > 1):
        raise UnreadableInput(f"named twice: {', '.join(twice)}", where=str(path))
    return found, [f"{path}: a manifest of {len(names)}"]


def _in_folder(folder: Path) -> tuple[list[Path], list[str]]:
    """Every file with a recording's suffix, but manifests and texts without numbers; the folder
    itself where it is a bag."""
    if (folder / "metadata.yaml").is_file():
        return [_absolute(folder)], []
    found, other = list[Path](), list[str]()
    suffixes = tuple(suffix for reader in readers() for suffix in reader.suffixes)
    for path in _files(folder):
        if path.is_dir() or (path.name.lower().endswith(suffixes) and not _mere_text(path)):
            found.append(_absolute(path))
        else:
            other.append(path.name)
    words = f"{folder}: {len(found)} recordings"
    if other:
        shown = ", ".join(other[:3]) + (", ..." if len(other) > 3 else "")
        words += f"; left out, as they are none: {shown} ({len(other)})"
    return found, [words]


def _files(folder: Path) -> Iterator[Path]:
    """Files below a folder, and folders that are a bag, in the order of their names."""
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            yield from _files(path)
        else:
            yield path


def _mere_text(path: Path) -> bool:
    """Whether a file is text and no recording; an empty or damaged file is one that failed."""
    try:
        return bool(_head(path)) and (_manifest(path) is not None or not _has_numbers(path))
    except UnreadableInput:
        return True


def _has_numbers(path: Path) -> bool:
    try:
        return reader_for(path).recognises(path, path.open("rb").read(HEAD_BYTES))
    except (OSError, ImucalError):
        return False


def _head(path: Path) -> str:
    """The start of a text; empty for anything else."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError:
        return ""
    if any(byte < 32 and byte not in b"\t\n\r" for byte in head):
        return ""
    return head.decode("utf-8-sig", errors="replace")


def _manifest(path: Path) -> tuple[str, ...] | None:
    """What a manifest names, None for a file that is no manifest.

    Raises UnreadableInput for text that is neither a manifest nor a recording.
    """
    head = _head(path)
    if not head.strip():
        return None
    lines = _entries(head)[:_LINES]
    nothing = UnreadableInput("the manifest names no recording", where=str(path))
    if not lines:
        raise nothing
    separator = _separator(lines[0])
    if separator is None and not any(os.path.exists(path.parent / line) for line in lines):
        if _has_numbers(path):
            return None
        raise UnreadableInput(
            f"none of the files that it names is there, the first '{lines[0][:60]}'",
            where=str(path),
            remedy="write paths relative to the manifest, one a line, or a CSV with a column path",
        )
    try:
        whole = _entries(path.read_bytes().decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise UnreadableInput("the manifest is no text in UTF-8", where=str(path)) from None
    if separator is not None:
        rows = csv.DictReader(whole, delimiter=separator)
        whole = [str(row["path"]).strip() for row in rows if row["path"]]
    if not whole:
        raise nothing
    return tuple(whole)


def _entries(text: str) -> list[str]:
    """Lines with something in them that is no comment."""
    lines = (line.strip() for line in text.splitlines())
    return [line for line in lines if line and not line.startswith("#")]


def _separator(heading: str) -> str | None:
    """What parts the columns of a heading that has a column "path"."""
    for separator in ",;\t":
        if "path" in next(csv.reader([heading], delimiter=separator)):
            return separator
    return None
