"""The report of a fleet: what its devices share, what each gains, who is not of the kind."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imucalib.calibration.comparison.agreement import Beyond
from imucalib.cohort.fleet.outcome import Fleet
from imucalib.core.effect import Context
from imucalib.effects import named
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
                            _candidates(fleet), _failed(fleet), _notes(fleet))
            if section.blocks
        ),
        (("command", fleet.asked.command), ("seed", str(fleet.asked.seed)))
        if fleet.asked.command
        else (),
        fleet_card(fleet),
    )  # fmt: skip


def _verdict(fleet: Fleet) -> str:
    if fleet.search is None:
        return f"{len(fleet.members)} devices compared by their parameters; nothing was searched."
    names = ", ".join(" or ".join((one.effect, *one.rivals)) for one in fleet.search.found)
    if not names and fleet.search.refused:
        stood = " and ".join(name for name, _ in fleet.search.refused)
        return (
            f"{fleet.verdict.capitalize()}: {stood} stands out beyond chance, but what some "
            "devices say of it does not foretell the others."
        )
    if not names:
        return f"{fleet.verdict.capitalize()}: no effect is shared beyond chance."
    text = f"{fleet.verdict.capitalize()}: {names}, in every device with a size of its own."
    gain = fleet.difference
    if gain is None:
        return text
    if not np.isnan(gain.nats):
        return (
            f"{text} The others foretell {gain.parts} devices by {gain.nats:+.1f} nats in sum "
            f"(95 %: at least {gain.nats_low:+.1f}); error of a posture {gain.before:.3g} to "
            f"{gain.after:.3g} mg."
        )
    return (
        f"{text} Held-out error {gain.before:.3g} to {gain.after:.3g} mg, less by "
        f"{gain.gain:.3g} mg (95 %: {gain.low:.2g} to {gain.high:.2g})."
    )


def _found(fleet: Fleet) -> Section:
    rows = []
    for one in fleet.search.found if fleet.search else ():
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
    if fleet.search and fleet.search.found:
        final = np.array([m.final for m in shown])
        series.append(Series("with the fleet", at, final, "points", names=series[0].names))
    lab = fleet.asked.calibrator == "lab"
    error = "held-out error" if lab else "error beside the walk"
    plot = Plot(
        f"{error.capitalize()} of each device", "device", f"{error}, rms, mg", tuple(series),
        ("Each position predicted without it; effects" if lab else "Effects")
        + " chosen and sized by the other devices.",
    )  # fmt: skip
    header = ("device", "alone, mg", "with the fleet, mg", "found by the others")
    note = "With the fleet: by effects that the others find, and size, without the device."
    table = Table(error.capitalize(), header, rows, "lrrl", note)
    return Section("Devices", (table, plot))


def _spread(fleet: Fleet) -> Section:
    twice = any(s.sessions for s in fleet.spreads)
    rows = tuple(
        (
            s.name,
            plus_minus(s.mean, s.mean_sd, s.unit),
            _scatter(s.interval, s.unit),
            *((_scatter(s.sessions, s.unit) if s.sessions else "-",) if twice else ()),
        )
        for s in fleet.spreads
    )
    empty = ("-",) * twice
    rows += tuple((*row, *empty) for one in _sizes(fleet) for row in one)
    note = "Scatter: sd between devices beyond what each one's own sd explains, 95 % in brackets."
    header: tuple[str, ...] = ("parameter", "mean of the fleet", "between devices")
    header += ("between recordings of a device",) * twice
    table = Table("", header, rows, "l" + "r" * (len(header) - 1), note)
    return Section("Between devices", (table,) if rows else (), brief=False)


def _sizes(fleet: Fleet) -> Iterator[Iterator[tuple[str, ...]]]:
    """Of effects that were found: the mean size, and how much devices differ by what they say."""
    for one in fleet.search.found if fleet.search else ():
        sd = np.sqrt(np.diag(one.sizes.common_covariance))
        parameters = named(one.effect).parameters(Context(1))
        yield (
            (
                p.name,
                plus_minus(float(m * p.typical), float(s * p.typical), p.unit),
                f"{one.sizes.scatter * p.typical:.2g} {p.unit.removeprefix('1')}".rstrip(),
            )
            for p, m, s in zip(parameters, one.sizes.common, sd, strict=True)
        )


def _scatter(one: Beyond, unit: str) -> str:
    text = f"{one.sd:.2g} {unit.removeprefix('1')}".rstrip()
    return f"{text} ({one.low:.2g} to {one.high:.2g})"


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
        for one in (fleet.search.first if fleet.search else ())
    )
    if not rows:
        return Section("What was tried", ())
    assert fleet.search is not None
    refused = tuple(Text(f"{name}: {why}") for name, why in fleet.search.refused)
    table = Table("", ("effect", "evidence, nats", "chance", "devices"), rows, "lrrr")
    return Section("What was tried", (table, *refused), brief=False)


def _failed(fleet: Fleet) -> Section:
    texts = tuple(Text(f"{name}: {why}", "bad") for name, why in fleet.failed)
    return Section("Not calibrated", texts)


def _notes(fleet: Fleet) -> Section:
    kept = [f"{r.name} stays as it was calibrated: {r.kept}." for m in fleet.members
            for r in m.recordings if r.kept]  # fmt: skip
    return Section("Notes", tuple(Text(text, "plain") for text in (*fleet.notes, *kept)))
