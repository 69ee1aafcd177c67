"""What a fault is: where, how sure, and the line that repairs it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from imucalib.loop.faults.sheet import Sheet

Kind = Literal[
    "exchange", "move", "shift", "cell", "angle", "setting", "axes", "convention", "record"
]

#: Nats beyond the sheet as it stands, the number of hypotheses of the class paid: below, nothing is
#: said. Hypotheses that are not farther apart than this are named together.
ENOUGH = 5.0


@dataclass(frozen=True)
class Fault:
    """One slip of hand.

    what : the sentence; rows : numbers of the sheet's rows that it touches, none for the whole
    score : nats beyond the sheet as it stands; line : options of `imucal lab` that repair it
    rivals : lines that explain the sheet as well, within 5 nats
    cells : of a wrong cell, each column and the value that it should hold, in the sheet's unit
    """

    kind: Kind
    what: str
    rows: tuple[int, ...]
    score: float
    line: str
    rivals: tuple[str, ...] = ()
    cells: tuple[tuple[str, float], ...] = ()

    @property
    def sentence(self) -> str:
        """What, and what to paste."""
        rivals = f" (or: {'; '.join(self.rivals)})" if self.rivals else ""
        return f"{self.what}; decide with {self.line}{rivals}"


@dataclass(frozen=True)
class Hypothesis:
    """A fault that was tried, and the sheet that its repair would give."""

    fault: Fault
    repaired: Sheet


def with_rivals(every: list[Hypothesis]) -> Hypothesis | None:
    """The best of all that were tried, its rivals named; None when nothing is sure enough."""
    ranked = sorted(every, key=lambda h: -h.fault.score)
    if not ranked or ranked[0].fault.score <= ENOUGH:
        return None
    best = ranked[0]
    near = [
        h.fault.line
        for h in ranked[1:]
        if h.fault.score > max(ENOUGH, best.fault.score - ENOUGH)
        and h.fault.line != best.fault.line
    ]
    return replace(best, fault=replace(best.fault, rivals=tuple(dict.fromkeys(near))[:4]))
