"""The certificate: what a calibration states of one instrument, for print and signature.

Its terms are those of JCGM 100:2008 (GUM): standard uncertainty u, expanded uncertainty U = k u.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.outcome import Run
from imucalib.effects.forms import in_words
from imucalib.report.render.document import Card, Facts, Section, Table
from imucalib.significant_digits import format_with_sd
from imucalib.units import MG

#: Coverage factor k: about 95 % (GUM, 6.3.3).
_COVERAGE = 2.0
#: Rows of a table that is printed whole.
_ROWS = 200
#: Of an effect whose parameters have no meaning one by one.
_CURVE = "curve@"
#: A place to write in by hand.
_BLANK = "_" * 24
_REFERENCES = {
    "vector": "the inclination and tool-face that each position was set to",
    "direction": "the direction of gravity in each position",
    "norm": "the size of gravity at rest",
    "actigraph": "the size of gravity at rest",
    "imu": "the size of gravity at rest, and its direction carried over turns",
    "array": "the size of gravity at rest, and the array's own motion",
}


def certify(run: Run, card: Card) -> Section | None:
    """Device, date, reference, conditions, method, input and what of it was changed or left out;
    every parameter with U, but for the terms of curves; each position raw and corrected. None of a
    run that is not decided: nobody signs two answers."""
    outcome, calibration = run.outcome, run.calibration
    if outcome.undecided or not (outcome.fit is None or outcome.fit.converged):
        return None
    made, settings = outcome.provenance, outcome.provenance.settings
    kind = str(settings.get("reference", calibration.calibrator))
    source = str(settings.get("gravity_source") or "").partition(";")[0]  # without what to type
    gravity = f"; local gravity {calibration.gravity:.5f} m/s²" + (f" ({source})" if source else "")
    effects = dict.fromkeys(in_words(p.effect) for p in calibration.parameters)
    facts = [
        ("instrument", str(outcome.sensor) if outcome.sensor.name else _BLANK),
        ("serial number", outcome.sensor.serial or _BLANK),
        ("readings", f"in {calibration.raw_unit}"),
        ("calibrated", made.time),
        ("reference", _REFERENCES.get(kind, calibration.calibrator) + gravity),
        ("conditions", "; ".join(_conditions(calibration, made.samples))),
        ("method", f"imucal {calibration.calibrator}, posterior with {', '.join(effects)}"),
        ("software", ", ".join(f"{name} {value}" for name, value in made.versions.items())),
        ("input", made.input),
        ("input, sha256", made.sha256),
        ("changed by hand", _list_changes(settings)),
        ("left out", "; ".join(map(str, getattr(run.details, "left_out", ()))) or "nothing"),
        *((worth.quantity, f"{worth.value} ({worth.detail})") for worth in card.good_to),
        ("calibrated by", f"{_BLANK}   date, signature {_BLANK}"),
        ("approved by", f"{_BLANK}   date, signature {_BLANK}"),
    ]
    own = [p for p in calibration.parameters if p.stage != "fixture"]
    curves = Counter(in_words(p.effect) for p in own if p.effect.startswith(_CURVE))
    rows = tuple(
        (p.name.replace("_", " "), *format_with_sd(p.value, _COVERAGE * p.sd), p.unit)
        for p in own
        if not p.effect.startswith(_CURVE)
    )
    note = f"U: expanded uncertainty, k = {_COVERAGE:g}, about 95 %."
    if curves:
        terms = ", ".join(f"{name} ({count} terms)" for name, count in curves.items())
        note += f" In calibration.yaml only: {terms}."
    results = Table("Results", ("", "value", "U", "unit"), rows, "lrrl", note)
    return Section("Calibration certificate", (Facts(tuple(facts)), results, *_positions(run)))


def _list_changes(settings: Mapping[str, Any]) -> str:
    """What somebody has changed of what the file says."""
    said = [str(one) for one in settings.get("fix") or ()]
    said += [f"{name}: {value}" for name, value in (settings.get("repairs") or {}).items()]
    return "; ".join(said) or "nothing"


def _positions(run: Run) -> tuple[Table, ...]:
    """Every position as read and as corrected; nothing where they are not of one sensor, or more
    than a page of paper serves."""
    fit, unit = run.outcome.fit, run.calibration.raw_unit
    if fit is None or fit.observations.reading.shape[1] > 1 or fit.observations.n > _ROWS:
        return ()
    seen, zero = fit.observations, np.array(run.outcome.sensor.zero or (0.0,))
    raw = seen.reading[:, 0] / run.calibration.raw_to_si + zero
    corrected = fit.model.correct(fit.theta, seen.reading, seen.context)[:, 0] / MG
    rows = tuple(
        (name, *(f"{v:.7g}" for v in one), *(f"{v:.1f}" for v in two))
        for name, one, two in zip(seen.label, raw, np.asarray(corrected), strict=True)
    )
    header = ("", *(f"{a}, {unit}" for a in "xyz"), *(f"corrected {a}, mg" for a in "xyz"))
    note = "Corrected: specific force in thousandths of standard gravity."
    return (Table("Positions, as read and as corrected", header, rows, "lrrrrrr", note),)


def _conditions(calibration: Calibration, samples: int) -> list[str]:
    """How much was recorded, and in which range of what the correction follows."""
    units = {"temperature": " °C", "time": " s"}
    ranges = [
        f"{name} {low:.7g} to {high:.7g}{units.get(name, '')}"
        for name, (low, high) in calibration.valid.items()
    ]
    unknown = ["temperature not recorded"] * ("temperature" not in calibration.valid)
    return [f"{samples} readings", *ranges, *unknown]
