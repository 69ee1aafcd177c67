"""Every command with its arguments and options, from the command tree."""

from __future__ import annotations

import inspect
from collections import Counter

import click

from generators.markdown import block, table
from imucalib import cli

_HEAD = """# Every command and option

Generated from the commands themselves; `imucal COMMAND --help` shows the same in a terminal. What all of them
share stands in [the command line](../cli.md), exit codes among it.
"""


_COLUMNS = ("option", "value", "default", "meaning")
#: Commands from which on an option that is the same in all stands once, at the end.
_SHARED = 2


def page() -> str:
    """The page."""
    context = click.Context(cli.cli, info_name="imucal")
    commands = {name: cli.cli.get_command(context, name) for name in cli.cli.list_commands(context)}
    known = [c for c in commands.values() if c is not None]
    counts = Counter(_row(o) for c in known for o in _options(c))
    shared = {row for row, count in counts.items() if count >= _SHARED}
    lines = [_HEAD]
    for name, command in commands.items():
        assert command is not None
        lines += _command(command, f"imucal {name}", 2, shared)
    rows = [row for row in dict.fromkeys(counts) if row in shared]
    lines += ["## Options of several commands", "", *table(_COLUMNS, rows)]
    return "\n".join(lines)


def _options(command: click.Command) -> list[click.Option]:
    return [p for p in command.params if isinstance(p, click.Option) and not p.hidden]


def _row(option: click.Option) -> tuple[str, str, str, str]:
    return _names(option), _value(option), _default(option), _meaning(option)


def _command(
    command: click.Command, name: str, level: int, shared: set[tuple[str, str, str, str]]
) -> list[str]:
    lines = [f"{'#' * level} {name}", ""]
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        if paragraph.startswith("\b"):
            lines += block(paragraph.lstrip("\b\n"))
        elif paragraph.strip():
            lines += [paragraph.replace("\f", ""), ""]
    arguments = [p for p in command.params if isinstance(p, click.Argument)]
    context = click.Context(command, info_name=name)
    below = command.list_commands(context) if isinstance(command, click.Group) else []
    words = [(p.metavar or (p.name or "").upper()).removesuffix("...") for p in arguments]
    usage = [
        name,
        "[OPTIONS]",
        *(f"{w}..." if p.nargs < 0 else w for w, p in zip(words, arguments, strict=True)),
    ]
    lines += block(" ".join([*usage, *(["COMMAND"] if below else [])]))
    rows = [_row(p) for p in _options(command)]
    if own := [row for row in rows if row not in shared]:
        lines += table(_COLUMNS, own)
    if others := [row[0] for row in rows if row in shared]:
        lines += [f"As [several](#options-of-several-commands): {', '.join(others)}.", ""]
    for one in below:
        found = command.get_command(context, one) if isinstance(command, click.Group) else None
        assert found is not None
        lines += _command(found, f"{name} {one}", level + 1, shared)
    return lines


def _names(option: click.Option) -> str:
    return ", ".join(f"`{name}`" for name in (*option.opts, *option.secondary_opts))


def _value(option: click.Option) -> str:
    if option.is_flag:
        return ""
    if option.metavar:
        return f"`{option.metavar}`"
    if isinstance(option.type, click.Choice):
        return ", ".join(f"`{choice}`" for choice in option.type.choices)
    names = {"float": "number", "integer": "whole number", "text": "text", "path": "path", "file": "file",
             "directory": "folder"}  # fmt: skip
    kind = option.type.name
    return names.get(kind, names.get(kind.split()[0], "text"))


def _default(option: click.Option) -> str:
    given = option.default
    if isinstance(given, bool):
        return "yes" if given and option.secondary_opts else ""
    return str(given) if isinstance(given, str | int | float) else ""


def _meaning(option: click.Option) -> str:
    text = (option.help or "").replace("\b", "").rstrip()
    more = ["may be repeated"] if option.multiple else []
    more += ["required"] if option.required else []
    return f"{text} ({', '.join(more)})" if more else text
