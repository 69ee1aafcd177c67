"""What a search could not have found: effects that are absorbed by what is fitted, or too weak."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from imucalib.effects import known
from imucalib.effects.forms import in_words
from imucalib.posterior.closed_loop.found import Score
from imucalib.units import MG

#: λ that gives an 80 % chance of detection.
_SEEN = 4.7
#: m/s²; effects that do less to a reading are nobody's concern.
_LEAST = 0.1 * MG


@dataclass(frozen=True)
class Hidden:
    """An effect that may be there unseen. size : m/s², rms on a reading, of what it may do: at its
    typical size where it is absorbed, else where it would be found in four of five recordings."""

    name: str
    size: float
    absorbed: bool
    identify: str


def find_hidden(scores: Sequence[Score], present: Sequence[str] = ()) -> tuple[Hidden, ...]:
    """Effects of the sensor that may hide, largest first, absorbed ones before the others.

    present : those in the model
    """
    found = []
    for one in scores:
        effect = known(one.name)
        if effect is None or effect.stage == "fixture" or one.name in present:
            continue
        size = one.size_m_per_s2
        if not one.absorbed:
            size *= _SEEN / max(one.lambda_at_typical_size, 1e-12)
        if size >= _LEAST and "@" not in one.name:
            found.append(Hidden(one.name, size, one.absorbed, effect.identify))
    return tuple(sorted(found, key=lambda h: (not h.absorbed, -h.size)))


def advice_of(found: Sequence[Hidden]) -> tuple[str, ...]:
    """What to record, where something cannot be seen at all."""
    absorbed = [h for h in found if h.absorbed]
    if not absorbed:
        return ()
    first = absorbed[0]
    names = ", ".join(in_words(h.name) for h in absorbed)
    return (
        f"These data cannot show {names}, whatever the size ({first.size / MG:.2g} mg rms at a "
        f"typical one). {first.identify}",
    )
