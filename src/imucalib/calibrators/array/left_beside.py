"""Names of the motion's effects, held against what is left of the same IMU, the same drive, or all.

One IMU that does what no effect says is taken apart into effects that do a part of it, each far
above chance. While something of it still stands out, none of these names is the whole of it. The
same holds for what explains less than is left.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.estimate.left import NOISY
from imucalib.calibrators.array.estimate.uneven import POSITIONS
from imucalib.calibrators.array.loop.at_rest import AT_REST
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.loop.terms import Term, typical_of
from imucalib.loop.found import Step

#: Drive of curves over the motion, and what effects that follow it ask for.
_TIME, _FOLLOWS_TIME = "time", ("order", "time")
#: Share of an effect of all IMUs, in typical sizes, from which it is that of one.
_MOSTLY = 0.5


def held_against_left(
    loop: MotionLoop, off: tuple[Array, Array], still: tuple[Array, Array]
) -> MotionLoop:
    """The loop with doubts where what drives an effect drives something that is left too, or where
    more is left than it explains: it stays corrected, and is not certain.

    off : (K,) residuals of accelerometers and gyros in motion; still : (K,) their noise at rest
    """
    terms, shaken = {term.name: term for term in loop.final.found}, _shaken(loop, off, still)
    steps = []
    for step in loop.steps:
        term = terms.get(step.effect)
        words = "" if term is None or step.curve else _beside(step, term, loop, shaken)
        steps.append(replace(step, aliases=(*step.aliases, words)) if words else step)
    return replace(loop, steps=tuple(steps))


def _shaken(loop: MotionLoop, off: tuple[Array, Array], still: tuple[Array, Array]) -> set[str]:
    """IMUs that are noisier than the others in motion, by either sensor, and not so at rest: more
    happens to them than noise. What turns or moves a chip is seen by both of its sensors."""
    found = set()
    for moving, rest in zip(off, still, strict=True):
        found |= {
            imu
            for k, imu in enumerate(loop.final.setup.imus)
            if _times(moving, k) > NOISY * max(_times(rest, k), 0.5)
        }
    return found


def _times(size: Array, k: int) -> float:
    """One of several sizes over the others'."""
    return float(size[k] / max(float(np.median(np.delete(size, k))), 1e-300))


def _beside(step: Step, term: Term, loop: MotionLoop, shaken: set[str]) -> str:
    """What else could stand under its name, or nothing."""
    gyro = term.effect.channel == "angular_rate"
    left = {u.driver for u in loop.unexplained if u.name.startswith("gyro") == gyro}
    imu = _its_imu(term, loop)
    if imu and (imu in shaken or (term.only is not None and imu in left)):
        return f"something else of {imu}"
    if _TIME in left and any(name in _FOLLOWS_TIME for name in term.effect.needs):
        return "something else that follows time"
    if not gyro and any(u.name.startswith(POSITIONS) for u in loop.unexplained):
        return "something else that positions follow"
    if any(nats > step.evidence for nats in _nats(loop, imu)):
        return "a part of what is left"
    return ""


def _its_imu(term: Term, loop: MotionLoop) -> str:
    """The IMU that alone has an effect, or has most of it."""
    imus = loop.final.setup.imus
    if term.only is not None:
        return imus[term.only]
    if term.effect.shared:
        return ""
    size = (term.theta / typical_of(term.effect, len(term.theta))).reshape(len(imus), -1)
    power = np.sum(size**2, axis=1)
    most = int(np.argmax(power))
    return imus[most] if power[most] > _MOSTLY * max(float(power.sum()), 1e-300) else ""


def _nats(loop: MotionLoop, imu: str) -> Iterator[float]:
    """Evidence of what is left of the motion, but of IMUs that an effect is not of."""
    others = set(loop.final.setup.imus).difference({imu} if imu else set())
    for u in loop.unexplained:
        if not u.name.startswith(AT_REST) and not (imu and u.driver in others):
            yield u.evidence
