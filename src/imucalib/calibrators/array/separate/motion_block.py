"""Advised motions in report.json, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from imucalib.calibration.ambiguity import separation_block, separation_of
from imucalib.calibrators.array.separate.motion_plan import MotionPlan
from imucalib.errors import UnreadableInput
from imucalib.loop.separation.plan import Separation


@dataclass(frozen=True)
class AdvisedMotion:
    """words : about which axis, how, how fast; seconds : how long"""

    separation: Separation
    words: tuple[str, ...]
    seconds: float


def motion_block(plans: Sequence[MotionPlan]) -> dict[str, Any]:
    """The block of a finished run; `motions_of` reads it back."""
    return {
        "ambiguities": [
            {
                "motion": list(one.motion.words) if one.motion else [],
                "seconds": one.seconds,
                **separation_block(one.separation),
            }
            for one in plans
        ]
    }


def motions_of(block: Mapping[str, Any], where: str) -> tuple[AdvisedMotion, ...]:
    """Read the block. Raises UnreadableInput where it is damaged."""
    try:
        return tuple(
            AdvisedMotion(
                separation_of(one),
                tuple(str(word) for word in one["motion"]),
                float(one["seconds"]),
            )
            for one in block["ambiguities"]
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UnreadableInput(f"what a plan needs is damaged: {error!r}", where=where) from None
