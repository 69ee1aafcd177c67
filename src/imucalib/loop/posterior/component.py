"""What may be missing, on one footing: prior odds, and members with columns and weights.

A component is a name of the catalogue, a scan of one, a free function or an unnamed law. Its
members are the ways in which it may act: all parameters or one, a value of a scan, a shape. The
numbers of a member are normal about zero with the same standard deviation in typical sizes, which
itself has a prior (`log_size_prior`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import Effect
from imucalib.loop.posterior.odds import KNOWN, LOOSE, MISSING, SPREAD

#: name : of the catalogue; loose : a scan without physics for one value before another; free : a
#: smooth function of a driver; law : a simple shape of a driver that has no name.
Kind = Literal["name", "loose", "free", "law"]
#: What shares which part of the prior odds.
_SHARE = {"name": KNOWN, "free": KNOWN, "law": KNOWN, "loose": LOOSE}


@dataclass(frozen=True)
class Member:
    """One way in which a component acts.

    effects : that act, each with the parameters (w,) of its own that are free, and their standard
        deviations (w,) relative to each other, in the parameters' units
    log_weight : of its prior probability within the component
    """

    effects: tuple[tuple[Effect, Index, Array], ...]
    log_weight: float

    @property
    def name(self) -> str:
        """What it is called: of several effects the first's."""
        return self.effects[0][0].name

    @property
    def free(self) -> tuple[tuple[str, bytes], ...]:
        """Which parameters of which effects it frees."""
        return tuple((effect.name, own.tobytes()) for effect, own, _ in self.effects)


@dataclass(frozen=True)
class Component:
    """name : as `imucal effects` has it, of a scan without its value ("name@"); driver : what it
    follows, in words, or empty"""

    name: str
    kind: Kind
    members: tuple[Member, ...]
    driver: str = ""

    @property
    def named(self) -> bool:
        """Whether it names a cause."""
        return self.kind in ("name", "loose")


def log_odds(components: tuple[Component, ...]) -> Array:
    """(C,) log prior odds of each component, beside whatever else is there: names, free functions
    and laws share theirs evenly, and so do loose scans."""
    group = [_group(c.kind) for c in components]
    count = {g: group.count(g) for g in group}
    return np.array([np.log(_SHARE[c.kind] / count[_group(c.kind)]) for c in components])


def _group(kind: Kind) -> str:
    return "loose" if kind == "loose" else "known"


def log_set_prior(odds: Array, members: tuple[int, ...]) -> float:
    """Log prior of a set of components against none: the first says that something is missing."""
    return float(np.log(MISSING) + odds[list(members)].sum()) if members else 0.0


def log_size_prior(size: Array) -> Array:
    """(..., T) log prior of a component's standard deviations (..., T) in typical sizes: flat in
    the logarithm up to the typical one, falling above; normalised over the last axis."""
    over = np.maximum(np.log(size), 0.0) / np.log(SPREAD)
    density = -0.5 * over**2
    return np.asarray(density - np.log(np.exp(density).sum(axis=-1, keepdims=True)))
