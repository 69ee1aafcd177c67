"""What a posterior says of every component by itself: for tables, and for what could hide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from imucalib.loop.thresholds import ABSORBED

Kind = Literal["effect", "probe"]


@dataclass(frozen=True)
class Score:
    """What the data say of one component.

    kind : whether it names a cause; driver : what it follows, in words, or empty
    evidence : nats in favour, beside the base model alone; p : that it is not there
    left : share of its columns that the fitted parameters do not absorb (0..1)
    strength : λ, the length of its projected columns at typical size, in noise units: 4.7 gives
        an 80 % chance of detection
    size : m/s², rms of the whole block on an observation: what an absorbed effect of typical size
        does to the answer without a trace in the residual
    """

    name: str
    kind: Kind
    driver: str
    evidence: float
    p: float
    left: float
    strength: float
    size: float = 0.0

    @property
    def absorbed(self) -> bool:
        return self.left < ABSORBED
