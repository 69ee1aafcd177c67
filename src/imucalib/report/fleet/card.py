"""The card of a fleet: what a device is good to, what they share, and what to do."""

from __future__ import annotations

import numpy as np

from imucalib.cohort.fleet.outcome import Fleet
from imucalib.report.document import Card, Text, Tone, Worth

TONES: dict[str, Tone] = {"explained": "ok", "suspected": "warning", "unexplained": "warning"}


#: What an error of a device is an error of.
HOW = {
    "lab": "rms on positions held out",
    "actigraph": "rms of |a| of a posture, beside the walk of its bias",
}


def fleet_card(fleet: Fleet) -> Card:
    """Errors are on positions that were left out, by what the other devices say."""
    return Card(_worth(fleet), _found(fleet), _to_do(fleet), fleet.asked.command)


def _worth(fleet: Fleet) -> tuple[Worth, ...]:
    members = [m for m in fleet.members if np.isfinite(m.final)]
    if not members:
        return _differences(fleet)
    worst = max(members, key=lambda m: m.final)
    how = HOW[fleet.asked.calibrator]
    one = Worth("the worst device", f"{worst.final:.3g} mg",
                f"{worst.name}, {how}; alone {worst.base:.3g}")  # fmt: skip
    gain = fleet.difference
    if gain is None:
        return (one,)
    detail = f"{how}; each alone {gain.before:.3g}"
    return (Worth("all devices", f"{gain.after:.3g} mg", detail), one)


def _differences(fleet: Fleet) -> tuple[Worth, ...]:
    """Of devices that are compared alone: how much they differ, parameters of one unit together."""
    units = dict.fromkeys(s.unit for s in fleet.spreads)
    own = {u: np.array([s.scatter for s in fleet.spreads if s.unit == u]) for u in units}
    return tuple(
        Worth(
            f"{len(values)} {'shares' if unit == '1' else f'parameters in {unit}'}",
            f"{float(np.sqrt(np.mean(values**2))):.2g} {unit.removeprefix('1')}".rstrip(),
            "between devices, rms",
        )
        for unit, values in own.items()
    )


def _found(fleet: Fleet) -> tuple[Text, ...]:
    tone = TONES.get(fleet.verdict, "plain")
    lines = [
        Text(
            f"{one.effect.replace('_', ' ').capitalize()}, in every device with a size of its own: "
            f"{int(np.sum(one.nats > 0.0))} of {len(one.able)} gain by what the others say"
            + (f"; or {' or '.join(one.rivals)}".replace("_", " ") if one.rivals else "") + ".",
            tone,
        )
        for one in (fleet.search.found if fleet.search else ())
    ]  # fmt: skip
    if not lines:
        what = "Nothing that the devices share stands out beyond chance."
        if fleet.search and fleet.search.refused:
            what = "; ".join(f"{name} stands out, but {why}" for name, why in fleet.search.refused)
            what = f"{what[0].upper()}{what[1:]}."
        lines.append(Text(what if fleet.search else "No effect was searched for.", tone))
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
    steps += [f"Mend {name}: {why.rstrip('.')}." for name, why in fleet.failed]
    lab = fleet.asked.calibrator == "lab"
    if fleet.verdict in ("suspected", "unexplained"):
        more = "positions of each: `imucal design TABLE`" if lab else "recordings of each"
        steps.append(f"Record more devices, or more {more}.")
    if any(r.calibration for m in fleet.members for r in m.recordings):
        steps.append(
            "Use each device's own: `imucal apply FOLDER/DEVICE/calibration.yaml RECORDING -o "
            "corrected.mcap`, FOLDER as -o names it."
        )
    if fleet.following:
        what = "TABLE" if lab else "RECORDING"
        steps.append(
            f"Another device of the kind: `imucal {fleet.asked.calibrator} {what} --fleet "
            "FOLDER/fleet.yaml`."
        )
    return tuple(steps)
