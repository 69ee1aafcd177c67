"""imucal.toml: options that a bench or a study always gives, as defaults of the commands.

A section a command, options by their long names. What is typed on the command line wins.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from imucalib.cli.frame.options import no_limit, retype

NAME = "imucal.toml"
#: Never read from a file that lies about: code to run, and where to write.
_TYPED_ONLY = ("effects_file", "output", "force")


def sections(folder: Path) -> dict[str, Any]:
    """The file of a folder, by command; empty where there is none. Raises click's usage error."""
    path = folder / NAME
    if not path.is_file():
        return {}
    import tomllib

    try:
        found = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise click.UsageError(f"{path}: {error}") from None
    loose = [name for name, value in found.items() if not isinstance(value, dict)]
    if loose:
        raise click.UsageError(f"{path}: '{loose[0]}' stands in no section such as [lab]")
    return found


def defaults(command: click.Command, stated: Mapping[str, Any]) -> dict[str, Any]:
    """A command's section by the names of its parameters. Raises click's usage error for an option
    that it lacks, or that must be typed."""
    names = {
        option.removeprefix("--"): parameter.name
        for parameter in command.params
        for option in parameter.opts
        if option.startswith("--") and parameter.name
    }
    found = {}
    for key, value in stated.items():
        name = names.get(key.replace("_", "-"))
        if name is None or name in _TYPED_ONLY:
            why = "must be typed" if name else f"is no option of imucal {command.name}"
            if key.startswith("max"):
                why = f"is no limit: {no_limit(command, '--' + key.replace('_', '-'))}"
            raise click.UsageError(f"{NAME}, [{command.name}]: '{key}' {why}")
        found[name] = value
    return found


def from_file() -> list[str]:
    """The options that came from the file, as they would be typed."""
    return retype(lambda _, source: source is ParameterSource.DEFAULT_MAP)
