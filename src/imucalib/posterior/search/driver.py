"""The one driver of all searches: linearise, search, refit with what is told, until it stands.

What a model lacks moves the point of linearisation, and what the noise seems to be beside it, so
that a search is asked again where its answer stands.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

S = TypeVar("S")
F = TypeVar("F")


@dataclass(frozen=True)
class Settled(Generic[S, F]):
    """state : holds what is told, unless its refit was refused; found : by the last search"""

    state: S
    found: F
    refused: bool = False


def search_until_settled(
    state: S,
    search: Callable[[S], F],
    refit: Callable[[S, F], tuple[S, bool] | None],
    *,
    told: Callable[[F], Hashable],
    held: Callable[[S], Hashable],
    rounds: int,
) -> Settled[S, F]:
    """Search from a state, and again from its refit, until the same is told twice in a row, or what
    the state holds: then nothing is refitted, be it that the last refit did not hold all of it.

    state : where the first search stands
    search : what is found at the linearisation where a state stands
    refit : the state with what is found in it, its aliases told apart, and whether it is where the
        search foretold it to be, so that another would say the same; None where no fit settles
    told, held : what is told of what was found, and what a state holds of such, in the same terms
    rounds : searches at most, one or more; what the last one tells is refitted too

    What an earlier search told and a later one left is no standstill but a round trip: it is
    refitted, so that what is told and what is fitted are the same, and the search ends. What the
    first state held was told by none.
    """
    last, seen = held(state), set[Hashable]()
    while True:
        found = search(state)
        own, rounds = told(found), rounds - 1
        if own in (last, held(state)):
            return Settled(state, found)
        refitted = refit(state, found)
        if refitted is None:
            return Settled(state, found, refused=True)
        state, foretold = refitted
        if foretold or own in seen or not rounds:
            return Settled(state, found)
        seen.add(own)
        last = own
        del found  # its products are most of the memory
