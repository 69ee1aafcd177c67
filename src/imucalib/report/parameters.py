"""Tables of a calibration's numbers: parameters, the sensor's linear part, what a fleet says."""

from __future__ import annotations

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.calibrators.population import Population
from imucalib.core.fit import Fit
from imucalib.report.document import Facts, Section, Table, Text
from imucalib.significant_digits import (
    plus_minus,
    probability,
    signed_components,
    size_with_unit,
    with_sd,
)
from imucalib.units import MG


def parameter_table(calibration: Calibration, note: str) -> Table:
    """Every parameter with its standard deviation."""
    rows = tuple(
        (p.name, p.effect, *with_sd(p.value, p.sd), p.unit) for p in calibration.parameters
    )
    return Table("Parameters", ("parameter", "effect", "value", "sd", "unit"), rows, "llrrl", note)


def sensor_section(calibration: Calibration, *more: Table) -> Section:
    """M, b and the scales, and the angles between the sensing axes."""
    linear = calibration.matrices()
    rows = tuple(
        (
            letter,
            signed_components(linear.M[k], 6),
            f"{linear.b[k] / MG:+.3f}",
            *with_sd(linear.scale[k], linear.scale_sd[k]),
        )
        for k, letter in enumerate("xyz")
    )
    header = ("axis", "M", "b, mg", "scale", "sd")
    note = "The linear part. Scale: sensitivity of each axis, free of the frame."
    table = Table("corrected = M raw + b", header, rows, "llrrr", note)
    angles = zip(("xy", "xz", "yz"), linear.angle, linear.angle_sd, strict=True)
    facts = Facts(tuple((f"angle {p}", plus_minus(a, s, "deg")) for p, a, s in angles))
    return Section("The sensor", (table, facts, *more), brief=False)


def kind_section(
    kind: Population | None, fit: Fit, chance: float, what: str, alone: Fit | None = None
) -> Section:
    """Empty without a fleet. chance : that one of the kind is as far from it; what : was recorded,
    in words; alone : the fit without the fleet, where there is one"""
    prior = fit.prior
    if kind is None or prior is None:
        return Section("The fleet's word", ())
    own = {p.name: sd for p, sd in zip(alone.parameters, alone.sd, strict=True)} if alone else {}
    before = np.sqrt(np.diag(prior.covariance))
    rows = []
    for p, m, b, v, s in zip(fit.parameters, prior.mean, before, fit.theta, fit.sd, strict=True):
        cells = [plus_minus(m, b, p.unit), plus_minus(v, s, p.unit)]
        cells.append(f"{100.0 * max(0.0, 1.0 - (s / b) ** 2):.0f}")
        if own:
            cells.append(size_with_unit(own[p.name], p.unit) if p.name in own else "-")
        rows.append((p.name.replace("_", " "), *cells))
    count = fit.observations.n
    words = (
        f"{kind.devices} devices of its kind say what to expect, {count} {what}"
        f"{'s' * (count != 1)} of this one the rest. Chance that one of the kind is as far from "
        f"the others: {probability(chance, 999)}."
    )
    header = ("", "of its kind", "this device", "from its own, %", *["sd without"] * bool(own))
    note = "From its own: share of the variance of its kind that its data have taken away."
    note += " Without: by its own data and the typical sizes alone." if own else ""
    table = Table("", header, tuple(rows), "", note)
    return Section("The fleet's word", (Text(words), table))
