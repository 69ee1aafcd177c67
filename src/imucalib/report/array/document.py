"""The report of `imucal array`, as data."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.array.run import ArrayRun
from imucalib.core.eigen import eigen
from imucalib.report.array.card import array_card
from imucalib.report.array.growth import growth_blocks
from imucalib.report.array.known import known_facts
from imucalib.report.array.plots import board_plots, chain_plots, close_up, deviation_plot
from imucalib.report.array.residuals import residual_plots
from imucalib.report.document import Document, Facts, Section, Table, Text
from imucalib.report.loop import TERMS, gain_plot, loop_section
from imucalib.report.sections import closing_sections, verdict
from imucalib.significant_digits import with_sd
from imucalib.units import DEG


def array_document(run: ArrayRun) -> Document:
    """Everything that a reader of the positions must know, headline first."""
    observability = _observability(run)
    sections = (
        Section(
            "Positions",
            (_position_table(run), known_facts(run.total, run.gyros, run.board, run.request)),
        ),
        _board_section(run),
        loop_section(run.outcome),
        Section(
            "Residual before and after",
            (*gain_plot(run.outcome.findings), *residual_plots(run)),
            brief=False,
        ),
        _motion_section(run),
        _rests_section(run),
        Section("Observability", observability),
        *closing_sections(run.outcome),
        _chain_section(run),
    )
    return Document(
        f"Positions of {run.board.name} from {run.outcome.provenance.path}",
        _verdict(run),
        tuple(s for s in sections if s.blocks),
        run.outcome.provenance.footer,
        array_card(run, observability),
        TERMS,
    )


def _board_section(run: ArrayRun) -> Section:
    plots = (*board_plots(run), close_up(run), deviation_plot(run), *growth_blocks(run))
    return Section("The board", plots, brief=False)


def _verdict(run: ArrayRun) -> Text:
    sd = 1e3 * float(np.median(run.total.sd[1:]))
    off = 1e3 * (run.total.mean - run.board.drawn)[1:]
    text = (
        f"{run.board.count} positions to {sd:.2g} mm (median standard deviation, size and frame "
        f"included) from {run.final.data.samples} moving samples; they differ from the drawing by "
        f"{np.sqrt(np.mean(off**2)):.2g} mm rms."
    )
    return verdict(run.outcome, text)


def _position_table(run: ArrayRun) -> Table:
    mean, sd = 1e3 * run.total.mean, 1e3 * run.total.sd
    off = mean - 1e3 * run.board.drawn
    rows: list[tuple[str, ...]] = []
    for k, name in enumerate(run.board.imus):
        if k == 0:
            rows.append((name, "0", "0", "0", "", "", "", "reference"))
            continue
        cells = [with_sd(float(m), float(s))[0] for m, s in zip(mean[k], sd[k], strict=True)]
        spread = [f"{s:.2g}" for s in sd[k]]
        away = ", ".join(f"{v:+.2f}" for v in off[k])
        rows.append((name, *cells, *spread, away))
    header = ("IMU", "x", "y", "z", "sd x", "sd y", "sd z", "minus drawing")
    note = f"mm, relative to {run.board.imus[0]}, in the board's axes; sd with size and frame."
    return Table("Positions of the accelerometers", header, tuple(rows), "lrrrrrrr", note)


def _motion_section(run: ArrayRun) -> Section:
    moving, data = run.moving, run.final.data
    speed = np.linalg.norm(data.rate, axis=1) / DEG
    gyro = np.sqrt(np.mean(moving.gyros.scatter[moving.good] ** 2)) / DEG
    rows = [(name, str(n)) for name, n in moving.counts.items()]
    rows += [
        ("used", f"{data.samples}, evenly over the motion"),
        ("rotation", f"median {np.median(speed):.0f}, largest {speed.max():.0f} deg/s"),
        ("gyro scatter", f"{gyro:.2f} deg/s rms about their mean"),
        (f"residual{', held out' if run.residual.held_out else ''}",
         f"{run.residual.acceleration:.3f} m/s² and {run.residual.rate / DEG:.2f} deg/s "
         "(1.4826 MAD); at rest "
         f"{np.sqrt(np.mean(run.rests.noise**2)):.3f} and "
         f"{np.sqrt(np.mean(run.rests.gyro_noise**2)) / DEG:.2f}"),
        ("not explained", ", ".join(f"{x.name} {x.value:.2g} {x.unit} (accepted "
                                    f"{x.accepted:g})" for x in run.outcome.left)),
        ("clipped samples", "left out whole"),
    ]  # fmt: skip
    return Section("The motion", (Facts(tuple(rows)),))


def _rests_section(run: ArrayRun) -> Section:
    rests = run.rests
    loop = rests.loop
    found = ", ".join(s.effect for s in loop.named) if loop and loop.named else "nothing"
    facts = Facts(
        (
            ("rests", str(rests.poses)),
            ("gravity", f"{rests.gravity:.5f} m/s² ({run.request.gravity_source})"),
            ("residual", f"{1e3 * rests.residual:.2f} mm/s² rms, "
             f"{1e3 * rests.before:.2f} before the search"),
            ("found at rest", found),
        )
    )  # fmt: skip
    gain, offset, _ = rests.in_board_axes()
    relative = gain @ np.linalg.inv(gain[0])
    rows = []
    for k, name in enumerate(run.board.imus):
        diagonal = ", ".join(f"{v:+.4f}" for v in np.diag(gain[k]) - 1.0)
        twist = 0.5 * (relative[k] - relative[k].T)
        angles = ", ".join(f"{v / DEG:+.2f}" for v in (twist[2, 1], twist[0, 2], twist[1, 0]))
        bias = ", ".join(f"{v:+.3f}" for v in offset[k])
        rows.append((name, diagonal, angles, bias))
    note = f"Turn: relative to {run.board.imus[0]}. Positions are in the triads' mean frame."
    table = Table(
        "Triads", ("IMU", "scale - 1", "turn, deg", "bias, m/s²"), tuple(rows), "lrrr", note
    )
    return Section("The rests", (facts, table), brief=False)


def _observability(run: ArrayRun) -> tuple[Text, ...]:
    """What the motion did not determine, and which motion would."""
    w = run.final.data.rate
    values, axes = eigen(w.T @ w / len(w))
    rms = np.sqrt(np.maximum(values, 0.0)) / DEG
    least = axes[:, 0] * np.sign(axes[np.argmax(np.abs(axes[:, 0])), 0])
    words = []
    if rms[0] < 0.3 * rms[2]:
        way = ", ".join(f"{v:+.2f}" for v in least)
        words.append(
            Text(
                f"Little rotation about ({way}): {rms[0]:.0f} deg/s rms against {rms[2]:.0f} about "
                "the liveliest axis. Twisting about it would tighten the positions most.",
                "warning",
            )
        )
    sd, prior = run.final.sd[1:], run.final.prior.sd
    worst = np.unravel_index(int(np.argmax(sd)), sd.shape)
    share = 100 * float(sd[worst]) / prior
    words.append(
        Text(
            f"Least determined: {run.board.imus[1 + int(worst[0])]} {'xyz'[int(worst[1])]}, "
            f"{1e3 * float(sd[worst]):.2g} mm, {share:.0f} % of what was assumed beforehand."
        )
    )
    pull = 300.0 * len(w) * run.final.scale[1] ** 2
    words.append(
        Text(
            "A flat prior on the angular acceleration would have shrunk the array by about "
            f"{pull:.2g} %; " + ("it was used." if run.request.motion == "flat" else
            "its covariance was learned instead.")
        )
    )  # fmt: skip
    return tuple(words)


def _chain_section(run: ArrayRun) -> Section:
    final = run.final
    facts = Facts(
        (
            ("sampler", f"{final.sampler}, {final.unknowns.shape[0]} chains of "
             f"{final.unknowns.shape[1]} draws, acceptance {100 * final.accepted:.0f} %"),
            ("agreement", final.convergence.sentence),
        )
    )  # fmt: skip
    return Section("The chains", (facts, *chain_plots(run)), brief=False)
