"""The report of a fleet: what its devices share, what each gains, who is not of the kind."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.cohort.fleet.outcome import Fleet
from imucalib.core.effect import Context
from imucalib.data import fields, list_fields, plain
from imucalib.effects import named
from imucalib.effects.forms import in_words
from imucalib.estimators.power_ups import ExcessScatter
from imucalib.report.render.document import (
    Card,
    Column,
    Document,
    Plot,
    Section,
    Series,
    Table,
    Text,
    Tone,
    Use,
    Worth,
    capital,
)
from imucalib.significant_digits import per_cent, plus_minus, size_with_unit

_TONE: dict[str, Tone] = {"explained": "ok", "suspected": "warning", "unexplained": "warning"}
_SHARED: tuple[Column, ...] = (
    ("effect", "effect", ""),
    ("probability", lambda one: per_cent(one.probability), ">"),
    ("foretold, nats", lambda one: one.nats.sum(), "+.1f"),
    ("devices that gain", lambda one: f"{np.sum(one.nats > 0.0)} of {len(one.able)}", ">"),
    ("rivals", lambda one: ", ".join(one.rivals) or "none", ""),
)
#: What an error of a device is an error of.
_HOW = {
    "lab": "rms on positions held out",
    "actigraph": "rms of |a| of a posture, beside the walk of its bias",
}


def compose_fleet_document(fleet: Fleet) -> Document:
    """Verdict and card first."""
    kept = (r for m in fleet.members for r in m.recordings if r.kept)
    notes = (*fleet.notes, *(f"{r.name} stays as it was calibrated: {r.kept}." for r in kept))
    each = _each(fleet)
    parts = (
        Section("What the devices share", _shared(fleet)),
        Section("Devices", each[:1]),
        Section("Between devices", _spread(fleet)),
        Section("What was tried", _try(fleet)),
        Section("Notes", Text.paragraphs(notes)),
    )
    footer = (("command", fleet.command),) if fleet.command else ()
    picture = each[1] if each else None
    card = Card(_worth(fleet), _find(fleet), _to_do(fleet), fleet.command, _uses(fleet), picture)
    title = f"Fleet of {len(fleet.members)} devices"
    return Document(title, _verdict(fleet), parts, footer, card)


def _verdict(fleet: Fleet) -> Text:
    """Without figures: these are on the card."""
    names = ", ".join(" or ".join(map(in_words, (f.effect, *f.rivals))) for f in fleet.found)
    words = "Nothing that the devices share shows."
    if names:
        words = f"{fleet.verdict.capitalize()}: all devices have {names}."
    elif fleet.search is None:
        words = f"{len(fleet.members)} devices compared by their parameters."
    return Text(words, _TONE.get(fleet.verdict, "plain"))


def _uses(fleet: Fleet) -> tuple[Use, ...]:
    """What a device's own calibration, and the fleet's, are for."""
    first = fleet.members[0]
    own = f"{{folder}}/{first.folder_of(first.recordings[0])}/calibration.yaml"
    purpose = f"Correct a recording of {first.name}, and so for each device"
    uses = [Use(purpose, ("apply", own, "RECORDING", "-o", "corrected.mcap"))]
    if fleet.following:
        calibrator = fleet.calibrator
        wanted = "TABLE" if calibrator == "lab" else "RECORDING"
        command = (calibrator, wanted, "--fleet", "{folder}/fleet.yaml")
        uses.append(Use("Calibrate another device of the kind", command))
    return tuple(uses)


def _worth(fleet: Fleet) -> tuple[Worth, ...]:
    """What a device is good to, on positions held out by what the other devices say."""
    members = [m for m in fleet.members if np.isfinite(m.final)]
    if not members:  # compared by their parameters: how much they differ, those of a unit together
        made = []
        for unit in dict.fromkeys(s.unit for s in fleet.spreads):
            own = np.array([s.scatter for s in fleet.spreads if s.unit == unit])
            what = "shares" if unit == "1" else f"parameters in {unit}"
            size = size_with_unit(float(np.sqrt(np.mean(own**2))), unit)
            made.append(Worth(f"{len(own)} {what}", size, "between devices, rms"))
        return tuple(made)
    worst, how = max(members, key=lambda m: m.final), _HOW[fleet.calibrator]
    detail = f"{worst.name}, {how}; alone {worst.base:.3g}"
    one = Worth("the worst device", f"{worst.final:.3g} mg", detail)
    gain = fleet.difference
    if gain is None:
        return (one,)
    return (
        Worth("all devices", f"{gain.after:.3g} mg", f"{how}; each alone {gain.before:.3g}"),
        one,
    )


def _find(fleet: Fleet) -> tuple[Text, ...]:
    tone, lines = _TONE.get(fleet.verdict, "plain"), []
    for one in fleet.found:
        rivals = f"; or {' or '.join(map(in_words, one.rivals))}" if one.rivals else ""
        words = (
            f"{in_words(one.effect).capitalize()}, in every device with a size of its own: "
            f"{int(np.sum(one.nats > 0.0))} of {len(one.able)} gain by what the others say{rivals}."
        )
        lines.append(Text(words, tone))
    if not lines:
        what = "Nothing that the devices share stands out."
        if fleet.search and fleet.search.refused:
            what = "; ".join(f"{name} stands out, but {why}" for name, why in fleet.search.refused)
            what = f"{capital(what)}."
        lines.append(Text(what if fleet.search else "No effect was searched for.", tone))
    for o in fleet.outliers:
        size = f"{o.parameter} is {plus_minus(o.value, o.sd, o.unit)}, the others {o.mean:.3g}"
        words = f"{size} with a scatter of {o.scatter:.2g} (chance {o.p:.1g})"
        lines.append(Text(f"Not of the kind: {o.device}, whose {words}.", "warning"))
    if fleet.failed:
        failed = ", ".join(name for name, _ in fleet.failed)
        lines.append(Text(f"Not calibrated: {failed}.", "bad"))
    return tuple(lines)


def _to_do(fleet: Fleet) -> tuple[str, ...]:
    steps = [
        f"Look at {name} by itself, then leave it out: another kind, another unit, or a fault."
        for name in dict.fromkeys(o.device for o in fleet.outliers)
    ]
    steps += [f"Mend {name}: {why.rstrip('.')}." for name, why in fleet.failed]
    lab = fleet.calibrator == "lab"
    if fleet.verdict in ("suspected", "unexplained"):
        more = "positions of each: `imucal design TABLE`" if lab else "recordings of each"
        steps.append(f"Record more devices, or more {more}.")
    return tuple(steps)


def _shared(fleet: Fleet) -> tuple[Table, ...]:
    note = (
        "Probability: that the fleet lacks this, and nothing else beside what stands above. "
        "Foretold: what each device's data gain by the size that the other devices give the effect."
    )
    return (Table.from_columns(_SHARED, fleet.found, note=note),) if fleet.found else ()


def _each(fleet: Fleet) -> tuple[()] | tuple[Table, Plot]:
    """Every device, alone and with the fleet, as a table and as a picture."""
    shown = [m for m in fleet.members if np.isfinite(m.base)]
    if not shown:
        return ()
    rows = tuple(
        (m.name, f"{m.base:.3g}", f"{m.final:.3g}", ", ".join(m.found_by_others) or "nothing")
        for m in shown
    )
    at, names = np.arange(1.0, len(shown) + 1.0), tuple(m.name for m in shown)
    series = [Series("alone", at, np.array([m.base for m in shown]), "rings", names=names)]
    if fleet.found:
        final = np.array([m.final for m in shown])
        series.append(Series("with the fleet", at, final, "points", names=names))
    error, caption = "error beside the walk", "Effects"
    if fleet.calibrator == "lab":
        error, caption = "held-out error", "Each position predicted without it; effects"
    caption += " chosen and sized by the other devices."
    title = f"{error.capitalize()} of each device"
    plot = Plot(title, "device", f"{error}, rms, mg", tuple(series), caption)
    header = ("device", "alone, mg", "with the fleet, mg", "found by the others")
    note = "With the fleet: by effects that the others find, and size, without the device."
    return Table(error.capitalize(), header, rows, "lrrl", note), plot


def _spread(fleet: Fleet) -> tuple[Table, ...]:
    twice = any(s.sessions for s in fleet.spreads)
    rows: list[tuple[str, ...]] = []
    for s in fleet.spreads:
        mean = plus_minus(s.mean, s.mean_sd, s.unit)
        between = _scatter(s.sessions, s.unit) if s.sessions else "-"
        rows.append((s.name, mean, _scatter(s.interval, s.unit), *[between] * twice))
    # Of effects that were found: the mean size, and how much devices differ by what they say.
    for one in fleet.found:
        sds = np.sqrt(np.diag(one.sizes.common_covariance))
        parameters = named(one.effect).parameters(Context(1))
        for p, m, sd in zip(parameters, one.sizes.common, sds, strict=True):
            mean = plus_minus(m * p.typical, sd * p.typical, p.unit)
            rows.append(
                (
                    p.name,
                    mean,
                    size_with_unit(one.sizes.scatter * p.typical, p.unit),
                    *["-"] * twice,
                )
            )
    note = "Scatter: sd between devices beyond what each one's own sd explains, 95 % in brackets."
    header = ["parameter", "mean of the fleet", "between devices"]
    header += ["between recordings of a device"] * twice
    return (Table("", tuple(header), tuple(rows), "", note),) if rows else ()


def _scatter(one: ExcessScatter, unit: str) -> str:
    return f"{size_with_unit(one.sd, unit)} ({one.low:.2g} to {one.high:.2g})"


def _try(fleet: Fleet) -> tuple[Table | Text, ...]:
    if fleet.search is None or not fleet.search.first:
        return ()
    rows = tuple(
        (one.effect, f"{one.evidence:.1f}", per_cent(one.probability), str(one.devices))
        for one in fleet.search.first
    )
    refused = Text.paragraphs(f"{name}: {why}" for name, why in fleet.search.refused)
    header = ("effect", "evidence, nats", "probability", "devices")
    return (Table("", header, rows, "lrrr"), *refused)


def fleet_dict(fleet: Fleet) -> dict[str, Any]:
    """report.json of a fleet, as plain types."""
    search, made = fleet.search, [r.provenance for m in fleet.members for r in m.recordings]
    found = (
        "effect probability evidence_nats=evidence foretold_nats=nats "
        "rivals devices=able common_typical=sizes.common scatter_typical=sizes.scatter"
    )
    tried = "effect evidence_nats=evidence probability devices"
    outlier = "device parameter value sd unit others=mean scatter p"
    gain = "before after gain low high nats nats_low"
    members = [
        {
            "name": m.name,
            "recordings": [
                {"name": r.name, "input": r.provenance["input"], "kept": r.kept or None}
                for r in m.recordings
            ],
            **fields(m, "base_mg=base final_mg=final found_by_the_others=found_by_others"),
        }
        for m in fleet.members
    ]
    spreads = [
        {
            **fields(s, "parameter=name unit mean mean_sd scatter"),
            "scatter_95": [s.interval.low, s.interval.high],
            "between_recordings": s.sessions and vars(s.sessions),
        }
        for s in fleet.spreads
    ]
    content = {
        **fields(fleet, "calibrator verdict exit_code"),
        "found": list_fields(fleet.found, found),
        "held_out_mg": fleet.difference and fields(fleet.difference, gain),
        "devices": members,
        "between_devices": spreads,
        "outliers": list_fields(fleet.outliers, outlier),
        "tried": list_fields(search.first if search else (), tried),
        "refused": [
            {"effect": name, "why": why} for name, why in (search.refused if search else ())
        ],
        "failed": [{"name": name, "why": why} for name, why in fleet.failed],
        "notes": fleet.notes,
        "provenance": {
            "inputs": [{name: one[name] for name in ("input", "sha256")} for one in made],
            **fields(fleet, "settings command"),
            **{name: made[-1][name] for name in ("versions", "time")},
        },
    }
    return dict(plain(content))
