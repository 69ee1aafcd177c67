"""imucal effects"""

from __future__ import annotations

from pathlib import Path

import click

from imucalib.cli.output import emit_json, json_option, width


@click.command("effects", short_help="List the catalogue of effects.")
@click.argument("name", required=False)
@click.option(
    "--effects",
    "effects_file",
    type=click.Path(path_type=Path),
    help="Python file with effects of your own.",
)
@json_option
def command(name: str | None, effects_file: Path | None, as_json: bool) -> int:
    """List the effects that a calibration can hold and the search can find, or show one.

    \b
    Example: imucal effects inclination_zero
    """
    from imucalib.effects import catalogue, load_file, named
    from imucalib.report.catalogue import catalogue_document, effect_dict
    from imucalib.report.text import render_text

    effects = {**catalogue(), **(load_file(effects_file) if effects_file else {})}
    if name is not None and name not in effects:
        named(name)
    chosen = [effects[name]] if name else list(effects.values())
    if as_json:
        emit_json([effect_dict(effect) for effect in chosen])
    else:
        click.echo(render_text(catalogue_document(chosen), width(), color=False), nl=False)
    return 0
