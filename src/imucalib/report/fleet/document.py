"""The report of a fleet: what its devices share, what each gains, who is not of the kind."""

from __future__ import annotations

import numpy as np

from imucalib.cohort.fleet.run import Fleet
from imucalib.report.document import Document, Plot, Section, Series, Table, Text
from imucalib.report.fleet.card import TONES, fleet_card
from imucalib.significant_digits import plus_minus


def fleet_document(fleet: Fleet) -> Document:
    """Headline and card first."""
    return Document(
        f"Fleet of {len(fleet.members)} devices",
        Text(_verdict(fleet), TONES.get(fleet.verdict, "plain")),
        tuple(
            section
            for section in (_found(fleet), _each(fleet), _spread(fleet), _outlying(fleet),
                            _candidates(fleet), _failed(fleet))
            if section.blocks
        ),
        (("command", fleet.request.command), ("seed", str(fleet.request.seed)))
        if fleet.request.command
        else (),
        fleet_card(fleet),
    )  # fmt: skip


def _verdict(fleet: Fleet) -> str:
    names = ", ".join(one.effect for one in fleet.search.found)
    if not names:
        return f"{fleet.verdict.capitalize()}: no effect is shared beyond chance."
    text = f"{fleet.verdict.capitalize()}: {names}, in every device with a size of its own."
    gain = fleet.difference
    if gain is None:
        return text
    return (
        f"{text} Held-out error {gain.before:.3g} to {gain.after:.3g} mg, less by "
        f"{gain.gain:.3g} mg (95 %: {gain.low:.2g} to {gain.high:.2g})."
    )


def _found(fleet: Fleet) -> Section:
    rows = []
    for one in fleet.search.found:
        rows.append(
            (
                one.effect,
                f"{one.pooled.p:.2g}",
                f"{one.nats.sum():+.1f}",
                f"{int(np.sum(one.nats > 0.0))} of {len(one.able)}",
                ", ".join(one.rivals) or "none",
            )
        )
    if not rows:
        return Section("What the devices share", ())
    header = ("effect", "chance in the fleet", "foretold, nats", "devices that gain", "rivals")
    note = (
        "Chance: how often anything stands out as much in a fleet that lacks nothing. Foretold: "
        "what each device's data gain by the size that the other devices give the effect."
    )
    return Section("What the devices share", (Table("", header, tuple(rows), "lrrrl", note),))


def _each(fleet: Fleet) -> Section:
    shown = [m for m in fleet.members if np.isfinite(m.base)]
    if not shown:
        return Section("Devices", ())
    rows = tuple(
        (m.name, f"{m.base:.3g}", f"{m.final:.3g}", ", ".join(m.told) or "nothing") for m in shown
    )
    at = np.arange(1.0, len(shown) + 1.0)
    series = [Series("alone", at, np.array([m.base for m in shown]), "rings",
                     names=tuple(m.name for m in shown))]  # fmt: skip
    if fleet.search.found:
        final = np.array([m.final for m in shown])
        series.append(Series("with the fleet", at, final, "points", names=series[0].names))
    plot = Plot(
        "Held-out error of each device", "device", "held-out error, rms, mg", tuple(series),
        "Each position predicted without it; effects chosen and sized by the other devices.",
    )  # fmt: skip
    header = ("device", "alone, mg", "with the fleet, mg", "found by the others")
    note = "With the fleet: by effects that the others find, and size, without the device."
    table = Table("Held-out error", header, rows, "lrrl", note)
    return Section("Devices", (table, plot))


def _spread(fleet: Fleet) -> Section:
    rows = tuple(
        (
            s.name,
            plus_minus(s.mean, s.mean_sd, s.unit),
            f"{s.scatter:.2g} {s.unit.removeprefix('1')}".rstrip(),
        )
        for s in fleet.spreads
    )
    note = "Scatter: sd between devices beyond what each one's own sd explains."
    table = Table("", ("parameter", "mean of the fleet", "scatter"), rows, "lrr", note)
    return Section("Between devices", (table,) if rows else (), brief=False)


def _outlying(fleet: Fleet) -> Section:
    texts = tuple(
        Text(
            f"{o.device}: {o.parameter} is {plus_minus(o.value, o.sd, o.unit)}, the others "
            f"{o.mean:.3g} with a scatter of {o.scatter:.2g} (chance {o.p:.1g}): another kind, "
            "another unit, or a fault.",
            "warning",
        )
        for o in fleet.outliers
    )
    return Section("Not of the kind", texts)


def _candidates(fleet: Fleet) -> Section:
    rows = tuple(
        (one.effect, f"{one.evidence:.1f}", f"{one.p:.2g}", str(one.devices))
        for one in fleet.search.first
    )
    refused = tuple(Text(f"{name}: {why}") for name, why in fleet.search.refused)
    table = Table("", ("effect", "evidence, nats", "chance", "devices"), rows, "lrrr")
    return Section("What was tried", (table, *refused), brief=False)


def _failed(fleet: Fleet) -> Section:
    texts = tuple(Text(f"{name}: {why}", "bad") for name, why in fleet.failed)
    return Section("Not calibrated", texts)
