"""What commands print and say: results to stdout, the rest to stderr, a clock while they work."""

from __future__ import annotations

import os
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from imucalib.data import Data
    from imucalib.report.render.document import Document

#: What JSON may hold as it is but a terminal obeys: DEL, C1, line separators, direction marks.
_CONTROLS = re.compile("[\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")
Say = Callable[[str], None]
#: Seconds until the first sign of life where there is no terminal, and between the next ones.
_FIRST, _NEXT = 1.0, 10.0
#: `M_TRIM_THRESHOLD` and `M_MMAP_THRESHOLD` of <malloc.h>.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3


def width() -> int:
    """Columns of the terminal; 80 where there is none."""
    return shutil.get_terminal_size((80, 24)).columns if sys.stdout.isatty() else 80


def color() -> bool:
    """Colour only on a terminal, and never when NO_COLOR is set."""
    return sys.stdout.isatty() and "NO_COLOR" not in os.environ


def emit_json(content: Any) -> None:
    """The result as one JSON document on stdout."""
    from imucalib.data import json_text, plain

    text = json_text(plain(content))
    click.echo(_CONTROLS.sub(lambda found: f"\\u{ord(found[0]):04x}", text))


def show(document: Document, *, full: bool = False) -> None:
    """A document as text on stdout; its first screen or page unless `full`."""
    from imucalib.report.render.text import render_text

    click.echo(render_text(document, width(), color=color(), full=full), nl=False)


def present(
    document: Document, content: Data | Mapping[str, Any], options: Mapping[str, Any]
) -> None:
    """The result as --html, --json, --quiet and --full ask for it."""
    if (page := options.get("html")) is not None:
        from imucalib.calibration.file import write_whole
        from imucalib.report.render.html import render_html

        write_whole(page, render_html(document))
        note(f"wrote {page}", options["quiet"])
    if options["as_json"]:
        emit_json(content)
    elif not options["quiet"]:
        show(document, full=options["full"])


def tell(content: Data, options: Mapping[str, Any], words: str) -> None:
    """A result that has no page: as JSON where that is asked for, else in words."""
    if options["as_json"]:
        emit_json(content)
    elif not options["quiet"]:
        say(words)


def note(text: str, quiet: bool) -> None:
    """A line about the work, to stderr."""
    if not quiet:
        say(text, err=True)


def say(text: str, *, err: bool = False) -> None:
    """A line; names out of foreign files cannot steer the terminal."""
    from imucalib.report.render.terminal import safe

    click.echo(safe(text), err=err)


@contextmanager
def progress(total: int, what: str, quiet: bool) -> Iterator[Callable[[bool], None]]:
    """Yields what says that one more is done, and whether at no cost, which says nothing of the
    others: a bar on a terminal, else a line for every tenth part."""
    if quiet:
        yield lambda free: None
    elif sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import Progress, TimeRemainingColumn

        columns = (*Progress.get_default_columns()[:-1], TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True)) as bar:
            task = bar.add_task(what, total=total)
            yield lambda free: bar.advance(task)
    else:
        done, paid, start = 0, 0, time.monotonic()

        def advance(free: bool) -> None:
            nonlocal done, paid
            done, paid = done + 1, paid + (not free)
            if done == total or done * 10 // total > (done - 1) * 10 // total:
                each = (time.monotonic() - start) / paid if paid else 0.0
                left = f", about {each * (total - done):.0f} s left" if paid else ""
                click.echo(f"{done} of {total} {what}{left}", err=True)

        yield advance


@contextmanager
def working(what: str, *, quiet: bool, verbose: bool = False) -> Iterator[Say]:
    """Yields a function that says a line about the work; meanwhile shows that it goes on.

    what : the work in words, such as "calibrating"
    """
    if quiet:
        yield lambda text: None
        return
    start, spent = time.monotonic(), time.process_time()

    def stamped(text: str) -> str:
        return f"{time.monotonic() - start:7.2f} s  {text}" if verbose else text

    shown = _on_terminal if sys.stderr.isatty() else _in_lines
    with shown(what, start) as line:
        yield lambda text: line(stamped(text))
        if verbose:
            cost = time.process_time() - spent
            line(stamped(f"{what} took {cost:.1f} s of CPU time"))


@contextmanager
def _on_terminal(what: str, start: float) -> Iterator[Say]:
    """A spinner with a clock, gone when the work is done; lines stand above it."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.text import Text

    from imucalib.report.render.terminal import safe

    console = Console(stderr=True, highlight=False)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        bar.add_task(what, total=None)
        yield lambda text: console.print(Text(safe(text)), soft_wrap=True)


@contextmanager
def _in_lines(what: str, start: float) -> Iterator[Say]:
    """A line after a second and then every ten, until the work is done."""
    done = Event()

    def beat() -> None:
        wait = _FIRST
        while not done.wait(wait):
            say(f"{what}: {time.monotonic() - start:.0f} s", err=True)
            wait = _NEXT

    thread = Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield lambda text: say(text, err=True)
    finally:
        done.set()
        thread.join()


def freed_memory(*, large: int, kept: int) -> None:
    """Arrays from so many bytes on have pages of their own, which go back to the system when they
    are freed; so many free bytes at the end of all others are kept. With another C library than
    that of Linux (glibc), or where its limit is lower, all stays as it is."""
    import ctypes

    with suppress(AttributeError, OSError, TypeError):  # another system, another library
        library = ctypes.CDLL(None)
        if library.mallopt(_MMAP_THRESHOLD, large):
            library.mallopt(_TRIM_THRESHOLD, kept)
