"""What the array's closed loop found."""

from __future__ import annotations

from dataclasses import dataclass, field

from imucalib.calibrators.array.ages import Ages
from imucalib.calibrators.array.declared import NOTHING_ASKED, Asked
from imucalib.calibrators.array.held_out import Residuals
from imucalib.calibrators.array.state import ArrayState
from imucalib.loop.evidence import Score
from imucalib.loop.found import Unexplained

CURVE = "curve of "  # how the name of a correction without a cause begins
_CERTAIN = 0.01  # family-wise p from which on an effect without aliases is called certain


@dataclass(frozen=True)
class ArrayStep:
    """One accepted effect. value : its size in words; held_out : nats that the two halves gain;
    before, after : held-out residuals"""

    effect: str
    value: str
    p: float
    draws: int
    evidence: float
    held_out: tuple[float, float]
    before: Residuals
    after: Residuals
    aliases: tuple[str, ...]

    @property
    def curve(self) -> bool:
        """Whether it is a smooth correction of structure that has no name."""
        return self.effect.startswith(CURVE)

    @property
    def certain(self) -> bool:
        """Nothing else would do as well, and chance would not do it in a hundred searches."""
        return not self.aliases and not self.curve and self.p <= _CERTAIN


@dataclass(frozen=True)
class ArrayLoop:
    """The whole search.

    unexplained : structure that no effect carries, also where a curve corrects it
    base, final : fitted states before and after; ages : clocks of the gyros, or None
    before, after : held-out residuals; scores : of the last search; absorbed : what cannot be seen,
    with the m rms by which its typical size moves the positions; dispersion : how many times fewer
    accelerometer samples the noise that neighbours share leaves; asked : what the user declared
    """

    base: ArrayState
    final: ArrayState
    ages: Ages | None
    before: Residuals
    after: Residuals
    steps: tuple[ArrayStep, ...]
    rejected: tuple[tuple[str, str], ...]
    unexplained: tuple[Unexplained, ...]
    scores: tuple[Score, ...]
    first_scores: tuple[Score, ...]
    absorbed: dict[str, float]
    dispersion: float
    missing: dict[str, str] = field(default_factory=dict)
    asked: Asked = NOTHING_ASKED

    @property
    def verdict(self) -> str:
        if any(not step.curve for step in self.steps):
            return "explained in part" if self.unexplained else "explained"
        return "unexplained" if self.unexplained else "nothing missing"
