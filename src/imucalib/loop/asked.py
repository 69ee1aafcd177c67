"""What a search shall try: the catalogue as the user leaves it, as far as the data can carry it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from imucalib.core.context import MOTION
from imucalib.core.effect import Effect, Family
from imucalib.effects import catalogue, families, named


@dataclass(frozen=True)
class Searched:
    """Effects by name, and scans over a value."""

    effects: Mapping[str, Effect]
    families: tuple[Family, ...]


def searched(
    only: tuple[str, ...],
    without: tuple[str, ...],
    own: Mapping[str, Effect],
    usable: Callable[[Effect], bool] = lambda effect: True,
) -> Searched:
    """The effects of sensors at rest that a search tries.

    only : names that it tries alone, or none; without : names that it leaves out; own : effects of
    the user's file; usable : whether a calibrator's reference can show an effect at all

    Raises UsageError for a name that is no effect and no scan.
    """
    every: dict[str, Effect] = {**catalogue(), **own}
    for name in (*only, *without):
        if name not in every and name not in families():
            named(name)
    wanted = [n for n in dict.fromkeys(only or (*every, *families())) if n not in without]
    effects = {
        n: every[n] for n in wanted if n in every and _at_rest(every[n]) and usable(every[n])
    }
    return Searched(effects, tuple(families()[n] for n in wanted if n in families()))


def _at_rest(effect: Effect) -> bool:
    return effect.channel == "acceleration" and not set(effect.needs) & set(MOTION)
