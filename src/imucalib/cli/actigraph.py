"""imucal actigraph"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.calibrating import (
    ARGUMENTS,
    calibrating,
    calibrating_of,
    finish,
    limit_option,
    shared_of,
)
from imucalib.cli.options import PagedCommand, fleet_option, mapping_of

if TYPE_CHECKING:
    from imucalib.calibrators.actigraph.request import ActigraphRequest
    from imucalib.calibrators.population import Population


def _one_of(ctx: click.Context, _: click.Parameter, recordings: tuple[Path, ...]) -> Path:
    """The only one, before anything is done. Raises UsageError for several, or a folder, with the
    command of a study."""
    from imucalib.errors import UsageError

    first, *others = recordings
    folder = first.is_dir() and not (first / "metadata.yaml").is_file()
    if not others and not folder:
        return first
    names = {str(path) for path in recordings}
    words = list(ctx.meta.get(ARGUMENTS, ()))[1:]
    options = [word for word in words if word not in names]
    place = "entries"
    for name in ("-o", "--output"):
        if name in options[:-1]:
            at = options.index(name)
            place, options = options[at + 1], options[:at] + options[at + 2 :]
    study = ["imucal", "batch", *map(str, recordings), "-o", place]
    typed = shlex.join([*study, *(["--", *options] if options else [])])
    what = f"{len(recordings)} recordings" if others else "a folder"
    raise UsageError(
        f"it calibrates one recording; given: {what}",
        remedy=f"for a study, each by itself: {typed}",
    )


@click.command("actigraph", cls=PagedCommand, short_help="Calibrate a worn sensor by gravity.")
@click.argument(
    "recording",
    metavar="RECORDING",
    nargs=-1,
    required=True,
    type=click.Path(path_type=Path),
    callback=_one_of,
)
@click.option("--triad", help="Which accelerometer, when the recording has several.")
@click.option("--every", metavar="TIME", help="Calibrate parts too, for example 7d or 12h.")
@click.option("--as-published", is_flag=True, help="The paper's own method, as it was published.")
@click.option(
    "--arithmetic",
    type=click.Choice(["float", "int32", "int16"]),
    default="float",
    show_default=True,
    help="Of the gradient descent, with --as-published.",
)
@fleet_option
@limit_option("--max-worst-error", "largest held-out error, mg.")
@calibrating
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
    from imucalib.report.files import Report

    request, mapping = request_of(options), mapping_of(options)
    if request.as_published:
        from imucalib.calibrators.actigraph.published import calibrate_as_published
        from imucalib.report.actigraph import published_document

        with calibrating_of(options) as say:
            published = calibrate_as_published(recording, mapping, request, say)
        return finish([Report(published, published_document(published))], options)
    from imucalib.calibrators.actigraph.run import calibrate_recording
    from imucalib.report.actigraph import actigraph_document

    with calibrating_of(options) as say:
        run = calibrate_recording(recording, mapping, request, say)
    return finish([Report(run, actigraph_document(run))], options)


def request_of(options: dict[str, Any]) -> ActigraphRequest:
    """The request that the options state; raises click's usage errors."""
    from imucalib.calibrators.actigraph.request import FREE, ActigraphRequest

    shared = shared_of(options)
    curves = ActigraphRequest.curves if shared.curves is None else shared.curves
    return ActigraphRequest(
        gravity=shared.gravity,
        gravity_source=shared.gravity_source,
        triad=options["triad"],
        as_published=options["as_published"],
        arithmetic=options["arithmetic"],
        every=_seconds(options["every"]) if options["every"] else None,
        kind=_kind(options),
        declare=shared.declare,
        only=shared.only,
        without=(*shared.without, *(() if curves else FREE)),
        loop=shared.loop,
        curves=curves,
        extra_effects=shared.extra_effects,
        limits=shared.limits,
        seed=shared.seed,
        command=shared.command,
    )


def _kind(options: dict[str, Any]) -> Population | None:
    from imucalib.calibrators.population import read
    from imucalib.errors import UsageError

    if options["fleet"] is None:
        return None
    for name in ("as_published", "every"):
        if options[name]:
            option = name.replace("_", "-")
            raise UsageError(
                f"--{option} knows no prior", remedy=f"leave out --fleet or --{option}"
            )
    kind = read(options["fleet"])
    if kind.reference != "norm":
        raise UsageError(
            f"the fleet was calibrated with --reference {kind.reference}, a worn sensor by the "
            "size of gravity",
            where=str(options["fleet"]),
            remedy="give a fleet of worn sensors, or of tables with --reference norm",
        )
    return kind


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
