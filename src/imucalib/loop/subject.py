"""What the closed loop asks of a problem, and the loop itself: bench, wrist and array alike.

A subject is where one problem stands: what is in its model, and how well that fits. It is
immutable; whatever is done to it gives another one. How it fits and scores is its own affair: by
dense columns, or by Gram matrices accumulated over a motion.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

from imucalib.loop.evidence import Score
from imucalib.loop.found import LoopSettings, Step


@dataclass(frozen=True)
class Searched:
    """scores : of everything that could be missing, best first; missing : why effects could not be
    tested."""

    scores: tuple[Score, ...]
    missing: Mapping[str, str]


@dataclass(frozen=True)
class Refused:
    """An effect that was not taken, or the scan that it belongs to, and the reason; by_data :
    whether data that it was not fitted to speak against it, as they do where chance made it."""

    name: str
    reason: str
    by_data: bool = False


class Subject(Protocol):
    """One problem as the loop sees it."""

    @property
    def steps(self) -> tuple[Step, ...]:
        """What was taken in, in order."""
        ...

    def search(self, rejected: Collection[str]) -> Searched:
        """Score everything that could be missing, but for what was rejected."""
        ...

    def choice(self, found: Searched, rejected: Collection[str]) -> Score | None:
        """The effect to try next, if any stands out."""
        ...

    def cleaner(
        self, found: Searched, chosen: Score | None, rejected: Collection[str]
    ) -> Self | None:
        """What comes before the chosen effect: a wrong record set aside, a clock found."""
        ...

    def tried(self, found: Searched, chosen: Score, rejected: Collection[str]) -> Self | Refused:
        """With the effect, refitted; or why it must not be taken."""
        ...

    def smoothed(self, found: Searched) -> Self | None:
        """With the strongest structure without a name corrected by a curve that holds out."""
        ...

    def eliminated(self) -> Self:
        """Without what later steps have made unnecessary."""
        ...


S = TypeVar("S", bound=Subject)


@dataclass(frozen=True)
class End(Generic[S]):
    """Where the search ended. first, last : the last search before any step, and that at the end;
    rejected : effects that were not taken, by name."""

    subject: S
    rejected: Mapping[str, Refused]
    first: Searched
    last: Searched

    @property
    def reasons(self) -> tuple[tuple[str, str], ...]:
        """Name and reason of every effect that was not taken."""
        return tuple((name, refused.reason) for name, refused in self.rejected.items())


def close(subject: S, rules: LoopSettings) -> End[S]:
    """Search, take what stands out and holds, refit, until nothing does.

    What was not taken is tried again beside what was taken after it: a missing effect can be what
    spoke against another.
    """
    rejected: dict[str, Refused] = {}
    beside: dict[str, S] = {}
    first = found = subject.search(rejected)
    while True:
        chosen = subject.choice(found, rejected)
        following = subject.cleaner(found, chosen, rejected)
        if following is None and chosen is not None:
            tried = subject.tried(found, chosen, rejected)
            if isinstance(tried, Refused):
                rejected[tried.name], beside[tried.name] = tried, subject
                tried = subject
            following = tried
        elif following is None:
            following = subject.smoothed(found) if rules.curves else None
        if following is None:
            before = [name for name in rejected if beside[name].steps != subject.steps]
            if not before:
                return End(subject.eliminated(), rejected, first, found)
            for name in before:
                del rejected[name]
            following = subject
        subject = following
        found = subject.search(rejected)
        first = first if subject.steps else found
