"""What a fleet told of the device, and what its own rows have added."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.lab.calibrate import LabResult
from imucalib.report.document import Section, Table, Text
from imucalib.significant_digits import plus_minus, probability


def kind_section(result: LabResult) -> Section:
    """Empty without a fleet."""
    kind, prior = result.settings.population, result.final.prior
    if kind is None or prior is None:
        return Section("The fleet's word", ())
    fit = result.final
    before = np.sqrt(np.diag(prior.covariance))
    rows = tuple(
        (
            p.name.replace("_", " "),
            plus_minus(float(m), float(b), p.unit),
            plus_minus(float(v), float(s), p.unit),
            f"{100.0 * max(0.0, 1.0 - (s / b) ** 2):.0f}",
        )
        for p, m, b, v, s in zip(fit.parameters, prior.mean, before, fit.theta, fit.sd, strict=True)
    )
    count = fit.observations.n
    chance = probability(result.strange, 999)
    words = (
        f"{kind.devices} devices of its kind say what to expect, {count} positions of this one the "
        f"rest. Chance that one of the kind is as far from the others: {chance}."
    )
    table = Table(
        "", ("", "of its kind", "this device", "from its own rows, %"), rows, "lrrr",
        "From its own rows: share of the variance of its kind that they have taken away.",
    )  # fmt: skip
    return Section("The fleet's word", (Text(words, "plain"), table))
