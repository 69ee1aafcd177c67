"""A command's failure, for people and for machines."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import Annotated

import click

from imucalib.data import Data
from imucalib.errors import ImucalError, UnreadableInput


class Failure(Data):
    """Why a command ended."""

    message: str
    where: Annotated[str, "File, row, byte or option; empty where there is none."]
    remedy: Annotated[str, "What to do."]
    exit_code: int


class Failed(Data, name="error/1"):
    """What a command prints in place of a result."""

    error: Failure


def failure_of(error: Exception) -> Failure:
    """A failure for machines."""
    if isinstance(error, ImucalError):
        said = error.what, error.where, error.remedy, error.exit_code
    elif isinstance(error, click.ClickException):
        example = example_of(error)
        remedy = f"for example: {example}" if example else ""
        said = error.format_message(), "", remedy, error.exit_code
    else:
        name = str(getattr(error, "filename", None) or "")
        said = str(getattr(error, "strerror", error)), name, "", UnreadableInput.exit_code
    return Failure(*said)


def example_of(error: click.ClickException) -> str:
    """A call of the command that was misused, as its help shows it; or how the value is written."""
    ctx = getattr(error, "ctx", None)
    if ctx is None or ctx.parent is None:
        return ""
    number = re.search(r"'(-?\d+),(\d+)' is not a valid float", error.format_message())
    if number:
        return f"{number[1]}.{number[2]}, with a point"
    if number := re.search(
        r"'(-?[\d.]+) ?[^\d'.]+\d*' is not a valid float", error.format_message()
    ):
        return f"{number[1]}, without the unit"
    if isinstance(error, click.NoSuchOption) and re.fullmatch(r"-\d", error.option_name):
        pairs = pairwise(ctx.find_root().meta["imucal.arguments"])
        value = next(two for two in pairs if two[1].startswith(error.option_name))
        return f"--fix {value[0]}={value[1]}" if ":" in value[0] else f"-- {value[1]}"
    lines = (ctx.command.help or "").splitlines()
    typed = (line.strip().removeprefix("Example: ") for line in lines)
    return next((line for line in typed if line.startswith("imucal ")), "")
