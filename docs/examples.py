"""The commands that the pages show: found, run as they stand, and their outputs filled in.

In a block ```sh every line that starts with `imucal` runs, in a block ```text the line after "$ ",
whose output follows it. What stands behind "#": `exit N` where the exit code is neither 0 nor 5,
`slow` where it takes more than ten seconds or needs one that does: the slow ones of a page run
without the others. A pipe into `head -n N` cuts the output. A block ```python NAME or ```text NAME
is a file that the commands after it find.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
_FENCE = re.compile(r"^```(\w+) ?(\S*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_HEAD = re.compile(r"\s*\|\s*head -n (\d+)")


@dataclass(frozen=True)
class Example:
    """One command of a page; shown : the output that the page prints, None where it prints none."""

    line: str
    arguments: tuple[str, ...]
    codes: tuple[int, ...]
    slow: bool
    most: int | None
    shown: str | None


def examples(text: str) -> list[Example]:
    """Every command of a page, in order."""
    found = []
    for kind, _, body in _FENCE.findall(text):
        if kind == "text" and body.startswith("$ imucal"):
            line, _, shown = body.partition("\n")
            found.append(_example(line[2:], shown))
        elif kind == "sh":
            found += [_example(line, None) for line in body.splitlines() if line[:7] == "imucal "]
    return found


def _example(line: str, shown: str | None) -> Example:
    command, _, words = line.partition(" #")
    head = _HEAD.search(command)
    code = re.search(r"exit (\d+)", words)
    return Example(
        line=line,
        arguments=tuple(shlex.split(_HEAD.sub("", command))[1:]),
        codes=(int(code[1]),) if code else (0, 5),
        slow="slow" in words,
        most=int(head[1]) if head else None,
        shown=shown,
    )


def files(text: str) -> dict[str, str]:
    """The files that a page defines, by name."""
    return {name: body for _, name, body in _FENCE.findall(text) if name}


def run(example: Example) -> tuple[int, str]:
    """Exit code and what the page would show of the output, in the current folder."""
    from click.testing import CliRunner

    from imucalib import cli
    from imucalib.errors import ImucalError

    done = CliRunner().invoke(cli.cli, list(example.arguments), standalone_mode=False)
    if isinstance(done.exception, ImucalError):
        return done.exception.exit_code, f"{done.stdout}error: {done.exception}\n"
    if done.exception is not None:
        raise done.exception
    lines = done.stdout.splitlines()[: example.most]
    return done.return_value or 0, "".join(f"{line}\n" for line in lines)


@contextmanager
def bench(folder: Path, page: Path) -> Iterator[None]:
    """A folder that looks like the root of a clone, with the files that the page defines."""
    before = Path.cwd()
    (folder / "sample_logs").symlink_to(ROOT / "sample_logs")
    for name, body in files(page.read_text(encoding="utf-8")).items():
        (folder / name).write_text(body, encoding="utf-8")
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def filled(page: Path, folder: Path) -> str:
    """The page with every output as the program prints it now."""
    text = page.read_text(encoding="utf-8")
    with bench(folder, page):
        found = examples(text)
        last = max((k for k, e in enumerate(found) if e.shown is not None), default=-1)
        for example in found[: last + 1]:  # what a command shows may rest on those before it
            output = run(example)[1]
            if example.shown is not None:
                block = f"$ {example.line}\n"
                text = text.replace(f"{block}{example.shown}```", f"{block}{output}```")
    return text
