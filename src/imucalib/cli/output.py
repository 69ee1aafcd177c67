"""Options and output that all commands share: results to stdout, everything else to stderr."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    Kind = click.ParamType[str]
else:
    Kind = click.ParamType

#: What JSON may hold as it is but a terminal obeys: DEL, C1, line separators, direction marks.
_CONTROLS = re.compile("[\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")
Command = TypeVar("Command", bound=Callable[..., Any])


class ExportForm(Kind):
    """The name of an export, whichever files there are."""

    name = "form"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from imucalib.exports import exports

        if value not in exports():
            self.fail(f"'{value}' is none of {', '.join(exports())}", param, ctx)
        return str(value)


class FormOption(click.Option):
    """An option that names an export; its help lists them."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        from imucalib.exports import exports

        name, text = super().get_help_record(ctx) or ("", "")
        return name, f"{text.rstrip('.')}: {', '.join(exports())}."


EXPORT_FORM = ExportForm()
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
quiet_option = click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
full_option = click.option("--full", is_flag=True, help="Print every section, not one page.")
seed_option = click.option(
    "--seed", default=0, show_default=True, help="Seed of all randomness: same seed, same result."
)


def numbers(text: str, what: str) -> tuple[int, ...]:
    """ "1-20,25" as row numbers; raises click's usage error."""
    rows: list[int] = []
    for part in filter(None, (p.strip() for p in text.split(","))):
        first, dash, last = part.partition("-")
        try:
            low = int(first)
            rows += range(low, int(last) + 1) if dash else [low]
        except ValueError:
            raise click.BadParameter(
                f"'{part}' is not a row or a range such as 1-20", param_hint=what
            ) from None
    return tuple(rows)


def pairs(texts: tuple[str, ...], what: str) -> dict[str, str]:
    """ "a=b,c=d" options as a dictionary; raises click's usage error."""
    found: dict[str, str] = {}
    for part in (p for text in texts for p in text.split(",") if p.strip()):
        name, sign, value = part.partition("=")
        if not sign:
            raise click.BadParameter(f"'{part}' is not of the form name=value", param_hint=what)
        found[name.strip()] = value.strip()
    return found


def width() -> int:
    """Columns of the terminal; 80 where there is none."""
    return shutil.get_terminal_size((80, 24)).columns if sys.stdout.isatty() else 80


def color() -> bool:
    """Colour only on a terminal, and never when NO_COLOR is set."""
    return sys.stdout.isatty() and "NO_COLOR" not in os.environ


def emit_json(content: Any) -> None:
    """The result as one JSON document on stdout."""
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)
    click.echo(_CONTROLS.sub(lambda found: f"\\u{ord(found[0]):04x}", text))


def note(text: str, quiet: bool) -> None:
    """A line about the work, to stderr."""
    if not quiet:
        say(text, err=True)


def say(text: str, *, err: bool = False) -> None:
    """A line; names out of foreign files cannot steer the terminal."""
    from imucalib.report.render.terminal import safe

    click.echo(safe(text), err=err)


@contextmanager
def progress(total: int, what: str, quiet: bool) -> Iterator[Callable[[], None]]:
    """Advance by one at each call: a bar on a terminal, else a line for every tenth part."""
    if quiet:
        yield lambda: None
    elif sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import Progress, TimeRemainingColumn

        columns = (*Progress.get_default_columns()[:-1], TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True)) as bar:
            task = bar.add_task(what, total=total)
            yield lambda: bar.advance(task)
    else:
        state = {"done": 0, "start": time.monotonic()}

        def advance() -> None:
            state["done"] += 1
            done = int(state["done"])
            if done == total or done * 10 // total > (done - 1) * 10 // total:
                left = (time.monotonic() - state["start"]) / done * (total - done)
                click.echo(f"{done} of {total} {what}, {left:.0f} s left", err=True)

        yield advance
