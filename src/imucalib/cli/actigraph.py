"""imucal actigraph"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.gravity_options import gravity_of, gravity_options, limits_of
from imucalib.cli.output import (
    color,
    emit_json,
    json_option,
    note,
    quiet_option,
    seed_option,
    width,
)
from imucalib.cli.recording_options import mapping_of, recording_options

if TYPE_CHECKING:
    from imucalib.calibrators.actigraph.request import ActigraphRequest
    from imucalib.recording.mapping import FieldMapping

_LIMITS = ("max-error", "max-worst-error")


@click.command("actigraph", short_help="Calibrate a worn sensor by gravity.")
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path, file_okay=False),
              help="Folder for calibration.yaml, report.html and report.json.")  # fmt: skip
@click.option("--triad", help="Which accelerometer, when the recording has several.")
@gravity_options
@click.option("--declare", multiple=True, metavar="EFFECT", help="Put an effect into the model.")
@click.option("--only", multiple=True, metavar="EFFECT", help="Search only these effects.")
@click.option("--without", multiple=True, metavar="EFFECT", help="Leave effects out of the search.")
@click.option("--effects", "effects_file", type=click.Path(path_type=Path),
              help="Python file with effects of your own.")  # fmt: skip
@click.option("--no-loop", is_flag=True, help="Fit the nine parameters only.")
@click.option("--draws", default=200, show_default=True,
              help="Simulated data sets behind each p-value.")  # fmt: skip
@click.option("--every", metavar="TIME", help="Calibrate parts too, for example 7d or 12h.")
@click.option("--export", multiple=True, type=click.Choice(["ggir-csv", "c-header"]),
              help="Write the coefficients for GGIR or for firmware, too.")  # fmt: skip
@click.option("--as-published", is_flag=True,
              help="Paper 002's own rule of rest, 18 points and gradient descent.")  # fmt: skip
@click.option("--arithmetic", type=click.Choice(["float", "int32", "int16"]), default="float",
              show_default=True, help="Of the gradient descent, with --as-published.")  # fmt: skip
@click.option("--max-error", type=float, help="Limit: mean held-out error, mg; exit 1 beyond.")
@click.option("--max-worst-error", type=float, help="Limit: largest held-out error, mg.")
@recording_options
@seed_option
@json_option
@quiet_option
def command(recording: Path, **options: Any) -> int:
    """Calibrate a worn accelerometer from days of recording: gravity in every posture at rest.

    RECORDING is a CSV, HDF5 or MCAP file of raw acceleration. Finds the moments at rest, fits
    nine parameters with their uncertainty, searches for what they lack, and measures the error on
    time that was not fitted. Writes calibration.yaml, report.html and report.json into the folder
    given by -o, and prints the report.

    \b
    Examples:
      imucal actigraph week.csv -o out
      imucal actigraph week.h5 -o out --latitude 46.3 --max-error 5
    """
    quiet = options["quiet"]
    request, mapping = request_of(options), mapping_of(options)
    if options["export"] and options["output"] is None:
        raise click.UsageError("--export needs a folder: -o")
    if request.as_published:
        return _as_published(recording, mapping, request, options)
    from imucalib.calibrators.actigraph.run import calibrate_recording

    run = calibrate_recording(recording, mapping, request, lambda text: note(text, quiet))
    if options["output"] is not None:
        from imucalib.calibrators.actigraph.calibration import actigraph_calibration
        from imucalib.exports import write_exports
        from imucalib.report.actigraph.files import write_reports

        paths = write_reports(run, options["output"])
        calibration = actigraph_calibration(run)
        paths += write_exports(calibration, recording, options["export"], options["output"])
        for path in paths:
            note(f"wrote {path}", quiet)
    if options["as_json"]:
        from imucalib.report.actigraph.data import actigraph_dict

        emit_json(actigraph_dict(run))
    elif not quiet:
        from imucalib.report.actigraph.document import actigraph_document
        from imucalib.report.render.text import render_text

        click.echo(render_text(actigraph_document(run), width(), color=color()), nl=False)
    return run.outcome.exit_code


def _as_published(
    recording: Path, mapping: FieldMapping, request: ActigraphRequest, options: dict[str, Any]
) -> int:
    """The paper's own procedure, with the same files."""
    from imucalib.calibrators.actigraph.published import (
        calibrate_as_published,
        published_calibration,
    )
    from imucalib.exports import write_exports
    from imucalib.report.actigraph.published import (
        published_dict,
        published_document,
        write_published,
    )
    from imucalib.report.render.text import render_text

    quiet = options["quiet"]
    run = calibrate_as_published(recording, mapping, request, lambda text: note(text, quiet))
    if options["output"] is not None:
        paths = write_published(run, options["output"])
        calibration = published_calibration(run)
        paths += write_exports(calibration, recording, options["export"], options["output"])
        for path in paths:
            note(f"wrote {path}", quiet)
    if options["as_json"]:
        emit_json(published_dict(run))
    elif not quiet:
        click.echo(render_text(published_document(run), width(), color=color()), nl=False)
    return run.outcome.exit_code


def request_of(options: dict[str, Any]) -> ActigraphRequest:
    """The request that the options state; raises click's usage errors."""
    from imucalib.calibrators.actigraph.request import ActigraphRequest
    from imucalib.effects import load_file
    from imucalib.loop.found import LoopSettings

    gravity, source = gravity_of(options)
    return ActigraphRequest(
        gravity=gravity,
        gravity_source=source,
        triad=options["triad"],
        as_published=options["as_published"],
        arithmetic=options["arithmetic"],
        every=_seconds(options["every"]) if options["every"] else None,
        declare=options["declare"],
        only=options["only"],
        without=options["without"],
        loop=not options["no_loop"],
        rules=LoopSettings(draws=options["draws"]),
        extra_effects=load_file(options["effects_file"]) if options["effects_file"] else {},
        limits=limits_of(options, _LIMITS),
        seed=options["seed"],
    )


def _seconds(text: str) -> float:
    """ "7d", "12h" or "30min" in seconds; raises click's usage error."""
    for unit, seconds in (("min", 60.0), ("d", 86400.0), ("h", 3600.0)):
        number = text.removesuffix(unit)
        if number != text:
            try:
                value = float(number) * seconds
            except ValueError:
                break
            if value > 0.0:
                return value
    raise click.BadParameter(f"'{text}' is not a time such as 7d or 12h", param_hint="--every")
