"""What the closed loop is asked for, and what it found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from imucalib.evidence import Score
from imucalib.fit import Fit
from imucalib.record_errors import RecordError


@dataclass(frozen=True)
class LoopSettings:
    """alpha : family-wise false-alarm rate of the physics search; record_alpha : of the record
    search; margin : nats by which a probe must beat the best catalogue effect; draws : simulated
    data sets per search"""

    alpha: float = 0.04
    record_alpha: float = 0.01
    margin: float = 3.0
    draws: int = 1000
    most_effects: int = 4
    most_records: int = 4
    #: records are searched one by one up to so many observations
    searchable: int = 500
    #: candidates are scored on at most so many observations
    most_scored: int = 4000


@dataclass(frozen=True)
class Step:
    """One accepted effect. Held-out errors are rms in m/s²."""

    effect: str
    p: float
    draws: int
    evidence: float
    held_out_before: float
    held_out_after: float
    aliases: tuple[str, ...]


@dataclass(frozen=True)
class Unexplained:
    """Structure that no catalogue effect carries. share : of the weighted residual power."""

    name: str
    driver: str
    kind: str
    p: float
    evidence: float
    share: float


@dataclass(frozen=True)
class Loop:
    """The whole search.

    base, final : fits before and after; records are free in both once they are set aside
    plain, as_recorded : the base and the final model with every record taken as it stands
    scores : the last search's table; missing : why effects could not be tested
    """

    base: Fit
    final: Fit
    plain: Fit
    as_recorded: Fit
    records: tuple[RecordError, ...] = ()
    steps: tuple[Step, ...] = ()
    rejected: tuple[tuple[str, str], ...] = ()
    unexplained: tuple[Unexplained, ...] = ()
    scores: tuple[Score, ...] = ()
    first_scores: tuple[Score, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        if self.steps or self.records:
            return "explained in part" if self.unexplained else "explained"
        return "unexplained" if self.unexplained else "nothing missing"
