"""The command as it is typed, without a process of its own."""

from __future__ import annotations

import click
from click.testing import CliRunner, Result

from imucalib import cli
from imucalib.errors import ImucalError


def run(*arguments: object) -> Result:
    """`imucal` with these words; its exit code is the result's `return_value`, for errors too."""
    result = CliRunner().invoke(cli.cli, [str(a) for a in arguments], standalone_mode=False)
    if isinstance(result.exception, ImucalError | click.ClickException):
        result.return_value = result.exception.exit_code
    return result
