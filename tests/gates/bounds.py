"""How many bad runs a test may allow, from the rate that is due: exact binomial tails."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.optimize import brentq
from scipy.stats import binom

#: Chance that a gate fails although the rate is what is due, and with which it fails at the rate
#: that it claims to see. Seeds are fixed, so chance is drawn once a change of the code, not a run.
CHANCE, POWER = 0.02, 0.8
#: No gate passes a rate of four times what is due.
WORSE = 4.0


@dataclass(frozen=True)
class Gate:
    """At most `most` of `runs` may be bad, where each is bad at a rate of `due`."""

    runs: int
    due: float
    most: int

    @property
    def false_failure(self) -> float:
        """Chance of more than `most` at the rate that is due."""
        return float(binom.sf(self.most, self.runs, self.due))

    @property
    def seen(self) -> float:
        """The rate at which it fails with a chance of `POWER`."""
        return float(brentq(lambda p: binom.sf(self.most, self.runs, p) - POWER, 1e-9, 1.0 - 1e-9))


def at_most(runs: int, due: float) -> Gate:
    """The strictest gate that chance alone seldom fails.

    Raises ValueError where a rate of four times `due` would pass it: then it needs more runs.
    """
    gate = Gate(runs, due, int(binom.isf(CHANCE, runs, due)))
    if gate.seen > WORSE * due:
        raise ValueError(
            f"{runs} runs see {gate.seen:.3g} at best, {WORSE:g} times {due:g} is {WORSE * due:g}: "
            "make more runs"
        )
    return gate
