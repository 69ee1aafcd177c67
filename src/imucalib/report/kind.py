"""What a fleet told of the device, and what its own rows have added."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.population import Population
from imucalib.core.fit import Fit
from imucalib.report.document import Section, Table, Text
from imucalib.significant_digits import plus_minus, probability


def kind_section(
    kind: Population | None, fit: Fit, strange: float, what: str, alone: Fit | None = None
) -> Section:
    """Empty without a fleet. strange : chance that one of the kind is as far from it; what : was
    recorded, in words; alone : the fit without the fleet, where there is one"""
    prior = fit.prior
    if kind is None or prior is None:
        return Section("The fleet's word", ())
    own = {} if alone is None else dict(zip((p.name for p in alone.parameters), alone.sd,
                                            strict=True))  # fmt: skip
    before = np.sqrt(np.diag(prior.covariance))
    rows = tuple(
        (
            p.name.replace("_", " "),
            plus_minus(float(m), float(b), p.unit),
            plus_minus(float(v), float(s), p.unit),
            f"{100.0 * max(0.0, 1.0 - (s / b) ** 2):.0f}",
            *(
                (
                    f"{own[p.name]:.2g} {p.unit.removeprefix('1')}".rstrip()
                    if p.name in own
                    else "-",
                )
                if own
                else ()
            ),
        )
        for p, m, b, v, s in zip(fit.parameters, prior.mean, before, fit.theta, fit.sd, strict=True)
    )
    count = fit.observations.n
    chance = probability(strange, 999)
    own_rows = f"{count} {what}{'s' * (count != 1)}"
    words = (
        f"{kind.devices} devices of its kind say what to expect, {own_rows} of this one the rest. "
        f"Chance that one of the kind is as far from the others: {chance}."
    )
    table = Table(
        "",
        ("", "of its kind", "this device", "from its own, %", *(("sd without",) if own else ())),
        rows, "lrrr" + "r" * bool(own),
        "From its own: share of the variance of its kind that its data have taken away."
        + (" Without: by its own data and the typical sizes alone." if own else ""),
    )  # fmt: skip
    return Section("The fleet's word", (Text(words, "plain"), table))
