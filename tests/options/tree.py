"""The options that there are, read from the command tree: none is listed by hand."""

from __future__ import annotations

from collections.abc import Iterator

import click

from imucalib import cli


def commands() -> dict[str, click.Command]:
    """Every command that does something, by its whole name, such as "simulate lab"."""
    return dict(_below(cli.cli, ()))


def _below(command: click.Command, path: tuple[str, ...]) -> Iterator[tuple[str, click.Command]]:
    if not isinstance(command, click.Group):
        yield " ".join(path), command
        return
    context = click.Context(command)
    for name in command.list_commands(context):
        found = command.get_command(context, name)
        assert found is not None
        yield from _below(found, (*path, name))


def options_of(command: click.Command) -> dict[str, click.Option]:
    """Its options by their first long spelling."""
    found = [p for p in command.params if isinstance(p, click.Option)]
    return {next(o for o in p.opts if o.startswith("--")): p for p in found}


def spellings(command: click.Command) -> dict[str, str]:
    """Every spelling of its options, "--no-loop" and "-o" too -> the first."""
    return {
        spelling: name
        for name, option in options_of(command).items()
        for spelling in (*option.opts, *option.secondary_opts)
    }


def every() -> list[tuple[str, str]]:
    """(command, option), in the order of the command line's help."""
    return [(name, option) for name, c in commands().items() for option in options_of(c)]
