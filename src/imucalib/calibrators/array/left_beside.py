"""Names of the motion's effects, held against what is left of the same IMU or the same drive.

One IMU that does what no effect says is taken apart into effects that do a part of it, each far
above chance. While something of it still stands out, none of these names is the whole of it.
"""

from __future__ import annotations

from dataclasses import replace

from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.loop.terms import Term

#: Drive of curves over the motion, and what effects that follow it ask for.
_TIME, _FOLLOWS_TIME = "time", ("order", "time")


def held_against_left(loop: MotionLoop) -> MotionLoop:
    """The loop with doubts where what drives an effect drives something that is left too: it stays
    corrected, and is not certain."""
    beside = {term.name: _beside(term, loop) for term in loop.final.found}
    steps = tuple(
        replace(s, aliases=(*s.aliases, words)) if (words := beside.get(s.effect, "")) else s
        for s in loop.steps
    )
    return replace(loop, steps=steps)


def _beside(term: Term, loop: MotionLoop) -> str:
    """What else could stand under its name, or nothing."""
    gyro = term.effect.channel == "angular_rate"
    left = {u.driver for u in loop.unexplained if u.name.startswith("gyro") == gyro}
    imu = term.name.partition("@")[2]
    if imu and imu in left:
        return f"something else of {imu}"
    if _TIME in left and any(name in _FOLLOWS_TIME for name in term.effect.needs):
        return "something else that follows time"
    return ""
