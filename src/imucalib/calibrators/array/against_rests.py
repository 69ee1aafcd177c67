"""What was found of the gyros in motion, held against the same board's rests.

An effect of the force must show in gravity as it does in motion: rests in several attitudes see it
without any rate. Where they do not, something else that goes with the force stands under its name.
"""

from __future__ import annotations

from dataclasses import replace

from imucalib.arrays import Array
from imucalib.calibrators.array.gyros import ATTITUDES, contradicted
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.loop.motion import BoardMotion, motion_at_rest
from imucalib.calibrators.array.loop.terms import Term
from imucalib.loop.found import Unexplained

#: What stands beside a contradicted name.
OTHER = "what shows in motion only"


def held_against_rests(loop: MotionLoop, force: Array, rate: Array, t: Array) -> MotionLoop:
    """The loop with doubts where rests contradict a name: it stays corrected, is not certain, and
    what it stands for is left open.

    force : (n, K, 3) m/s² at n rests, rate : (n, K, 3) rad/s as read, in board axes; t : (n,) s
    """
    if len(force) < ATTITUDES:
        return loop
    state = loop.final
    motion = motion_at_rest(state.setup.imus, state.setup.board.rotations, force, t)
    wrong = {term.name for term in state.found if _contradicted(term, motion, rate)}
    if not wrong:
        return loop
    steps = tuple(
        replace(s, aliases=(*s.aliases, OTHER), certain=False) if s.effect in wrong else s
        for s in loop.steps
    )
    left = tuple(
        Unexplained(f"{s.effect} shows in motion and not at rest", "force", "probe", s.probability,
                    s.evidence)
        for s in loop.steps
        if s.effect in wrong
    )  # fmt: skip
    return replace(loop, steps=steps, unexplained=(*loop.unexplained, *left))


def _contradicted(term: Term, motion: BoardMotion, rate: Array) -> bool:
    """Whether a gyro's effect of the force makes the rests scatter more."""
    if term.effect.channel != "angular_rate" or "spin" in term.effect.needs:
        return False
    return contradicted(rate, term.reading(term.columns(motion)))
