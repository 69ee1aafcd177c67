"""The report of a comparison."""

from __future__ import annotations

import numpy as np

from imucalib.calibration.comparison.compare import SIGNIFICANT, Comparison, Drift
from imucalib.report.comparing.card import TONE, comparison_card
from imucalib.report.comparing.picture import control_chart
from imucalib.report.comparing.words import QUANTITY, due_words, verdict_words
from imucalib.report.document import Block, Document, Section, Table, Text, Tone
from imucalib.significant_digits import plus_minus, two_digits, with_sd

#: Columns of single calibrations that a table has room for.
_ROOM = 3


def comparison_document(found: Comparison, command: str = "") -> Document:
    """Verdict and card, what differs, parameter by parameter, scatter, drift, control chart."""
    sections = [
        Section("What it means", (_meanings(found),)),
        Section("Parameters", (Text(found.basis.words), _parameters(found))),
    ]
    if found.scatter is not None:
        sections.append(Section("Between calibrations", tuple(_scatter(found))))
    if found.drift is not None:
        sections.append(Section("Drift", tuple(_drift(found, found.drift))))
    chart = control_chart(found)
    if chart is not None:
        sections.append(Section("Control chart", (chart,), brief=False))
    notes = tuple(Text(f"{n[0].upper()}{n[1:]}.", "warning") for n in found.notes)
    if notes:
        sections.append(Section("Notes", notes))
    title = f"Comparison of {', '.join(found.names)}"
    verdict = Text(verdict_words(found), TONE[found.verdict])
    card, footer = comparison_card(found, command), (("command", command),) if command else ()
    return Document(title, verdict, tuple(sections), footer, card, drawn="--html")


def _meanings(found: Comparison) -> Table:
    rows: list[tuple[str, ...]] = []
    tones: dict[int, Tone] = {}
    for meaning in found.meanings:
        worst = meaning.worst
        if meaning.beyond:
            tones[len(rows)] = "bad" if found.differ else "warning"
        direction = "  ".join(f"{v:+.2f}" for v in worst.attitude)
        rows.append((
            QUANTITY[worst.unit], meaning.sensor,
            " - ".join(found.names[k] for k in reversed(worst.pair)),
            *(with_sd(worst.value, worst.sd) if worst.sd > 0.0 else (two_digits(worst.value), "-")),
            f"{meaning.limit:.2g}", worst.unit, direction,
        ))  # fmt: skip
    how = "as stated" if found.stated else f"{SIGNIFICANT:g} times the largest stated sd"
    note = f"The worst attitude of all, as the direction of the force. Limit: {how}."
    header = ("difference of", "sensor", "pair", "at most", "sd", "limit", "unit", "attitude")
    keep = [0, *((1,) if any(m.sensor for m in found.meanings) else ()), 2, 3, 4, 5, 6, 7]
    picked = tuple(tuple(row[k] for k in keep) for row in rows)
    align = "".join("lllrrrll"[k] for k in keep)
    return Table("", tuple(header[k] for k in keep), picked, align, note, tones)


def _parameters(found: Comparison) -> Table:
    basis, fit = found.basis, found.agreement
    m = len(found.names)
    sd = np.sqrt(np.einsum("kii->ki", basis.covariance))
    rows, tones = [], dict[int, Tone]()
    for k, (name, unit) in enumerate(zip(basis.names, basis.units, strict=True)):
        z = fit.z[-1, k] if m == 2 else fit.z[np.argmax(np.abs(fit.z[:, k])), k]
        if abs(z) > 3.0:
            tones[k] = "warning"
        each = (plus_minus(float(v), float(s)) for v, s in
                zip(basis.value[:_ROOM, k], sd[:_ROOM, k], strict=True))  # fmt: skip
        rows.append((name if unit == "1" else f"{name}, {unit}", *each, f"{z:+.1f}"))
    heads = tuple(found.names[:_ROOM])
    note = "z: the last minus the first over the sd of the difference."
    if m > 2:
        note = "z: the largest of one against the mean of the others."
    if m > _ROOM:
        note += f" Shown are the first {_ROOM} of {m}; all are in the JSON."
    header = ("parameter", *heads, "z")
    return Table("", header, tuple(rows), "l" + "r" * (len(heads) + 1), note, tones)


def _scatter(found: Comparison) -> list[Block]:
    assert found.scatter is not None
    scatter, basis = found.scatter, found.basis
    rows = tuple(
        (name, f"{two_digits(float(sd))}", f"{two_digits(float(a))} to {two_digits(float(b))}",
         f"{z:.2f}", unit)
        for name, sd, a, b, z, unit in zip(
            basis.names, scatter.sd, scatter.low, scatter.high, scatter.z_rms, basis.units,
            strict=True,
        )
    )  # fmt: skip
    note = (
        "sd: between calibrations, beyond what each states (Paule and Mandel); 95 % interval by "
        "its χ²; z rms: 1 where the scatter is what they state."
    )
    z = found.agreement.z_rms
    said = f"All parameters together: z rms {z:.2f}, where 1 is what the files state."
    if found.differ:
        said += " A single calibration is worth less than its sd says."
    table = Table("", ("parameter", "sd", "95 %", "z rms", "unit"), rows, "lrrrl", note)
    return [Text(said, "warning" if found.differ else "plain"), table]


def _drift(found: Comparison, drift: Drift) -> list[Block]:
    words = [Text(f"{drift.dates.words[0].upper()}{drift.dates.words[1:]}."), due_words(drift)]
    basis = found.basis
    rows = tuple(
        (name, *with_sd(s.value, s.half), f"{unit}/day")
        for name, unit, s in zip(basis.names, basis.units, drift.slopes, strict=True)
    )
    tones: dict[int, Tone] = {k: "warning" for k, s in enumerate(drift.slopes) if s.shown}
    return [*words, Table("", ("parameter", "drift", "± 95 %", "unit"), rows, "lrrl", "", tones)]
