"""The reports of `imucal array`, as data: of one log, and of several logs of one board."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.board.board import Board
from imucalib.calibrators.array.board.turns import GyroScale
from imucalib.calibrators.array.logs import BoardRun
from imucalib.calibrators.array.motion.posterior import along, rank_directions, size_over
from imucalib.calibrators.array.motion.total import Total
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.run import ArrayRun
from imucalib.core.eigen import eigen
from imucalib.report import sections
from imucalib.report.array_figures import board_picture, board_plots, residual_plots
from imucalib.report.render.document import Card, Document, Facts, Section, Table, Text, Use, Worth
from imucalib.significant_digits import format_with_sd, plus_minus
from imucalib.units import DEG

#: Of the best shown direction, or the liveliest axis, from which another is worth a word.
_UNEVEN = 0.3
_FUSE = Use(
    "Correct and fuse the recording into one IMU",
    ("apply", "{calibration}", "{input}", "--fused", "-o", "{folder}/fused{suffix}"),
)


def compose_array_document(run: ArrayRun) -> Document:
    """Everything that a reader of the positions must know, the verdict first."""
    observability = _observability(run)
    off = 1e3 * (run.total.mean - run.board.drawn)
    note = f"mm, relative to {run.board.imus[0]}, in the board's axes; sd with size and frame."
    more = tuple(", ".join(f"{v:+.2f}" for v in one) for one in off)
    positions = ("Positions of the accelerometers", run.board, run.total, "minus drawing", more)
    known = _known(run.total, run.gyros, run.board, run.request)
    chains = (
        (
            "sampler",
            f"{run.drawn.sampler}, {run.drawn.free.shape[0]} chains of "
            f"{run.drawn.free.shape[1]} draws, acceptance {100 * run.drawn.accepted:.0f} %",
        ),
        ("agreement", run.drawn.convergence.sentence),
    )
    first = (
        Section("Positions", (_position_table(*positions, note), known)),
        Section("The board", board_plots(run)),
    )
    rest = (
        _compose_motion_section(run),
        _compose_rests_section(run),
        Section("Observability", observability),
        Section("The chains", (Facts(chains),)),
    )
    title = f"Positions of {run.board.name} from {run.outcome.provenance.input}"
    card, plots = _compose_card(run, observability), residual_plots(run)
    return sections.compose_calibration_document(
        title, run, card, first=first, residuals=plots, rest=rest
    )


def _compose_card(run: ArrayRun, observability: tuple[Text, ...]) -> Card:
    """Worth of positions, gyros and accelerometers in motion.

    observability : what the motion did not determine, in words
    """
    sd, total = 1e3 * run.total.sd[1:], run.total
    k, axis = np.unravel_index(int(np.argmax(sd)), sd.shape)
    worst = f"{run.board.imus[1 + int(k)]} {'xyz'[int(axis)]}, ± {1.96 * sd.max():.2g} mm"
    size = f"95 %, median of {sd.size} coordinates; worst {worst}"
    shape = 1e3 * np.sqrt(np.maximum(np.diag(total.shape), 0.0))
    apart = (
        f"one error for all is in the size, ± {196.0 * total.size_sd:.2g} %, and in the frame, "
        f"± {1.96 * float(total.frame_sd.max()) / DEG:.2g} deg (95 %)"
    )
    names = ("accelerometers in motion", "gyros in motion")
    errors = zip(run.outcome.errors, names, strict=False)
    worths = (
        Worth("positions", f"± {1.96 * np.median(sd):.2g} mm", size, "size and frame included"),
        Worth("their shape", f"± {1.96 * np.median(shape):.2g} mm", "95 %, median", apart),
        *(sections.error_worth(e, n, "motion") for e, n in errors),
    )
    weak = (t.text for t in observability if t.tone == "warning")
    return sections.compose_card(
        run.outcome, worths, *weak, uses=(_FUSE,), picture=board_picture(run)
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _position_table(
    title: str, board: Board, total: Total, last: str, more: tuple[str, ...], note: str
) -> Table:
    """Coordinates with their sd, mm; `more` is the last column, the reference's left out."""
    rows: list[tuple[str, ...]] = [(board.imus[0], "0", "0", "0", "", "", "", "reference")]
    for k, name in enumerate(board.imus[1:], start=1):
        mean, sd = 1e3 * total.mean[k], 1e3 * total.sd[k]
        cells = [format_with_sd(m, s)[0] for m, s in zip(mean, sd, strict=True)]
        rows.append((name, *cells, *(f"{s:.2g}" for s in sd), more[k]))
    header = ("IMU", "x", "y", "z", "sd x", "sd y", "sd z", last)
    return Table(title, header, tuple(rows), "lrrrrrrr", note)


def _known(total: Total, gyros: GyroScale, board: Board, request: ArrayRequest) -> Facts:
    """Size, what fixes it, frame and shape: how far each is known."""
    value, sd = size_over(board.drawn, total.mean, total.covariance)
    motion = size_over(board.drawn, total.mean, total.motion)[1]
    shape = 1e3 * float(np.sqrt(np.median(np.diag(total.shape))))
    turns = gyros.turns
    scale = f"{plus_minus(100 * gyros.value, 100 * gyros.sd)} %"
    if turns is None:
        scale += ", by the data sheets alone: turn the board by 90 deg or more between rests"
    else:
        scale += (
            f": {turns.count} turns between rests ({plus_minus(100 * turns.scale, 100 * turns.sd)} "
            f"%, misfit {turns.misfit / DEG:.2g} deg) and the data sheets' ± "
            f"{100 * gyros.tolerance:.2g} %"
        )
    rows = [
        ("size over drawing", f"{plus_minus(value, sd)}, of which the motion ± {motion:.2g}"),
        ("gyros' common scale", scale),
        ("gravity", f"± {100 * total.gravity_sd:.2g} % of the size ({request.gravity_source})"),
    ]
    for d in request.distances:
        after, after_sd = (1e3 * v for v in total.distance(d.one, d.two))
        words = f"{plus_minus(1e3 * d.value, 1e3 * d.sd)} mm as measured, "
        words += f"{plus_minus(after, after_sd)} mm after all"
        rows.append((f"{board.imus[d.one]} to {board.imus[d.two]}", words))
    frame = f"± {_rms(total.frame_sd) / DEG:.2g} deg about each axis: the triads' mean axes against"
    rows.append(("frame", f"{frame} the board's"))
    rows.append(("shape", f"± {shape:.2g} mm (median), whatever size and frame are"))
    return Facts(tuple(rows))


def _compose_motion_section(run: ArrayRun) -> Section:
    moving, residual, rests, inner = run.moving, run.residual, run.rests, run.state.setup.inner
    speed = np.linalg.norm(run.state.sampled.rate[inner], axis=1) / DEG
    open_ = (f"{x.name} {x.value:.2g} {x.unit} (accepted {x.accepted:g})" for x in run.outcome.left)
    rows = [(name, f"{n} samples") for name, n in moving.counts.items()]
    rows += [
        ("used", f"{len(inner)} samples, evenly over the motion"),
        ("rotation", f"median {np.median(speed):.0f}, largest {speed.max():.0f} deg/s"),
        (
            "gyro scatter",
            f"{_rms(moving.gyros.scatter[moving.good]) / DEG:.2f} deg/s rms about their mean",
        ),
        (
            f"residual{', held out' if residual.held_out else ''}",
            f"{residual.acceleration:.3f} m/s² and {residual.rate / DEG:.2f} deg/s (1.4826 MAD); "
            f"at rest {_rms(rests.noise):.3f} and {_rms(rests.gyro_noise) / DEG:.2f}",
        ),
        ("inside the noise", f"{_inside(run)} of readings, where the fitted noise has 95 %"),
        ("not explained", ", ".join(open_)),
        ("clipped samples", "left out whole"),
    ]
    return Section("The motion", (Facts(tuple(rows)),))


def _inside(run: ArrayRun) -> str:
    """The share of residuals of accelerometers and gyros within 95 % of the noise that was fitted,
    a Student t of as many numbers as the motion leaves of a triad (Lange, Little, Taylor 1989)."""
    from scipy.special import fdtri

    *squares, speed = run.state.squares()
    shares = []
    for noise, off in zip(run.state.noise, squares, strict=True):
        edge = fdtri(off.numbers, min(noise.freedom, 1e9), 0.95) * off.numbers
        shares.append(100.0 * float(np.mean(off.length <= edge * noise.variance(speed))))
    return " and ".join(f"{share:.0f} %" for share in shares)


def _compose_rests_section(run: ArrayRun) -> Section:
    rests, loop = run.rests, run.rests.loop
    residual = f"{1e3 * rests.residual:.2f} mm/s² rms, {1e3 * rests.before:.2f} before the search"
    found = ", ".join(s.effect for s in loop.named) if loop and loop.named else "nothing"
    facts = (
        ("rests", str(rests.poses)),
        ("gravity", f"{rests.gravity:.5f} m/s² ({run.request.gravity_source})"),
        ("residual", residual),
        ("found at rest", found),
    )
    gain, offset, _ = rests.in_board_axes()
    relative = gain @ np.linalg.inv(gain[0])
    rows = []
    for k, name in enumerate(run.board.imus):
        diagonal = ", ".join(f"{v:+.4f}" for v in np.diag(gain[k]) - 1.0)
        twist = 0.5 * (relative[k] - relative[k].T)
        angles = ", ".join(f"{v / DEG:+.2f}" for v in (twist[2, 1], twist[0, 2], twist[1, 0]))
        rows.append((name, diagonal, angles, ", ".join(f"{v:+.3f}" for v in offset[k])))
    note = f"Turn: relative to {run.board.imus[0]}. Positions are in the triads' mean frame."
    header = ("IMU", "scale - 1", "turn, deg", "bias, m/s²")
    table = Table("Triads", header, tuple(rows), "lrrr", note)
    return Section("The rests", (Facts(facts), table))


def _observability(run: ArrayRun) -> tuple[Text, ...]:
    """Which direction the motion shows worst, and which motion would show it."""
    rate = run.state.sampled.rate[run.state.setup.inner]
    values, axes = eigen(rate.T @ rate / len(rate))
    rms = np.sqrt(np.maximum(values, 0.0)) / DEG
    words = []
    if rms[0] < _UNEVEN * rms[2]:
        little = (
            f"Little rotation about {along(axes[:, 0])}: {rms[0]:.0f} deg/s rms against "
            f"{rms[2]:.0f} about the liveliest axis. Twisting about it would tighten the positions "
            "most."
        )
        words.append(Text(little, "warning"))
    sd, ways = rank_directions(run.total.motion)
    known = (
        f"Positions are known worst {along(ways[:, -1])}: {1e3 * sd[-1]:.2g} mm by the motion and "
        f"the rests, {100 * sd[-1] / run.board.prior_sd:.2g} % of what was assumed beforehand; "
        f"best {along(ways[:, 0])}: {1e3 * sd[0]:.2g} mm."
    )
    words.append(Text(known, "warning") if sd[0] < _UNEVEN * sd[-1] else Text(known))
    return tuple(words)


def compose_board_document(run: BoardRun) -> Document:
    """Pooled positions, whether the logs agree, what repeats, and what a new log will say."""
    board, request = run.runs[0].board, run.runs[0].request
    sd = 1e3 * float(np.median(run.total.sd[1:]))
    names = ", ".join(r.outcome.provenance.input for r in run.runs)
    between = 1e3 * run.pooled.between.reshape(-1, 3)
    more = ("", *(", ".join(f"{v:.3f}" for v in one) for one in between))
    note = "mm; between logs: of the positions as the motion shows them, without size and frame."
    pooled = _position_table("Pooled positions", board, run.total, "sd between logs", more, note)
    known = _known(run.total, run.gyros, board, request)
    first = (
        Section("Positions of all logs together", (pooled, known)),
        _agreement(run),
        Section("What repeats from log to log", (_repeats(run),)),
    )
    title = f"{board.name} from {names}"
    worth = Worth("positions", f"± {1.96 * sd:.2g} mm", "95 %, median; size and frame included")
    card = sections.compose_card(run.outcome, [worth])
    return sections.compose_calibration_document(title, run, card, first=first)


def _agreement(run: BoardRun) -> Section:
    found, agree = run.pooled, not run.outcome.reasons
    new = found.new(np.mean([r.total.motion for r in run.runs], axis=0))
    words = "agree within what they state" if agree else "differ by more than they state"
    text = (
        f"The logs {words}: χ² {found.chi2:.1f} of {found.freedom} degrees of freedom, p "
        f"{found.p:.2g}. Each log left out lies {_rms(found.left_out):.2f} stated deviations "
        "(rms) from what the others predict."
    )
    rows = tuple(
        (
            r.outcome.provenance.input,
            f"{own:.2f}",
            f"{1e3 * _rms(off):.4f}",
            f"{1e3 * np.sqrt(np.mean(np.diag(r.total.motion))):.4f}",
        )
        for r, own, off in zip(run.runs, found.left_out, found.missed, strict=True)
    )
    header = ("log", "z rms", "off by, mm rms", "stated, mm")
    table = Table("Each log against the others", header, rows, "lrrr")
    half = f"± {1e3 * np.sqrt(np.mean(np.diag(new))):.2g} mm"
    facts = (
        ("between logs", f"{1e3 * found.tau:.2g} mm beyond what each states"),
        ("a new log", f"{half} from the pooled positions"),
    )
    return Section("Agreement", (Text(text, "ok" if agree else "warning"), table, Facts(facts)))


def _repeats(run: BoardRun) -> Table:
    rows = []
    for one in run.repeats:
        sizes = (f"{one.between:.2g}", f"{one.stated:.2g}", f"{one.found.p:.2g}")
        rows.append((one.name, one.unit, *sizes, "pooled" if one.holds else "of each log"))
    note = (
        "Rms over the numbers. What does not repeat is anew at every power-up: the pooled file "
        "holds the mean of the biases with what they differ by, and every log's own."
    )
    header = ("what", "unit", "between logs", "stated", "p", "taken")
    return Table("Between logs against stated", header, tuple(rows), "llrrrl", note)
