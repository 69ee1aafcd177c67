"""The report of several logs of one board, as data."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.array.logs.board_run import BoardRun
from imucalib.report.array.known import known_facts
from imucalib.report.document import Document, Facts, Section, Table, Text
from imucalib.report.sections import closing_sections, verdict
from imucalib.significant_digits import with_sd


def board_document(run: BoardRun) -> Document:
    """Pooled positions, whether the logs agree, what repeats, and what a new log will say."""
    first = run.runs[0]
    sd = 1e3 * float(np.median(run.total.sd[1:]))
    names = ", ".join(r.outcome.provenance.path for r in run.runs)
    text = (
        f"{len(run.runs)} logs of {first.board.name}: {first.board.count} positions to {sd:.2g} mm "
        "(median standard deviation, size and frame included)."
    )
    sections = (
        Section("Positions of all logs together", (_positions(run), known_facts(
            run.total, run.gyros, first.board, first.request
        ))),
        _agreement(run),
        Section("What repeats from log to log", (_repeats(run),)),
        *closing_sections(run.outcome),
    )  # fmt: skip
    return Document(
        f"{first.board.name} from {names}",
        verdict(run.outcome, text),
        tuple(s for s in sections if s.blocks),
        run.outcome.provenance.footer,
    )


def _positions(run: BoardRun) -> Table:
    mean, sd = 1e3 * run.total.mean, 1e3 * run.total.sd
    between = 1e3 * run.pooled.between.reshape(-1, 3)
    rows: list[tuple[str, ...]] = []
    for k, name in enumerate(run.runs[0].board.imus):
        if k == 0:
            rows.append((name, "0", "0", "0", "", "", "", "reference"))
            continue
        cells = [with_sd(float(m), float(s))[0] for m, s in zip(mean[k], sd[k], strict=True)]
        spread = [f"{s:.2g}" for s in sd[k]]
        rows.append((name, *cells, *spread, ", ".join(f"{v:.3f}" for v in between[k - 1])))
    header = ("IMU", "x", "y", "z", "sd x", "sd y", "sd z", "sd between logs")
    note = "mm; between logs: of the positions as the motion shows them, without size and frame."
    return Table("Pooled positions", header, tuple(rows), "lrrrrrrr", note)


def _agreement(run: BoardRun) -> Section:
    found = run.pooled
    new = found.new(np.mean([r.total.motion for r in run.runs], axis=0))
    z = float(np.sqrt(np.mean(found.left_out**2)))
    agree = not run.outcome.reasons
    words = "agree within what they state" if agree else "differ by more than they state"
    text = (
        f"The logs {words}: χ² {found.chi2:.1f} of {found.freedom} degrees of freedom, p "
        f"{found.p:.2g}. Each log left out lies {z:.2f} stated deviations (rms) from what the "
        "others predict."
    )
    rows = tuple(
        (r.outcome.provenance.path, f"{own:.2f}", f"{1e3 * np.sqrt(np.mean(off**2)):.4f}",
         f"{1e3 * np.sqrt(np.mean(np.diag(r.total.motion))):.4f}")
        for r, own, off in zip(run.runs, found.left_out, found.missed, strict=True)
    )  # fmt: skip
    table = Table(
        "Each log against the others",
        ("log", "z rms", "off by, mm rms", "stated, mm"),
        rows,
        "lrrr",
    )
    facts = Facts((
        ("between logs", f"{1e3 * found.tau:.2g} mm beyond what each states"),
        ("a new log", f"± {1e3 * np.sqrt(np.mean(np.diag(new))):.2g} mm from the pooled positions"),
    ))  # fmt: skip
    return Section("Agreement", (Text(text, "ok" if agree else "warning"), table, facts))


def _repeats(run: BoardRun) -> Table:
    rows = tuple(
        (one.name, one.unit, f"{one.between:.2g}", f"{one.stated:.2g}", f"{one.found.p:.2g}",
         "pooled" if one.holds else "of each log")
        for one in run.repeats
    )  # fmt: skip
    note = (
        "Rms over the numbers. What does not repeat is anew at every power-up: the pooled file "
        "holds the mean of the biases with what they differ by, and every log's own."
    )
    header = ("what", "unit", "between logs", "stated", "p", "taken")
    return Table("Between logs against stated", header, rows, "llrrrl", note)
