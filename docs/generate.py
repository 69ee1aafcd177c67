"""Write the pages that come from the code, or with --check say which are stale."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from imucalib.cli import COMMANDS, cli
from imucalib.effects import catalogue
from imucalib.report.catalogue import catalogue_markdown

HERE = Path(__file__).parent


def commands_markdown() -> str:
    """docs/commands.md: the help of every command."""
    parts = ["# Commands", "", "Generated from the code by `make docs`.", ""]
    context = click.Context(cli, info_name="imucal", max_content_width=88, terminal_width=88)
    parts += ["```text", cli.get_help(context).rstrip(), "```", ""]
    for name in COMMANDS:
        command = cli.get_command(context, name)
        assert command is not None
        inner = click.Context(
            command, parent=context, info_name=name, max_content_width=88, terminal_width=88
        )
        parts += [f"## imucal {name}", "", "```text", command.get_help(inner).rstrip(), "```", ""]
    return "\n".join(parts)


PAGES = {
    "effects.md": lambda: catalogue_markdown(list(catalogue().values())),
    "commands.md": commands_markdown,
}


def main() -> int:
    """Write or compare; the exit code says whether anything is stale."""
    stale = []
    for name, make in PAGES.items():
        text = make().rstrip() + "\n"
        page = HERE / name
        if "--check" in sys.argv:
            if not page.is_file() or page.read_text(encoding="utf-8") != text:
                stale.append(name)
        else:
            page.write_text(text, encoding="utf-8")
    if stale:
        print(f"stale: {', '.join(stale)}; run make docs", file=sys.stderr)
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
