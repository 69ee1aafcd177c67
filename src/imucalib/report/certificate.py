"""What a calibration states of one instrument, as the first page that a report prints.

Terms after JCGM 100:2008 (GUM): standard uncertainty u, expanded uncertainty U = k u.
"""

from __future__ import annotations

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.outcome import Outcome
from imucalib.report.document import Card, Certificate, Facts, Table
from imucalib.significant_digits import with_sd

#: Coverage factor k of what is printed: about 95 % (GUM, 6.3.3).
COVERAGE = 2.0
#: Parameters that a page has room for.
_ROOM = 16
_REFERENCES = {
    "vector": "the inclination and tool-face that each position was set to",
    "direction": "the direction of gravity in each position",
    "norm": "the size of gravity at rest",
    "actigraph": "the size of gravity at rest",
    "imu": "the size of gravity at rest, and its direction carried over turns",
    "array": "the size of gravity at rest, and the array's own motion",
}


def certificate_of(calibration: Calibration, outcome: Outcome, card: Card) -> Certificate:
    """Device, date, reference, conditions, method and input; every parameter of the sensor with U,
    where a page has room for them, else what the card promises alone."""
    made, settings = outcome.provenance, outcome.provenance.settings
    kind = str(settings.get("reference", calibration.calibrator))
    reference = _REFERENCES.get(kind, calibration.calibrator)
    source = settings.get("gravity_source")
    gravity = f"; local gravity {calibration.gravity:.5f} m/s²" + (f" ({source})" if source else "")
    effects = dict.fromkeys(p.effect.replace("_", " ") for p in calibration.parameters)
    facts = [
        ("instrument", f"of {made.path}; readings in {calibration.raw_unit}"),
        ("calibrated", made.time),
        ("reference", reference + gravity),
        ("conditions", "; ".join(_conditions(calibration, made.samples))),
        ("method", f"imucal {calibration.calibrator}, least squares with {', '.join(effects)}"),
        ("software", ", ".join(f"{name} {value}" for name, value in made.versions.items())),
        ("input, sha256", made.sha256),
        *((worth.quantity, f"{worth.value} ({worth.detail})") for worth in card.good_to),
    ]
    own = [p for p in calibration.parameters if p.stage != "fixture"]
    shown = own if len(own) <= _ROOM else []
    rows = tuple(
        (p.name.replace("_", " "), *with_sd(p.value, COVERAGE * p.sd), p.unit) for p in shown
    )
    note = f"U: expanded uncertainty, k = {COVERAGE:g}, about 95 %."
    return Certificate(
        Facts(tuple(facts)), Table("Results", ("", "value", "U", "unit"), rows, "lrrl", note)
    )


def _conditions(calibration: Calibration, samples: int) -> list[str]:
    """How much was recorded, and in which range of what the correction follows."""
    units = {"temperature": " °C", "time": " s"}
    ranges = [
        f"{name} {low:.4g} to {high:.4g}{units.get(name, '')}"
        for name, (low, high) in calibration.valid.items()
    ]
    known = ranges if "temperature" in calibration.valid else [*ranges, "temperature not recorded"]
    return [f"{samples} readings", *known]
