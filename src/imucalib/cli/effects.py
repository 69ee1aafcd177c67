"""imucal effects: List the catalogue of effects."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.output import emit_json, width

if TYPE_CHECKING:
    from imucalib.core.effect import Effect


@opt.command_with_page("effects")
@click.argument("name", required=False)
@opt.own_effects
@opt.json
def command(name: str | None, effects_file: Path | None, as_json: bool) -> int:
    """List the effects that a calibration can hold and the search can find, or show one.

    \b
    Examples:
      imucal effects inclination_zero
      imucal effects gyro_delay
    """
    from imucalib.effects import catalogue, families, load_file
    from imucalib.report.catalogue import compose_catalogue_document, describe_effect
    from imucalib.report.render.text import render_text

    own = load_file(effects_file) if effects_file else {}
    effects: dict[str, Effect] = {**catalogue(), **own}
    if name is not None and name not in effects:
        effects[name] = _scan_at(name, list(effects))
    chosen = [effects[name]] if name else list(effects.values())
    if as_json:
        emit_json([describe_effect(effect) for effect in chosen])
    else:
        document = compose_catalogue_document(chosen, list(families().values()))
        click.echo(render_text(document, width(), color=False, full=True), nl=False)
    return 0


def _scan_at(name: str, names: list[str]) -> Effect:
    """One value of a scan, such as bias_step@86400s; raises UsageError with the nearest names."""
    import difflib

    from imucalib.effects import families, known
    from imucalib.errors import UsageError

    found = known(name)
    if found is None:
        scans = families()
        if name in scans:
            example = f"{name}@{scans[name].example}"
            raise UsageError(f"'{name}' needs its value", remedy=f"for example: {example}")
        similar = ", ".join(difflib.get_close_matches(name, names, 3))
        remedy = f"did you mean: {similar}" if similar else "`imucal effects` lists them all"
        raise UsageError(f"no effect is called '{name}'", remedy=remedy)
    return found
