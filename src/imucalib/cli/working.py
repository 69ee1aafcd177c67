"""What a command says while it works: a clock on a terminal, plain lines elsewhere, on stderr. And
what memory it keeps meanwhile."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread

import click

from imucalib.cli.output import say

Say = Callable[[str], None]
#: Seconds until the first sign of life where there is no terminal, and between the next ones.
_FIRST, _NEXT = 1.0, 10.0
#: `M_TRIM_THRESHOLD` and `M_MMAP_THRESHOLD` of <malloc.h>.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3

verbose_option = click.option(
    "-v", "--verbose", is_flag=True, help="Say when each thing happened, and what it cost."
)


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
