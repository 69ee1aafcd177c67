"""What all simulations share: effects and faults as options, and the words about what was made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.output import emit_json

if TYPE_CHECKING:
    from imucalib.recording.recording import Recording

plant_option = click.option(
    "--plant", multiple=True, metavar="EFFECT=VALUE,...", help="Effect to plant, in its own units."
)
fault_option = click.option(
    "--fault",
    multiple=True,
    metavar="FAULT",
    help="gap@START:LENGTH, freeze@START:LENGTH (s), sign@SENSOR:AXIS, clip@G, "
    "exchange@SENSOR:SENSOR.",
)


def planted_of(texts: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """ "bias=1,2,3" by name; raises click's usage error."""
    found = {}
    for text in texts:
        name, _, values = text.partition("=")
        try:
            found[name] = tuple(float(v) for v in values.split(","))
        except ValueError:
            raise click.BadParameter(
                f"'{text}' is not EFFECT=VALUE,...", param_hint="--plant"
            ) from None
    return found


def demand_outputs(paths: Sequence[Path], inputs: Sequence[Path] = (), *, force: bool) -> None:
    """Raise UsageError unless a simulation may write to each of the paths, two at the most."""
    from imucalib.atomic_file import demand_output
    from imucalib.errors import UsageError

    if len({path.absolute() for path in paths}) < len(paths):
        raise UsageError("the table and the recording are one file", where=str(paths[0]))
    for path in paths:
        demand_output(path, inputs, force=force)


def write_recording(made: Recording, path: Path, faults: Sequence[str]) -> None:
    """Write a recording as the faults leave it."""
    from imucalib.calibrators.planted import fault_of, with_faults
    from imucalib.writers import write

    write(with_faults(made, [fault_of(text) for text in faults]), path)


def tell(
    written: Sequence[Path],
    plant: Mapping[str, tuple[float, ...]],
    options: Mapping[str, Any],
    **truth: Any,
) -> int:
    """What was written and planted, for people or machines; returns the exit code."""
    faults = list(options.get("fault", ()))
    if options["as_json"]:
        content = {
            "written": [str(p) for p in written],
            "planted": {k: list(v) for k, v in plant.items()},
        }
        emit_json(content | ({"faults": faults} if faults else {}) | truth)
    elif not options["quiet"]:
        click.echo("\n".join(f"wrote {path}" for path in written))
    return 0
