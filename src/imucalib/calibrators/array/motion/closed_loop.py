"""The array's closed loop: search, hold out each half, fit all samples, and say what was found."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.board.rests import ATTITUDES, RestFit, is_contradicted
from imucalib.calibrators.array.motion.ages import (
    add_clock,
    add_estimated_clock,
    estimate_clock,
    find_voting,
)
from imucalib.calibrators.array.motion.covariance import add_unevenness
from imucalib.calibrators.array.motion.laws import AT_REST
from imucalib.calibrators.array.motion.search import (
    GYRO_FRAME,
    MotionSearch,
    add_declared,
    frame_term,
    search_posterior,
)
from imucalib.calibrators.array.motion.setup import FEWEST, Setup, part_of
from imucalib.calibrators.array.motion.state import (
    ArrayState,
    find_memory,
    fit_all_samples,
    measure_dispersion,
    on_all,
    refit_motion,
    settle_there,
    start_state,
    transfer_to,
)
from imucalib.calibrators.array.motion.terms import Term, board_motion
from imucalib.calibrators.request import Request
from imucalib.core.effect import Channel
from imucalib.posterior.closed_loop.found import (
    CheckedError,
    FitLoop,
    Loop,
    Step,
    Unexplained,
)
from imucalib.posterior.held_out import Difference, difference
from imucalib.rests.segments import Segments
from imucalib.units import DEG, MG

#: Standard deviation of normal errors over their median absolute deviation.
NORMAL_MAD = 1.4826
CHANNELS: tuple[Channel, Channel] = ("acceleration", "angular_rate")
#: What is named beside a cause that the rests contradict.
OTHER = "what shows in motion only"
_REFUSED = "it makes the held-out error larger"
_HALVES = 2  # of a motion, each predicted by what the other finds
_FOLLOWED = 3  # rounds of the motion, with its weights, under a model that does not move
_NO_ERROR = 1e-12  # m/s² or rad/s


@dataclass(frozen=True, kw_only=True)
class MotionLoop(Loop[ArrayState]):
    """The search over a motion.

    gained : what motion that took no part in any choice says, None where it is too short for that
    impact : what cannot be seen, with the m rms by which its typical size moves the positions;
    moved : the same of what has no name
    request : what the user declared; rests : the search at rest, where `join_rests` made it a part
    """

    gained: Gained | None
    impact: Mapping[str, float]
    moved: Mapping[str, float]
    request: Request
    rests: FitLoop | None = None

    @property
    def suspected(self) -> bool:
        """Whether the motion names a cause that the other half of it does not prove."""
        own = self.rests.steps if self.rests is not None else ()
        in_motion = len(self.named) > len(own)
        return in_motion and self.difference is not None and not self.difference.proved

    @property
    def dispersion(self) -> float:
        """How many times fewer accelerometer samples noise that neighbours share leaves."""
        return measure_dispersion(self.final, gyro=False)

    @property
    def held_out(self) -> Gained | None:
        """Errors on motion that took no part, of the base model and of what is corrected."""
        if self.gained is None or not self.refuted:
            return self.gained
        return Gained(*(replace(d, after=d.before) for d in self.gained))

    def join_rests(self, rests: FitLoop | None) -> MotionLoop:
        """With the records, steps and doubts of the rests before its own."""
        if rests is None:
            return self
        return replace(
            self,
            rests=rests,
            records=rests.records,
            steps=(*_rest_steps(rests), *self.steps),
            rejected=(*((AT_REST + name, why) for name, why in rests.rejected), *self.rejected),
            unexplained=(
                *self.unexplained,
                *(replace(u, name=AT_REST + u.name) for u in rests.unexplained),
            ),
        )

    def hold_against_rests(self, segments: Segments, rests: RestFit) -> MotionLoop:
        """The loop with doubts where gravity at the rests contradicts what a force does to gyros:
        it is corrected still, is not certain, and what it may be instead is open."""
        if segments.n < ATTITUDES:
            return self
        t, turns = segments.middle, rests.rotations
        read, rate = (
            np.einsum("kij,nkj->nki", turns, values) for values in (segments.mean, segments.rate)
        )
        motion = board_motion(rests, t, force=rests.correct(read, t))
        wrong = {
            term.name
            for term in self.final.found
            if term.gyro
            and "spin" not in term.effect.needs
            and is_contradicted(rate, term.reading(motion))
        }
        steps, more = list[Step](), list[Unexplained]()
        for step in self.steps:
            if step.effect not in wrong:
                steps.append(step)
                continue
            steps.append(replace(step, aliases=(*step.aliases, OTHER), certain=False))
            name = f"{step.effect} shows in motion and not at rest"
            more.append(Unexplained(name, "force", "probe", step.probability, step.evidence_nats))
        return replace(self, steps=tuple(steps), unexplained=(*self.unexplained, *more))


def close_array_loop(
    setup: Setup,
    terms: tuple[Term, ...],
    request: Request,
    *,
    halved: Setup | None = None,
    most: int | None = None,
) -> MotionLoop:
    """The posterior over what the motion lacks; corrected is what is told, unless motion that took
    no part refuses it.

    request : effects that the user declares, or keeps out of the search, and whether laws without
    a name are corrected; halved : more samples for the halves; most : of all informative ones, how
    many the final fit takes, or None for those of the search
    """

    first, held = (*terms, frame_term()), replace(request, declare=(*request.declare, GYRO_FRAME))
    if GYRO_FRAME in (*request.declare, *request.without):
        first, held = terms, request

    def search(
        chosen: Setup, whole: MotionSearch | None = None
    ) -> tuple[ArrayState, ArrayState, MotionSearch]:
        base = add_estimated_clock(add_declared(start_state(chosen, first), request.declare))
        found = search_posterior(base, held, whole)
        return base, found.drop_laws(held) or base, found

    base, final, found = search(setup)
    gained = cross_fitted(halved or setup, lambda half: search(half, found)[:2])
    steps = found.list_steps(final, () if gained is None else gained.checks)
    shifts = found.find_unnamed(final)
    open_ends = {one: float(np.sqrt(np.mean(moved**2))) for one, moved in shifts.items()}
    deciding = None if gained is None else gained.select_deciding(_sensors_that_show(final, steps))
    refused: tuple[tuple[str, str], ...] = ()
    if steps and deciding is not None and not deciding.holds:
        refused = tuple((step.effect, _REFUSED) for step in steps)
        nameless = (
            Unexplained(s.effect, s.effect, "effect", s.probability, s.evidence_nats) for s in steps
        )
        open_ends = dict.fromkeys(nameless, 0.0) | open_ends
        final, steps = base, ()
    final = _on_all(final, most)
    open_ends |= dict.fromkeys(find_memory(final) if request.loop else (), 0.0)
    final, uneven = add_unevenness(final, shifts.values())
    if uneven is not None:
        open_ends = {uneven.unexplained: float(uneven.spread.max())} | open_ends
    return MotionLoop(
        base=base,
        final=final,
        steps=steps,
        rejected=(*found.rejected, *refused),
        refuted=tuple(name for name, _ in refused),
        unexplained=tuple(open_ends),
        scores=found.said.problem.score(found.said.posterior),
        first_scores=found.scores,
        missing=found.said.problem.missing,
        difference=deciding,
        complete=found.said.complete,
        gained=gained,
        impact=found.impact,
        moved={one.name: move for one, move in open_ends.items()},
        request=request,
    )


def _sensors_that_show(final: ArrayState, steps: Sequence[Step]) -> set[Channel]:
    """Whose errors show what is told: of what single sensors do, those of their kind; of what all
    do alike, or has no name, those of both."""
    told = {step.effect for step in steps}
    shown = [term.effect for term in final.found if term.name in told]
    shared = any(effect.shared for effect in shown) or not shown
    return set(CHANNELS) if shared else {effect.channel for effect in shown}


def _on_all(state: ArrayState, most: int | None) -> ArrayState:
    """The final fit on all samples; accepted clocks with their phases from all of the motion."""
    if not any(term.aged for term in state.terms):
        state = replace(state, clock=None)
        return state if most is None else fit_all_samples(state, most)
    moved = state if most is None else on_all(state, most)
    clock = estimate_clock(moved, every=True)
    if clock is None:
        return state
    return settle_there(add_clock(moved, clock, voting=False))


def _rest_steps(loop: FitLoop) -> Iterator[Step]:
    """The steps at rest, with their sizes in words."""
    fit = loop.final
    slices = fit.model.slices(fit.observations.context)
    for step in loop.steps:
        part = slices[step.effect]
        rms = float(np.sqrt(np.mean(fit.theta[part] ** 2)))
        unit, count = fit.parameters[part.start].unit, part.stop - part.start
        yield replace(
            step,
            effect=AT_REST + step.effect,
            size=f"{rms:.2g} {unit} rms of {count}",
            formula="",  # each chip has numbers of its own
            checks=tuple(
                CheckedError("rests, leave one out", "m/s²", MG * c.before, MG * c.after, 5)
                for c in step.checks
            ),
            in_its_place=tuple(
                replace(one, effect=AT_REST + one.effect) if one.effect == step.effect else one
                for one in step.in_its_place
            ),
        )


class Gained(NamedTuple):
    """Median absolute deviations before and after: acceleration (m/s²), rate (rad/s)."""

    acceleration: Difference
    rate: Difference

    @property
    def checks(self) -> tuple[CheckedError, ...]:
        """Errors before and after."""
        force, rate = self
        return (
            CheckedError("acc residual", "m/s²", force.before, force.after, 3),
            CheckedError("gyro residual", "deg/s", rate.before / DEG, rate.after / DEG),
        )

    def select_deciding(self, channels: Collection[Channel]) -> Difference:
        """The error that has changed by the most, of the sensors that effects act on: held-out
        readings of k sensors, each of its own noise, are as much likelier as the sum of the
        logarithms of what their errors fall by; of two the larger one has the sign of it."""
        own = [d for c, d in zip(CHANNELS, self, strict=True) if c in channels]
        return max(own, key=lambda d: abs(np.log(max(d.before, 1e-300) / max(d.after, 1e-300))))


def cross_fitted(
    setup: Setup, searched: Callable[[Setup], tuple[ArrayState, ArrayState]]
) -> Gained | None:
    """Predict each half by what a search of the other finds; None where the halves are too small.

    One design, fixed before the search: blocks of a few seconds in two halves. On one half
    positions, noise, effects and their choice among the sets that were likely are made anew, which
    may find none; then the other is predicted with all of it held. Only the motion of each sample
    is its own, and the phases of the gyros' clocks come from samples in between that are never
    predicted. Base and final model stand on the same samples.

    searched : from samples to the fitted base and to the end of the search
    """
    sizes, blocks = list[list[Array]](), list[Index]()
    for half in (setup.first, ~setup.first):
        train, test = part_of(setup, half), part_of(setup, ~half)
        silent = find_voting(test)
        if min(len(train.inner), int(silent.sum())) < FEWEST // _HALVES:
            return None
        sizes.append([_sizes(_predict(end, test), silent) for end in searched(train)])
        blocks.append(test.block[silent])
    before, after = (np.concatenate(parts, axis=1) for parts in zip(*sizes, strict=True))
    block, every = np.concatenate(blocks), zip(before, after, strict=True)
    return Gained(*(difference_of_medians(*kind, block, _HALVES) for kind in every))


def _predict(state: ArrayState, setup: Setup) -> ArrayState:
    """The motion at other samples under positions, terms and noise that were found without them."""
    moved = transfer_to(state, setup)
    if state.clock is not None:
        moved = add_clock(moved, state.clock, voting=False)
    return refit_motion(moved, _FOLLOWED)


def _sizes(state: ArrayState, rows: Flags) -> Array:
    """(2, n, 3 K) m/s² and rad/s: what remains of the samples `rows` (inner,) of accelerometers and
    gyros."""
    off, inner = state.sampled.off, state.setup.inner[rows]
    return np.abs([own[inner] for own in off]).reshape(2, len(inner), -1)


def difference_of_medians(before: Array, after: Array, block: Index, folds: int) -> Difference:
    """Median absolute deviations before and after, and the interval of their difference.

    What changes from block to block is how the board moves, and both errors with it; their ratio
    stays. So the interval is that of the mean logarithm of the ratio over blocks (`difference`), at
    the error before.

    before, after : (n, m) sizes of the errors of n samples; block : (n,) of samples that belong
    together
    """
    every, of = np.unique(block, return_inverse=True)
    ratio = np.array([_log_ratio(before[block == one], after[block == one]) for one in every])
    mean = difference(ratio[of], np.zeros(len(of)), block, folds, "mean")
    start, end = float(np.median(before)), float(np.median(after))
    away = _log_ratio(before, after) - mean.gain
    low, high = (start * -float(np.expm1(-(edge + away))) for edge in (mean.low, mean.high))
    return Difference(start, end, low, high, mean.parts)


def _log_ratio(before: Array, after: Array) -> float:
    one, two = (max(float(np.median(x)), _NO_ERROR) for x in (before, after))
    return float(np.log(one / two))
