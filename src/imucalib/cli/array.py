"""imucal array"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.gravity_options import gravity_of, gravity_options
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
    from imucalib.calibrators.array.request import ArrayRequest


@click.command("array", short_help="Find the positions of an array's accelerometers.")
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Folder for the results.")
@click.option("--board", "--layout", "board", required=True, help="Board file (YAML), or a name: "
              "mimu4444, mimu4444_corners.")  # fmt: skip
@gravity_options
@click.option("--sampler", type=click.Choice(["hmc", "pmmh"]), default="hmc", show_default=True,
              help="pmmh: Algorithm 1 of the paper.")  # fmt: skip
@click.option("--samples", default=2000, show_default=True, help="Moving samples, at most.")
@click.option("--motion-prior", type=click.Choice(["learned", "flat"]), default="learned",
              show_default=True, help="Of ω̇; flat is the paper's.")  # fmt: skip
@click.option("--det-exponent", type=click.Choice(["0.5", "1"]), default="0.5", show_default=True,
              help="1: equation (25) as printed, with --motion-prior flat.")  # fmt: skip
@click.option("--acc-sigma", default="estimate", show_default=True,
              help="In motion: estimate, nonlinearity, or m/s².")  # fmt: skip
@click.option("--gyro-covariance", type=click.Choice(["scatter", "sample"]), default="scatter",
              show_default=True, help="sample: equation (30) of the paper.")  # fmt: skip
@click.option("--chains", type=int, help="Number of chains.")
@click.option("--ess", default=400.0, show_default=True, help="Effective sample size to reach.")
@click.option("--iterations", default=100_000, show_default=True, help="Of --sampler pmmh.")
@click.option("--loop/--no-loop", default=True, show_default=True,
              help="Search for what the model lacks.")  # fmt: skip
@click.option("--declare", multiple=True, metavar="EFFECT", help="Put an effect into the base "
              "model, for example gyro_delay; of one IMU: gyro_scale@imu3.")  # fmt: skip
@click.option("--only", multiple=True, metavar="EFFECT", help="Search only these effects.")
@click.option("--without", multiple=True, metavar="EFFECT",
              help="Leave effects out of the search.")  # fmt: skip
@click.option(
    "--curves",
    is_flag=True,
    help="Correct structure without a name by a smooth curve, where that holds out.",
)
@click.option("--draws", type=click.Path(path_type=Path), help="Also write the draws: .h5 or .nc.")
@click.option("--checkpoint", type=click.Path(path_type=Path),
              help="Keep the chains here after every block, and go on from there.")  # fmt: skip
@recording_options
@seed_option
@json_option
@quiet_option
def command(logs: tuple[Path, ...], **options: Any) -> int:
    """Find the positions of an inertial array's accelerometers from a bench log.

    LOGS hold rests in nine or more attitudes and a part in which the board is twisted by hand. With
    several logs each is calibrated by itself, and their agreement is reported. Writes
    calibration.yaml, report.html and report.json into the folder given by -o.

    \b
    Examples:
      imucal array log.mcap --board board.yaml -o out
      imucal array exp_1.h5 exp_5.h5 --board mimu4444_corners --gravity 9.8189 -o out
      imucal array log.mcap --board board.yaml --declare gyro_delay --without gyro_cubic -o out
    """
    from imucalib.calibrators.array.calibrate import ArrayRun, calibrate_array
    from imucalib.readers import read
    from imucalib.report.array.files import array_dict, repeatability_dict

    request = _request(options, len(logs))
    mapping, quiet = mapping_of(options), options["quiet"]
    runs: list[ArrayRun] = []
    for log in logs:
        note(f"{log}", quiet)
        runs.append(
            calibrate_array(read(log, mapping), request, lambda text: note(f"  {text}", quiet))
        )
    _write(runs, logs, options)
    if options["as_json"]:
        content: dict[str, Any] = array_dict(runs[0])
        if len(runs) > 1:
            from imucalib.calibrators.array.logs import repeatability

            content = {"logs": [array_dict(run) for run in runs]}
            content["repeatability"] = repeatability_dict(repeatability(tuple(runs)))
        emit_json(content)
    elif not quiet:
        _show(runs)
    return max(run.exit_code for run in runs)


def _request(options: dict[str, Any], logs: int) -> ArrayRequest:
    from imucalib.calibrators.array.board import read_board
    from imucalib.calibrators.array.loop.asked import Asked, named_effect
    from imucalib.calibrators.array.request import ArrayRequest
    from imucalib.errors import UsageError
    from imucalib.estimators.markov.hmc import Stop

    sigma: Any = options["acc_sigma"]
    if sigma not in ("estimate", "nonlinearity"):
        try:
            sigma = float(sigma)
        except ValueError:
            sigma = -1.0
        if not 0.0 < sigma < 1e3:
            raise UsageError("--acc-sigma is estimate, nonlinearity or a positive number of m/s²")
    if logs > 1 and options["checkpoint"]:
        raise UsageError("--checkpoint goes with one log")
    gravity, source = gravity_of(options)
    board = read_board(options["board"])
    asked = Asked(options["declare"], options["only"], options["without"])
    for name in (*asked.declare, *asked.only, *asked.without):
        named_effect(name.partition("@")[0], board.imus)  # the log may name its IMUs otherwise
    return ArrayRequest(
        board, gravity, source, options["sampler"], options["samples"],
        motion=options["motion_prior"], exponent=float(options["det_exponent"]),
        accelerometer_sigma=sigma, gyro_covariance=options["gyro_covariance"],
        chains=options["chains"], stop=Stop(ess=options["ess"]), iterations=options["iterations"],
        loop=options["loop"], asked=asked, curves=options["curves"],
        checkpoint=options["checkpoint"], seed=options["seed"],
    )  # fmt: skip


def _write(runs: list[Any], logs: tuple[Path, ...], options: dict[str, Any]) -> None:
    from imucalib.report.array.files import write_array_reports, write_draws

    for run, log in zip(runs, logs, strict=True):
        if options["output"] is not None:
            folder = options["output"] if len(runs) == 1 else options["output"] / log.stem
            for path in write_array_reports(run, folder):
                note(f"wrote {path}", options["quiet"])
        if options["draws"] is not None:
            target = options["draws"]
            path = target if len(runs) == 1 else target.with_stem(f"{target.stem}_{log.stem}")
            write_draws(run, path)
            note(f"wrote {path}", options["quiet"])


def _show(runs: list[Any]) -> None:
    from imucalib.calibrators.array.logs import repeatability
    from imucalib.report.array.document import array_document, repeatability_section
    from imucalib.report.document import Document, Text
    from imucalib.report.render.text import render_text

    for run in runs:
        click.echo(render_text(array_document(run), width(), color=color()), nl=False)
    if len(runs) > 1:
        section = repeatability_section(repeatability(tuple(runs)), tuple(runs))
        document = Document(
            "All logs", Text("Each log was calibrated by itself.", "plain"), (section,)
        )
        click.echo(render_text(document, width(), color=color()), nl=False)
