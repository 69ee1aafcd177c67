"""An effect's size in words, and sizes that are not believed."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.terms import Term
from imucalib.significant_digits import plus_minus


def size_in_words(state: ArrayState, term: Term) -> str:
    """The one value with its deviation, or the rms of many."""
    parameters = term.parameters(state.setup.imus)
    sd = state.sd_of(term)
    units = {p.unit for p in parameters}
    if len(parameters) == 1:
        return plus_minus(float(term.theta[0]), float(sd[0]), parameters[0].unit)
    if len(parameters) <= 3:
        values = ", ".join(f"{v:.3g}" for v in term.theta)
        return f"{values} {parameters[0].unit}"
    rms = float(np.sqrt(np.mean(term.theta**2)))
    return f"{rms:.2g} {units.pop()} rms, {term.live.shape[1]} of {len(parameters)} determined"
