"""The held-out difference as a picture: before, after, and the gain with its interval."""

from __future__ import annotations

import math

import numpy as np

from imucalib.calibration.findings import Findings, Gain
from imucalib.effects.shape import in_words
from imucalib.report.document import Plot, Series
from imucalib.significant_digits import per_cent


def gain_plot(found: Findings | None) -> tuple[Plot, ...]:
    """One plot where held-out data say what a step is worth; empty where they do not."""
    gain = found.gain if found else None
    if gain is None:
        return ()
    known = np.full(2, np.nan)
    bars = Series(
        "held out", np.arange(3.0), np.array([gain.before, gain.after, gain.before - gain.after]),
        "bars", np.append(known, gain.low), np.append(known, gain.high),
        names=("before", "after", "gain, 95 %"),
    )  # fmt: skip
    words = "excludes" if gain.low > 0.0 else "includes"
    caption = f"On data that took no part in any choice. The interval of the gain {words} zero"
    caption += "." if math.isnan(gain.nats) else f"; {density_words(gain)}."
    return (Plot("What the search is worth", "", f"error ({gain.unit})", (bars,), caption),)


def density_words(gain: Gain) -> str:
    """What the log density of held-out data gains, where it was judged."""
    return f"in log density {gain.nats:+.1f} nats, at least {gain.nats_low:+.1f}"


#: Probability from which on something that is not told is likely enough to be named, and how many.
_LIKELY, _NAMED = 0.1, 2


def likeliest_words(found: Findings) -> str:
    """What nothing missing may turn out to be, with the probability of each, or nothing."""
    likely = [s for s in found.scores if 1.0 - s.p > _LIKELY][:_NAMED]
    words = ", ".join(f"{in_words(s.name)} {per_cent(1.0 - s.p)}" for s in likely)
    return f"; the likeliest that could be: {words}" if words else ""


def refuted_words(found: Findings) -> str:
    """Why nothing was taken where nothing is left."""
    if not found.refuted or found.gain is None:
        return "no candidate passes the search"
    g, names = found.gain, " and ".join(map(in_words, found.refuted))
    return (
        f"{names} stood out by more than chance, but not on data that took no part "
        f"({g.before:.3g} {g.unit} without, {g.after:.3g} with)"
    )
