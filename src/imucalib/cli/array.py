"""imucal array: Find the positions of the accelerometers of an inertial sensor array."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.calibrating import calibrating, limit_option, shared_fields
from imucalib.cli.frame.output import Say, freed_memory

if TYPE_CHECKING:
    from imucalib.calibrators.array.motion.total import Distance
    from imucalib.calibrators.array.request import ArrayRequest
    from imucalib.report.files import Report

#: Bytes from which an array goes back to the system when it is freed, and that are kept at the end
#: of all others: what is below 32 MB is kept otherwise, and of many IMUs that was 0.3 GB; with the
#: library's 128 kB every array of a search takes its pages anew.
_LARGE, _KEPT = 1 << 22, 1 << 26


@opt.command_with_page("array")
@click.argument("logs", nargs=-1, required=True, type=opt.PATH)
@opt.option(
    "--board --layout board",
    "Board file (YAML), or a name: mimu4444, mimu4444_corners.",
    required=True,
)
@opt.flag(
    "--as-drawn", "Keep the board file's axes and places even where the log contradicts them."
)
@opt.flag("--as-published", "The paper's own method, as it was published.")
@opt.option(
    "--samples",
    "Moving samples, at most; default: all that say something.",
    type=click.IntRange(min=1),
)
@opt.option("--ess", "Effective sample size to reach.", default=400.0)
@opt.option("--iterations", "Of --as-published.", default=100_000)
@limit_option("--max-gyro-error", "held-out gyro error, deg/s.")
@limit_option("--max-position-sd", "largest posterior sd, mm.")
@opt.path("--save-draws", "Also write the posterior's draws: .h5 or .nc.")
@opt.option(
    "--distance distances",
    "A distance that you measured, which fixes the size: imu0 imu7 26.73±0.05mm (+- works too).",
    nargs=3,
    multiple=True,
    metavar="IMU IMU MM±SD",
)
@opt.option(
    "--accept-mm",
    "By how much what is not explained may move the positions before the exit code is 5.",
    default=0.05,
)
@opt.option(
    "--accept-mg",
    "The same of the accelerometers' residual in motion, beyond their noise at rest.",
    default=50.0,
)
@opt.option("--accept-dps", "The same of the gyros', deg/s.", default=2.0)
@opt.shortest_rest
@opt.seed
@calibrating
def command(logs: tuple[Path, ...], say: Say, **options: Any) -> list[Report]:
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
    from imucalib.calibrators.array.logs import board_run
    from imucalib.readers import read
    from imucalib.report.array import compose_array_document, compose_board_document
    from imucalib.report.files import Report, write_draws

    freed_memory(large=_LARGE, kept=_KEPT)
    request, mapping, runs = _request(options, logs), opt.mapping_of(options), []
    for k, log in enumerate(logs):
        say(f"{log}")
        own = replace(request, agreeing=tuple(one.name for one in logs[:k]))
        runs.append(calibrate_array(read(log, mapping), own, say))
        if (path := options["save_draws"]) is not None:
            path = path if len(logs) == 1 else path.with_stem(f"{path.stem}_{log.stem}")
            write_draws(runs[-1], path)
            say(f"wrote {path}")
    named = zip(runs, logs, strict=True)
    reports = [Report(run, compose_array_document(run), log.stem) for run, log in named]
    if len(runs) > 1:
        board = board_run(tuple(runs))
        reports.append(Report(board, compose_board_document(board)))
    return reports


def _request(options: dict[str, Any], logs: tuple[Path, ...]) -> ArrayRequest:
    from imucalib.calibrators.array.board.board import read_board
    from imucalib.calibrators.array.motion.laws import find_effect
    from imucalib.calibrators.array.request import Accepted, ArrayRequest
    from imucalib.errors import UsageError
    from imucalib.estimators.markov import Stop

    if len({log.stem for log in logs}) < len(logs):
        raise UsageError("two logs have one name, and so would their folders")
    shared, board = shared_fields(options), read_board(options["board"])
    for name in (*options["declare"], *options["only"], *options["without"]):
        find_effect(name.partition("@")[0], board.imus)  # the log may name its IMUs otherwise
    as_stated = "as_published samples iterations as_drawn"
    return ArrayRequest(
        board=board,
        **shared,
        **{name: options[name] for name in as_stated.split()},
        stop=Stop(ess=options["ess"]),
        still=opt.still_of(options),
        accepted=Accepted(options["accept_mm"], options["accept_mg"], options["accept_dps"]),
        distances=tuple(_distance(given, board.imus) for given in options["distances"]),
    )


def _distance(given: tuple[str, str, str], imus: tuple[str, ...]) -> Distance:
    from imucalib.calibrators.array.motion.total import Distance
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
