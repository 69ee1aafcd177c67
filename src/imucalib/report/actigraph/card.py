"""What a worn sensor's calibration is good to: |a| at rest, and in the worst direction."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.actigraph.errors import norm_sd
from imucalib.calibrators.actigraph.run import ActigraphRun
from imucalib.core.sphere import covered, even_directions
from imucalib.report.card import card_of, error_worth, like_these
from imucalib.report.document import Card, Worth
from imucalib.significant_digits import two_digits
from imucalib.units import MG


def actigraph_card(run: ActigraphRun) -> Card:
    """The card of a worn sensor."""
    directions = even_directions()
    sd = norm_sd(run.result.final, directions) / MG
    k = int(np.argmax(sd))
    towards = ", ".join(f"{a} {v:+.1f}" for a, v in zip("xyz", directions[k], strict=True))
    worst = Worth(
        "|a|, worst attitude",
        f"± {1.96 * sd[k]:.2g} mg",
        f"95 %, with gravity along {towards}; {1.96 * sd.mean():.2g} mg on average over all",
    )
    seen = covered(run.result.runs.mean)
    first = error_worth(run.outcome.error, "|a| at rest", "time", like_these("postures", seen))
    return card_of(run.outcome, (first, worst, *_night(run)))


def _night(run: ActigraphRun) -> tuple[Worth, ...]:
    """What the calibration does to ENMO, where night can be told from day."""
    enmo = run.activity.enmo if run.activity else {}
    if "night" not in enmo or "day" not in enmo:
        return ()
    (raw, now), (by_day, now_by_day) = enmo["night"], enmo["day"]
    detail = f"raw reading {raw:.2g}; by day {by_day:.2g} raw, {now_by_day:.2g} corrected"
    return (Worth("ENMO at night", f"{two_digits(now)} mg", detail),)
