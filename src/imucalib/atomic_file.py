"""Files that are whole or not there: written beside their place and renamed into it."""

from __future__ import annotations

import errno
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from imucalib.errors import UsageError

_NAME = 120  # characters of the target's name kept in a temporary one: names end at 255 bytes


def demand_output(
    path: str | os.PathLike[str],
    inputs: Iterable[str | os.PathLike[str]] = (),
    *,
    force: bool = False,
) -> None:
    """Raise UsageError unless an output may be written to `path`; called before the work.

    inputs : files of the same run, which no output may be, `force` or not, whatever link or
        spelling leads to them; force : replace another file that is there already
    """
    target = Path(path)
    for source in map(Path, inputs):
        if _same(target, source) or (source.is_dir() and _same(target.parent, source)):
            raise UsageError(
                f"the output is the input {source}",
                where=str(path),
                remedy="name another file: inputs are never written to",
            )
    if os.path.lexists(target) and not target.is_file():
        raise UsageError("this is no regular file", where=str(path), remedy="name a new file")
    if target.exists() and not force:
        raise UsageError(
            "the file is there already", where=str(path), remedy="name another, or give --force"
        )
    _temporary_for(target).unlink(missing_ok=True)


def _same(one: Path, other: Path) -> bool:
    try:
        return one.samefile(other)
    except OSError:
        return False


@contextmanager
def replace_atomically(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path in the same folder, renamed to `path` when the block ends without error.

    A reader of `path` sees the old file or the whole new one, at every moment. What a killed run
    left beside `path` is removed. Raises UsageError when the folder is missing or not writable.
    """
    target = Path(path)
    _remove_stale(target)
    temporary = _temporary_for(target)
    try:
        yield temporary
        _fill_permissions(temporary)
        os.replace(temporary, target)
    except OSError as error:
        raise _unwritable(error, str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def replace_together(paths: Sequence[Path]) -> Iterator[tuple[Path, ...]]:
    """Temporary paths for several files, which take their places when the block ends: all or none.

    Where one cannot take its place the others get back what stood there before. Errors as in
    `replace_atomically`.
    """
    for target in paths:
        _remove_stale(target)
    made = list[Path]()
    try:
        made += (_temporary_for(target) for target in paths)
        yield tuple(made)
        _take_places(list(zip(made, paths, strict=True)))
    except OSError as error:
        where = str(error.filename2 or error.filename or paths[0])
        raise _unwritable(error, where) from error
    finally:
        for temporary in made:
            temporary.unlink(missing_ok=True)


def _take_places(pairs: list[tuple[Path, Path]]) -> None:
    """Rename every temporary file to its target, or put back what stood there and raise."""
    kept, taken = dict[Path, Path](), list[Path]()
    try:
        for _, target in pairs:
            if target.is_file():
                kept[target] = _temporary_for(target)
                shutil.copyfile(target, kept[target])
        for temporary, target in pairs:
            _fill_permissions(temporary)
            os.replace(temporary, target)
            taken.append(target)
    except BaseException:
        for target in taken:
            if target in kept:
                _fill_permissions(kept[target])
                os.replace(kept[target], target)
            else:
                target.unlink(missing_ok=True)
        raise
    finally:
        for old in kept.values():
            old.unlink(missing_ok=True)


def _temporary_for(target: Path) -> Path:
    """A new empty file that names its target, this machine and this process."""
    try:
        handle, name = tempfile.mkstemp(
            prefix=f".{target.name[:_NAME]}.{_machine()}-{os.getpid()}-",
            suffix=".tmp",
            dir=target.parent,
        )
    except (OSError, ValueError) as error:
        raise _unwritable(error, str(target)) from error
    os.close(handle)
    return Path(name)


def _unwritable(error: OSError | ValueError, where: str) -> UsageError:
    """The failure in the system's words, and what to do about it."""
    remedy = "name a place where you may write"
    if getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        remedy = "make room there, or name a file on another disk"
    what = getattr(error, "strerror", None) or error
    return UsageError(f"the output cannot be written: {what}", where=where, remedy=remedy)


def _remove_stale(target: Path) -> None:
    """Remove temporary files of this target whose process, on this machine, is gone."""
    ours = re.compile(re.escape(f".{target.name[:_NAME]}.{_machine()}-") + r"(\d+)-[a-z0-9_]+\.tmp")
    try:
        for name in os.listdir(target.parent):
            found = ours.fullmatch(name)
            if found and not _alive(int(found.group(1))):
                target.with_name(name).unlink(missing_ok=True)
    except OSError:
        return  # tidying is no reason to fail: whether the folder is writable shows next


def _machine() -> str:
    return re.sub(r"[^A-Za-z0-9]", "", platform.node())[:32]


def _alive(process: int) -> bool:
    if os.name == "nt":  # there signal 0 is Ctrl-C
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def _fill_permissions(path: Path) -> None:
    # mkstemp makes files private (0600); an output has the permissions of any new file.
    mask = os.umask(0)
    os.umask(mask)
    path.chmod(0o666 & ~mask)
