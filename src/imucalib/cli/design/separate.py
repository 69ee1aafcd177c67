"""`imucal design --separate`: what to record next so that an ambiguity ends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imucalib.cli.output import color, emit_json, note, width
from imucalib.cli.working import working


def plan_for(path: Path, options: dict[str, Any]) -> int:
    """Print the plan of a calibration, and write its table where asked; the exit code."""
    from imucalib.atomic_file import demand_output
    from imucalib.calibration.checking.limits import size_of
    from imucalib.calibrators.next_recording import Wish, next_recording
    from imucalib.report.design import separation_dict, separation_document
    from imucalib.report.render.text import render_text

    if options["output"] is not None:
        demand_output(options["output"], [path], force=options["force"])
    size = options["between_sessions"]
    between = 0.0 if size is None else size_of(size, {"mg": "bias"})[0]
    with working("planning", quiet=options["quiet"]):
        found = next_recording(path, Wish(_temperatures(options["temperatures"]), between))
    if options["output"] is not None and found.table:
        write_table(found.table, options["output"], [path], options)
    if options["as_json"]:
        emit_json(separation_dict(found))
    elif not options["quiet"]:
        document = separation_document(found, path.name)
        click.echo(render_text(document, width(), color=color(), full=options["full"]), nl=False)
    return found.exit_code


def _temperatures(text: str | None) -> tuple[float, ...]:
    if text is None:
        return ()
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != 2 or not -100.0 < found[0] < found[1] < 200.0:
        raise click.BadParameter(
            f"'{text}' is not of the form LOW,HIGH in degC", param_hint="--temperatures"
        )
    return found


def write_table(text: str, path: Path, read: list[Path], options: dict[str, Any]) -> None:
    """A table as text, whole or not at all, over another's file only with --force."""
    from imucalib.atomic_file import demand_output, replaced_atomically

    demand_output(path, read, force=options["force"])
    with replaced_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    note(f"wrote {path}", options["quiet"])
