"""The array's closed loop: search, tell twins apart, hold out each half, and fit all samples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.estimate.covariance import (
    POSITIONS,
    Uneven,
    fitted_on_all,
    on_all,
    settled_there,
    with_uneven,
)
from imucalib.calibrators.array.loop.ages import Ages, found_ages, kept_ages
from imucalib.calibrators.array.loop.catalogue import NOTHING_ASKED, Asked
from imucalib.calibrators.array.loop.cross_fit import Fitted, Gained, cross_fitted
from imucalib.calibrators.array.loop.declared import remembered, shared_by_neighbours
from imucalib.calibrators.array.loop.search import Explored, explored, started, with_ways
from imucalib.calibrators.array.loop.setup import Setup
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.terms import Term
from imucalib.calibrators.array.loop.told import absorbed, left_over, scores_of, steps_of
from imucalib.calibrators.array.moving import Moving
from imucalib.loop.found import FitLoop, Loop, Step, Unexplained

_REFUSED = "motion that took no part in the search refuses it"


@dataclass(frozen=True, kw_only=True)
class MotionLoop(Loop[ArrayState]):
    """The search over a motion.

    ages : clocks of the gyros, or None; gained : what motion that took no part in any choice says,
    None where it is too short for that; impact : what cannot
    be seen, with the m rms by which its typical size moves the positions; moved : the same of what
    is left; dispersion : how many times fewer accelerometer samples the noise that neighbours share
    leaves; asked : what the user declared; rests : the search at rest, of which `with_rests` made
    a part of this one
    """

    ages: Ages | None
    gained: Gained | None
    impact: Mapping[str, float]
    moved: Mapping[str, float]
    dispersion: float
    asked: Asked = NOTHING_ASKED
    rests: FitLoop | None = None

    @property
    def suspected(self) -> bool:
        """Whether the motion names a cause that the other half of it does not prove."""
        own = self.rests.steps if self.rests is not None else ()
        in_motion = len(self.named) > len(own)
        return in_motion and self.gained is not None and not self.gained.proved


def close_array_loop(
    setup: Setup,
    terms: tuple[Term, ...],
    moving: Moving,
    *,
    curves: bool = False,
    halved: Setup | None = None,
    most: int | None = None,
    asked: Asked = NOTHING_ASKED,
) -> MotionLoop:
    """The posterior over what the motion lacks; corrected is what is told, unless motion that took
    no part refuses it.

    curves : whether laws without a name are corrected; halved : more samples for the halves
    most : of all informative ones, how many the final fit takes, or None for those of the search
    asked : effects that the user declares, or keeps out of the search
    """

    def searched(chosen: Setup) -> tuple[Explored, ArrayState]:
        found = explored(*started(chosen, terms, moving, asked), moving, asked, curves=curves)
        return found, _named(found, asked, curves=curves)

    def halves(chosen: Setup) -> tuple[Fitted, Fitted]:
        found, state = searched(chosen)
        return (found.base, found.ages), (state, found.ages)

    found, path = searched(setup)
    gained = cross_fitted(halved or setup, moving, halves)
    steps = steps_of(found, path, gained)
    shifts = left_over(found, path)
    left = {one: float(np.sqrt(np.mean(moved**2))) for one, moved in shifts.items()}
    refused: tuple[tuple[str, str], ...] = ()
    if steps and gained is not None and gained.refutes:
        refused = tuple((step.effect, _REFUSED) for step in steps)
        left = {_as_structure(step): 0.0 for step in steps} | left
        path, steps = found.base, ()
    final, ages = _on_all(path, found.ages, moving, most)
    left |= dict.fromkeys(remembered(final) if asked.search else (), 0.0)
    dispersion = shared_by_neighbours(final, gyro=False)
    final, uneven = with_uneven(final, dispersion)
    final = _as_far_as_known(final, shifts.values())
    if uneven is not None:
        left = {_as_positions(uneven): float(uneven.spread.max())} | left
    return MotionLoop(
        base=found.base,
        final=final,
        steps=steps,
        rejected=(*found.rejected, *refused),
        refuted=tuple(name for name, _ in refused),
        unexplained=tuple(left),
        scores=scores_of(found.problem, found.posterior),
        first_scores=scores_of(*found.first),
        missing=found.problem.missing,
        difference=None if gained is None else gained.principal,
        complete=found.said.complete,
        ages=ages,
        gained=gained,
        impact=absorbed(found.first[0]),
        moved={one.name: move for one, move in left.items()},
        dispersion=dispersion,
        asked=asked,
    )


def _named(found: Explored, asked: Asked, *, curves: bool) -> ArrayState:
    """The fit without laws, which have no name, unless they are to be corrected."""
    ways = found.problem.ways_of(found.said.hypothesis)
    known = {term.name for term in found.apart.state.found}
    named = tuple(w for w in ways if curves or found.problem.named(w.name))
    if known == {w.name for w in named} | (known & set(asked.declare)):
        return found.apart.state
    return with_ways(found.apart.state, named, asked)[0] or found.base


def _as_far_as_known(state: ArrayState, shifts: Iterable[Array]) -> ArrayState:
    """With positions known no better than by what moves them and is not corrected, (d,) m each."""
    covariance, d = state.covariance.copy(), state.positions
    for moved in shifts:
        covariance[:d, :d] += np.outer(moved, moved)
    return replace(state, covariance=covariance)


def _as_positions(apart: Uneven) -> Unexplained:
    name = POSITIONS + apart.driver
    return Unexplained(name, apart.driver, "probe", 1.0 - apart.p, apart.nats)


def _as_structure(step: Step) -> Unexplained:
    """A step that held-out motion refuses, as structure that has no name."""
    return Unexplained(step.effect, step.effect, "effect", step.probability, step.evidence)


def _on_all(
    state: ArrayState, ages: Ages | None, moving: Moving, most: int | None
) -> tuple[ArrayState, Ages | None]:
    """The final fit on all samples; accepted clocks with their phases from all of the motion."""
    if not any(term.aged for term in state.terms):
        return (state if most is None else fitted_on_all(state, moving, most)), None
    moved = state if most is None else on_all(state, moving, most)
    again = found_ages(moved, moving, all_rows=True)
    if again is None:
        return state, ages
    return settled_there(kept_ages(moved, again, voting=False)), again
