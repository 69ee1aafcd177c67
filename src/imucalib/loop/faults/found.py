"""What a fault is: where, how sure, and the line that repairs it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from imucalib.loop.faults.sheet import Sheet
from imucalib.significant_digits import per_cent

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
    score : nats beyond the sheet as it stands, at first glance
    line : options of `imucal lab` that repair it; probability : that it is so, where it was solved
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
    probability: float = math.nan

    @property
    def where(self) -> str:
        """The rows in words."""
        first, last = self.rows[0], self.rows[-1]
        return f"row {first}" if first == last else f"rows {first} to {last}"

    @property
    def sentence(self) -> str:
        """What, and what to paste."""
        sure = "" if math.isnan(self.probability) else f" ({per_cent(self.probability)})"
        rivals = f" (or: {'; '.join(self.rivals)})" if self.rivals else ""
        return f"{self.what}{sure}; decide with {self.line}{rivals}"


@dataclass(frozen=True)
class Hypothesis:
    """A fault that was tried, and the sheet that its repair would give; its score is what it gains
    at first glance, with `prior`, the log odds of its class and place."""

    fault: Fault
    repaired: Sheet
    prior: float = 0.0
