"""imucal actigraph: Calibrate a worn sensor from days of recording, by gravity at rest."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.calibrating import ARGUMENTS, calibrating, limit_option, shared_fields
from imucalib.cli.frame.output import Say
from imucalib.question import paste

if TYPE_CHECKING:
    from imucalib.report.files import Report


def _demand_one(ctx: click.Context, _: click.Parameter, recordings: tuple[Path, ...]) -> Path:
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
    typed = paste(*study, *(["--", *options] if options else []))
    what = f"{len(recordings)} recordings" if others else "a folder"
    raise UsageError(
        f"it calibrates one recording; given: {what}",
        remedy=f"for a study, each by itself: {typed}",
    )


@opt.command_with_page("actigraph")
@click.argument(
    "recording", metavar="RECORDING", nargs=-1, required=True, type=opt.PATH, callback=_demand_one
)
@opt.option("--every", "Calibrate parts too, for example 7d or 12h.", metavar="TIME")
@opt.flag("--as-published", "The paper's own method, as it was published.")
@opt.choice(
    "--arithmetic",
    "float int32 int16",
    "Of the gradient descent, with --as-published.",
    default="float",
)
@opt.fleet
@limit_option("--max-worst-error", "largest held-out error, mg.")
@calibrating
def command(recording: Path, say: Say, **options: Any) -> list[Report]:
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
    from imucalib.calibrators.actigraph.published import calibrate_as_published
    from imucalib.calibrators.actigraph.request import ActigraphRequest
    from imucalib.calibrators.actigraph.run import calibrate_recording
    from imucalib.report.actigraph import compose_actigraph_document, compose_published_document
    from imucalib.report.files import Report

    request = ActigraphRequest(
        **shared_fields(options),
        **{name: options[name] for name in ("as_published", "arithmetic")},
        every=_seconds(options["every"]) if options["every"] else None,
        kind=opt.population_of(options, "norm", as_published=False, every=None),
    )
    if not request.curves:
        request = replace(request, without=(*request.without, "posture"))
    mapping = opt.mapping_of(options)
    if request.as_published:
        published = calibrate_as_published(recording, mapping, request, say)
        return [Report(published, compose_published_document(published))]
    run = calibrate_recording(recording, mapping, request, say)
    return [Report(run, compose_actigraph_document(run))]


def _seconds(text: str) -> float:
    """ "7d", "12h" or "30min" in seconds; raises click's usage error."""
    found = re.fullmatch(r"(\d+\.?\d*|\.\d+)(min|h|d)", text)
    if found is None or not float(found[1]):
        raise click.BadParameter(f"'{text}' is not a time such as 7d or 12h", param_hint="--every")
    return float(found[1]) * {"min": 60.0, "h": 3600.0, "d": 86400.0}[found[2]]
