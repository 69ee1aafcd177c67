"""imucal array"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.calibrating import (
    Together,
    calibrating,
    calibrating_of,
    finish,
    limit_option,
    shared_of,
)
from imucalib.cli.options import (
    PagedCommand,
    mapping_of,
    seed_option,
    shortest_rest_option,
    still_of,
)
from imucalib.cli.output import freed_memory, note

if TYPE_CHECKING:
    from imucalib.calibrators.array.estimate.total import Distance
    from imucalib.calibrators.array.request import ArrayRequest
    from imucalib.calibrators.array.run import ArrayRun

#: Bytes from which an array goes back to the system when it is freed, and that are kept at the end
#: of all others: what is below 32 MB is kept otherwise, and of many IMUs that was 0.3 GB; with the
#: library's 128 kB every array of a search takes its pages anew.
_LARGE, _KEPT = 1 << 22, 1 << 26


@click.command(
    "array", cls=PagedCommand, short_help="Find the positions of an array's accelerometers."
)
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--board",
    "--layout",
    "board",
    required=True,
    help="Board file (YAML), or a name: mimu4444, mimu4444_corners.",
)
@click.option(
    "--as-drawn",
    is_flag=True,
    help="Keep the board file's axes and places even where the log contradicts them.",
)
@click.option(
    "--sampler",
    type=click.Choice(["hmc", "pmmh"]),
    default="hmc",
    show_default=True,
    help="pmmh: Algorithm 1 of the paper.",
)
@click.option(
    "--samples",
    type=click.IntRange(min=1),
    help="Moving samples, at most; default: all that say something.",
)
@click.option(
    "--motion-prior",
    type=click.Choice(["learned", "flat"]),
    default="learned",
    show_default=True,
    help="Of ω̇; flat is the paper's.",
)
@click.option(
    "--det-exponent",
    type=click.Choice(["0.5", "1"]),
    default="0.5",
    show_default=True,
    help="1: equation (25) as printed, with --motion-prior flat.",
)
@click.option(
    "--acc-sigma",
    default="estimate",
    show_default=True,
    help="In motion: estimate, nonlinearity, or m/s².",
)
@click.option(
    "--gyro-covariance",
    type=click.Choice(["scatter", "sample"]),
    default="scatter",
    show_default=True,
    help="sample: equation (30) of the paper.",
)
@click.option("--chains", type=int, help="Number of chains.")
@click.option("--ess", default=400.0, show_default=True, help="Effective sample size to reach.")
@click.option("--iterations", default=100_000, show_default=True, help="Of --sampler pmmh.")
@limit_option("--max-gyro-error", "held-out gyro error, deg/s.")
@limit_option("--max-position-sd", "largest posterior sd, mm.")
@click.option(
    "--save-draws",
    type=click.Path(path_type=Path),
    help="Also write the posterior's draws: .h5 or .nc.",
)
@click.option(
    "--checkpoint",
    type=click.Path(path_type=Path),
    help="Keep the chains here after every block, and go on from there.",
)
@click.option(
    "--distance",
    "distances",
    nargs=3,
    multiple=True,
    metavar="IMU IMU MM±SD",
    help="A distance that you measured, which fixes the size: imu0 imu7 26.73±0.05mm "
    "(+- works too).",
)
@click.option(
    "--accept-mm",
    type=float,
    default=0.05,
    show_default=True,
    help="By how much what is not explained may move the positions before the exit code is 5.",
)
@click.option(
    "--accept-mg",
    type=float,
    default=50.0,
    show_default=True,
    help="The same of the accelerometers' residual in motion, beyond their noise at rest.",
)
@click.option(
    "--accept-dps",
    type=float,
    default=2.0,
    show_default=True,
    help="The same of the gyros', deg/s.",
)
@shortest_rest_option
@seed_option
@calibrating
def command(logs: tuple[Path, ...], **options: Any) -> int:
    """Find the positions of an inertial array's accelerometers from a bench log.

    LOGS hold rests in nine or more attitudes and a part in which the board is twisted by hand. With
    several logs of one board each is calibrated by itself in a folder of its own, and all of them
    together: whether they agree, what repeats, and one calibration. Writes calibration.yaml,
    report.html and report.json into the folder given by -o.

    \b
    Examples:
      imucal array log.mcap --board board.yaml -o out
      imucal array exp_1.h5 exp_5.h5 --board mimu4444_corners -o out
      imucal array log.mcap --board board.yaml --declare gyro_delay -o out
    """
    from imucalib.calibrators.array.calibrate import calibrate_array
    from imucalib.readers import read
    from imucalib.report.array import array_document
    from imucalib.report.files import Report, write_draws

    freed_memory(large=_LARGE, kept=_KEPT)
    request = _request(options, logs)
    mapping, quiet = mapping_of(options), options["quiet"]
    runs: list[ArrayRun] = []
    for k, log in enumerate(logs):
        note(f"{log}", quiet)
        own = replace(request, agreeing=tuple(one.name for one in logs[:k]))
        with calibrating_of(options) as say:
            runs.append(calibrate_array(read(log, mapping), own, say))
        if options["save_draws"] is not None:
            target = options["save_draws"]
            path = target if len(logs) == 1 else target.with_stem(f"{target.stem}_{log.stem}")
            write_draws(runs[-1], path)
            note(f"wrote {path}", quiet)
    reports = [Report(run, array_document(run)) for run in runs]
    return finish(reports, options, _together(tuple(runs)) if len(runs) > 1 else None)


def _request(options: dict[str, Any], logs: tuple[Path, ...]) -> ArrayRequest:
    from imucalib.calibrators.array.board import read_board
    from imucalib.calibrators.array.loop.catalogue import Scope, named_effect
    from imucalib.calibrators.array.request import Accepted, ArrayRequest
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
    if len(logs) > 1 and options["checkpoint"]:
        raise UsageError("--checkpoint goes with one log")
    if len({log.stem for log in logs}) < len(logs):
        raise UsageError("two logs have one name, and so would their folders")
    shared = shared_of(options)
    board = read_board(options["board"])
    scope = Scope(shared.declare, shared.only, shared.without)
    for name in (*scope.declare, *scope.only, *scope.without):
        named_effect(name.partition("@")[0], board.imus)  # the log may name its IMUs otherwise
    return ArrayRequest(
        board,
        shared.gravity,
        shared.gravity_source,
        options["sampler"],
        options["samples"],
        motion=options["motion_prior"],
        exponent=float(options["det_exponent"]),
        accelerometer_sigma=sigma,
        gyro_covariance=options["gyro_covariance"],
        chains=options["chains"],
        stop=Stop(ess=options["ess"]),
        iterations=options["iterations"],
        still=still_of(options),
        loop=shared.loop,
        scope=scope,
        curves=ArrayRequest.curves if shared.curves is None else shared.curves,
        as_drawn=options["as_drawn"],
        accepted=Accepted(options["accept_mm"], options["accept_mg"], options["accept_dps"]),
        distances=tuple(_distance(given, board.imus) for given in options["distances"]),
        checkpoint=options["checkpoint"],
        seed=shared.seed,
        extra_effects=shared.extra_effects,
        limits=shared.limits,
        command=shared.command,
    )


def _distance(given: tuple[str, str, str], imus: tuple[str, ...]) -> Distance:
    from imucalib.calibrators.array.estimate.total import Distance
    from imucalib.errors import UsageError

    one, two, text = given
    missing = [name for name in (one, two) if name not in imus]
    if missing or one == two:
        what = f"no IMU '{missing[0]}'" if missing else "a distance is between two IMUs"
        raise UsageError(f"--distance: {what}", remedy=f"IMUs: {', '.join(imus)}")
    value, _, sd = text.removesuffix("mm").replace("+/-", "±").replace("+-", "±").partition("±")
    try:
        found = 1e-3 * float(value), 1e-3 * float(sd)
    except ValueError:
        found = -1.0, -1.0
    if not (0.0 < found[1] < found[0] < 100.0):
        raise UsageError(
            f"--distance: '{text}' is no distance with its standard deviation",
            remedy="in mm, like 26.73±0.05mm or 26.73+-0.05",
        )
    return Distance(imus.index(one), imus.index(two), *found)


def _together(runs: tuple[ArrayRun, ...]) -> Together:
    from imucalib.calibrators.array.logs import board_run
    from imucalib.report.array import board_document
    from imucalib.report.files import Report

    found = board_run(runs)
    return Together("together", Report(found, board_document(found)))
