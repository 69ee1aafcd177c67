"""How large a term of the array's model is, in words, and what it is worth in nats."""

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


def worth(state: ArrayState, term: Term) -> float:
    """Evidence (nats) of a term beside all others, from the joint covariance."""
    at = state.positions
    for other in state.terms:
        if other.name == term.name:
            break
        at += len(other.value)
    part = slice(at, at + len(term.value))
    precision = np.linalg.inv(state.covariance[part, part])
    log_ratio = np.linalg.slogdet(precision * np.outer(term.sd, term.sd))[1]
    return float(0.5 * term.value @ precision @ term.value - 0.5 * log_ratio)
