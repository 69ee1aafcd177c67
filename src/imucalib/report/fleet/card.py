"""The card of a fleet: what a device is good to, what they share, and what to do."""

from __future__ import annotations

import numpy as np

from imucalib.cohort.fleet.run import Fleet
from imucalib.report.document import Card, Text, Tone, Worth

TONES: dict[str, Tone] = {"explained": "ok", "suspected": "warning", "unexplained": "warning"}


def fleet_card(fleet: Fleet) -> Card:
    """Errors are on positions that were left out, by what the other devices say."""
    return Card(_worth(fleet), _found(fleet), _to_do(fleet), fleet.request.command)


def _worth(fleet: Fleet) -> tuple[Worth, ...]:
    members = [m for m in fleet.members if np.isfinite(m.final)]
    if not members:
        return ()
    worst = max(members, key=lambda m: m.final)
    how = "rms on positions held out"
    one = Worth("the worst device", f"{worst.final:.3g} mg",
                f"{worst.name}, {how}; alone {worst.base:.3g}")  # fmt: skip
    gain = fleet.difference
    if gain is None:
        return (one,)
    detail = f"{how}; each alone {gain.before:.3g}"
    return (Worth("all devices", f"{gain.after:.3g} mg", detail), one)


def _found(fleet: Fleet) -> tuple[Text, ...]:
    tone = TONES.get(fleet.verdict, "plain")
    lines = [
        Text(
            f"{one.effect.replace('_', ' ').capitalize()}, in every device with a size of its own: "
            f"{int(np.sum(one.nats > 0.0))} of {len(one.able)} gain by what the others say"
            + (f"; or {' or '.join(one.rivals)}".replace("_", " ") if one.rivals else "") + ".",
            tone,
        )
        for one in fleet.search.found
    ]  # fmt: skip
    if not lines:
        lines.append(Text("Nothing that the devices share stands out beyond chance.", tone))
    if fleet.outliers:
        odd = dict.fromkeys(o.device for o in fleet.outliers)
        lines.append(Text(f"Not of the kind: {', '.join(odd)}.", "warning"))
    if fleet.failed:
        failed = ", ".join(name for name, _ in fleet.failed)
        lines.append(Text(f"Not calibrated: {failed}.", "bad"))
    return tuple(lines)


def _to_do(fleet: Fleet) -> tuple[str, ...]:
    steps = [
        f"Look at {name} by itself, then leave it out: another kind, another unit, or a fault."
        for name in dict.fromkeys(o.device for o in fleet.outliers)
    ]
    steps += [f"Mend {name}: {why}." for name, why in fleet.failed]
    if fleet.verdict in ("suspected", "unexplained"):
        steps.append("Record more devices, or more positions of each: `imucal design TABLE`.")
    steps.append(
        "Use each device's own: `imucal apply FOLDER/DEVICE/calibration.yaml RECORDING -o "
        "corrected.mcap`, FOLDER as -o names it."
    )
    if fleet.following:
        steps.append("Another device of the kind: `imucal lab TABLE --fleet FOLDER/fleet.yaml`.")
    return tuple(steps)
