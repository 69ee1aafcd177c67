"""One run of the command in this process, and what differs between two of them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner

from imucalib import cli, effects
from imucalib.errors import ImucalError
from options.schemas import keep_schema

#: Blocks of a result that say where it came from, not what it is.
ORIGIN = {"provenance", "notes", "output", "written", "path", "sha256", "file", "mapping", "input",
          "format", "seconds", "adjusted", "command",
          "log", "sensor"}  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """code : exit code; files : contents of what was written, by name below the run's folder"""

    code: int
    stdout: str
    stderr: str
    folder: Path

    @property
    def content(self) -> Any:
        """What was printed as JSON."""
        found = json.loads(self.stdout)
        return {"list": found} if isinstance(found, list) else found

    @property
    def files(self) -> dict[str, bytes]:
        return {
            p.relative_to(self.folder).as_posix(): p.read_bytes()
            for p in sorted(self.folder.rglob("*"))
            if p.is_file()
        }

    def text(self, name: str) -> str:
        return (self.folder / name).read_text(encoding="utf-8")


def run(arguments: list[str], folder: Path) -> Outcome:
    """The command, with what `main` does about failures."""
    folder.mkdir(parents=True, exist_ok=True)
    done = CliRunner().invoke(cli.cli, arguments, standalone_mode=False)
    effects._LOADED.clear()  # as in a process of its own
    error = done.exception
    if "--json" in arguments[: arguments.index("--") if "--" in arguments else None]:
        keep_schema(json.loads(done.stdout))
    if error is None:
        return Outcome(int(done.return_value or 0), done.stdout, done.stderr, folder)
    code = getattr(error, "exit_code", None)
    if code is None:
        raise AssertionError(f"imucal {' '.join(arguments)} crashed") from error
    told = str(error) if isinstance(error, ImucalError) else error.format_message()
    return Outcome(code, done.stdout, done.stderr + told, folder)


def leaves(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every number and word of a result with its place, its origin left out, and the command that
    was typed where it is proposed again."""
    if isinstance(node, dict):
        for key, value in node.items():
            if key not in ORIGIN:
                yield from leaves(value, f"{path}/{key}")
    elif isinstance(node, list):
        for k, value in enumerate(node):
            yield from leaves(value, f"{path}/{k}")
    elif "/to_do/" in path:
        yield path, re.sub(r"`imucal .*?`", "", node)
    else:
        yield path, node


def differences(one: Any, two: Any, rtol: float = 1e-6) -> list[str]:
    """Places at which two results differ."""
    first, second = dict(leaves(one)), dict(leaves(two))
    return [
        place
        for place in [*first, *(p for p in second if p not in first)]
        if place not in first or place not in second or not _same(first[place], second[place], rtol)
    ]


def _same(a: Any, b: Any, rtol: float) -> bool:
    if isinstance(a, float) and isinstance(b, float):
        return bool(np.isclose(a, b, rtol=rtol, atol=1e-7, equal_nan=True))
    return bool(a == b)


def differ(one: Outcome, two: Outcome) -> bool:
    """Whether two runs say or wrote anything else, apart from where they did it."""
    if one.code != two.code or (one.code and one.stderr != two.stderr):
        return True
    try:
        same = not differences(one.content, two.content) and _written(one) == _written(two)
        return not same or _told(one)[1] != _told(two)[1]
    except json.JSONDecodeError:
        return _told(one) != _told(two) or _written(one) != _written(two)


def _told(one: Outcome) -> tuple[str, str]:
    """Both streams without the folder's name and the clock."""
    out, err = (text.replace(str(one.folder), "") for text in (one.stdout, one.stderr))
    return out, re.sub(r"(?m)^(reading|correcting|converting|calibrating): .*\n", "", err)


def _written(one: Outcome) -> dict[str, bytes]:
    return {name: data.replace(str(one.folder).encode(), b"") for name, data in one.files.items()}


def blocks(places: list[str]) -> set[str]:
    """The outermost names of places."""
    return {place.split("/")[1] for place in places}
