"""A parameter: a number with a name, a unit, a physical size and a range outside of which it is
not believed."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """One unknown of an effect.

    unit : the unit that a person reads (mg, deg, 1, mg/degC); the effect converts it to SI
    typical : one standard deviation of what data sheets and practice let one expect, in `unit`
    plausible : largest absolute value that is still believed, in `unit`
    start : the value at which the effect is absent
    usual : largest that data sheets let one expect, in `unit`; the name of a larger one is in doubt
    least : smallest value that is still believed, in `unit`, of what has one sign
    """

    name: str
    unit: str
    typical: float
    plausible: float
    start: float = 0.0
    usual: float = math.inf
    least: float = -math.inf
