"""What the search found at rest, as a part of what it found in all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.core.fit import Fit
from imucalib.loop.found import FitLoop, Step

#: How a name begins that speaks of the rests alone.
AT_REST = "at rest: "


def with_rests(loop: MotionLoop, rests: FitLoop | None) -> MotionLoop:
    """The loop over the motion with the records, steps and doubts of the rests before its own."""
    if rests is None:
        return loop
    return replace(
        loop,
        rests=rests,
        records=rests.records,
        steps=(*rest_steps(rests), *loop.steps),
        rejected=(*((AT_REST + name, why) for name, why in rests.rejected), *loop.rejected),
        unexplained=(
            *loop.unexplained,
            *(replace(u, name=AT_REST + u.name) for u in rests.unexplained),
        ),
    )


def rest_steps(loop: FitLoop) -> tuple[Step, ...]:
    """The steps at rest, with their sizes in words."""
    return tuple(
        replace(
            step,
            effect=AT_REST + step.effect,
            value=_size(loop.final, step.effect),
            checked=tuple(replace(c, name="rests") for c in step.checked),
            rivals=tuple(
                (AT_REST + name if name == step.effect else name, share)
                for name, share in step.rivals
            ),
        )
        for step in loop.steps
    )


def _size(fit: Fit, name: str) -> str:
    part = fit.model.slices(fit.observations.context)[name]
    rms = float(np.sqrt(np.mean(fit.theta[part] ** 2)))
    return f"{rms:.2g} {fit.parameters[part.start].unit} rms of {part.stop - part.start}"
