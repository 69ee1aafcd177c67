"""A free function of the response may stand for two names at once: the look one step ahead."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from imucalib.loop.wander.bank import Bank, Mask
from imucalib.loop.wander.likelihood import Level, Terms, best_level
from imucalib.loop.wander.scores import Entry, Scored, scored


def ahead_of(
    bank: Bank,
    terms: Terms,
    keep: Mask,
    free: Scored,
    *,
    named: Sequence[tuple[Scored, float]],
    entries: Sequence[Entry],
    walks: Callable[[Bank, Level], tuple[int, ...]],
) -> Scored | None:
    """The name that with the next one explains as much as a free function does alone, or None.

    Both are gains over the same model, with all sizes under priors, so that their evidence compares
    as it stands.

    named : names that hold out, with their prior sizes; entries : what may come next
    """
    if not free.entry.free:
        return None
    following = [e for e in entries if e.of_response and not e.free]
    best, most = None, free.evidence
    for name, size in named:
        others = [e for e in following if e.name != name.entry.name]
        if name.entry.free or not name.entry.of_response or not others:
            continue
        beside = terms.plus(name.entry.columns, size)
        usable = walks(bank, best_level(bank, beside, keep))
        scores, _ = scored(bank, beside, keep, others, usable, told=False)
        if (both := name.evidence + scores[0].evidence) >= most:
            best, most = name, both
    return best
