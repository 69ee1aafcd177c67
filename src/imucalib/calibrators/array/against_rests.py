"""What was found of the gyros in motion, held against the same board's rests.

An effect of the force must show in gravity as it does in motion: rests in several attitudes see it
without any rate. Where they do not, something else that goes with the force stands under its name.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.loop.motion import BoardMotion, board_motion
from imucalib.calibrators.array.loop.terms import Term
from imucalib.loop.found import Unexplained

#: Rests from which they contradict an effect, and times their scatter that it would make of it.
_ATTITUDES, _WORSE = 4, 1.2
#: What stands beside a contradicted name.
OTHER = "what shows in motion only"


def held_against_rests(loop: MotionLoop, force: Array, rate: Array, t: Array) -> MotionLoop:
    """The loop with doubts where rests contradict a name: it stays corrected, is not certain, and
    what it stands for is left open.

    force : (n, K, 3) m/s² at n rests, rate : (n, K, 3) rad/s as read, in board axes; t : (n,) s
    """
    if len(force) < _ATTITUDES:
        return loop
    state = loop.final
    motion = _at_rest(state.setup.imus, state.setup.board.rotations, force, t)
    wrong = {term.name for term in state.found if _contradicted(term, motion, rate)}
    if not wrong:
        return loop
    steps = tuple(
        replace(s, aliases=(*s.aliases, OTHER)) if s.effect in wrong else s for s in loop.steps
    )
    left = tuple(
        Unexplained(f"{s.effect} shows in motion and not at rest", "force", "probe", s.p,
                    s.evidence, 0.0)
        for s in loop.steps
        if s.effect in wrong
    )  # fmt: skip
    return replace(loop, steps=steps, unexplained=(*loop.unexplained, *left))


def _contradicted(term: Term, motion: BoardMotion, rate: Array) -> bool:
    """Whether a gyro's effect of the force makes the rests scatter more."""
    if term.effect.channel != "angular_rate" or "spin" in term.effect.needs:
        return False
    made = term.reading(term.columns(motion))
    return _scatter(rate - made) > _WORSE * _scatter(rate)


def _scatter(values: Array) -> float:
    """Root mean square about the means over the rests."""
    return float(np.sqrt(np.mean((values - values.mean(axis=0)) ** 2)))


def _at_rest(imus: tuple[str, ...], rotations: Array, force: Array, t: Array) -> BoardMotion:
    n, k, _ = force.shape
    still = np.zeros((n, 3))
    return board_motion(
        imus=imus, rotations=rotations, t=t, order=np.full(n, 0.5), rate=still, spin=still,
        force=force, jerk=np.zeros((n, k, 3)), age=np.zeros((n, k)),
    )  # fmt: skip
