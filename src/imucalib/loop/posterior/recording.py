"""The closed loop of a recording: the same posterior where the bias walks through all of it.

What is missing moves the point of linearisation, the scatter and the weights of runs that looked
strange beside it: all are made anew beside what is told, until that stands still.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.effects.history.step import moment_of
from imucalib.errors import NotConverged
from imucalib.loop.asked import Searched
from imucalib.loop.design import Fold, folds_of, parts_of
from imucalib.loop.difference import Difference, difference, with_density
from imucalib.loop.found import FitLoop
from imucalib.loop.held_out import Held
from imucalib.loop.posterior.catalogue import components_of
from imucalib.loop.posterior.closed import correctable, empty, judged, refused
from imucalib.loop.posterior.component import Member
from imucalib.loop.posterior.explored import Explored, heard, near_values, refined
from imucalib.loop.posterior.held_out import LeftOut, foretold, left_out
from imucalib.loop.posterior.odds import FOLD_BEAMS, FOLD_DEEPEST
from imucalib.loop.posterior.problem import problem_of
from imucalib.loop.posterior.recorded import Course, course_of, fit_at, looked, recorded_grams
from imucalib.loop.posterior.rivals import rivals_of
from imucalib.loop.posterior.solution import Solved, solved
from imucalib.loop.posterior.space import search
from imucalib.loop.posterior.words import Told, told
from imucalib.loop.separation import ambiguities
from imucalib.loop.sums import sums_of

#: Rounds after which what is told stands still or never will; in these few sets are opened, as in
#: a fold.
_ROUNDS = 4


@dataclass(frozen=True)
class Closed:
    """A finished loop. course : the noise beside its final model; before, after : every run
    foretold without its block of time, by the base model and by what the search finds there"""

    loop: FitLoop
    course: Course
    before: Held
    after: Held


def close_recording(plain: Fit, asked: Searched, known: Array, *, curves: bool = True) -> Closed:
    """Search beside a fitted base model, and judge on blocks of time what that was worth.

    known : (n,) m²/s⁴, the part of each run's variance that its windows and the resolution explain
    """
    found, course, said = _explored(plain, asked, known)
    data = _in_units(found.base.observations, course)
    nothing = solved(found.problem, found.posterior.grams, found.posterior.base)
    base = _at(nothing, data)
    loop = replace(empty(plain, found, asked, said), base=base, final=base, as_recorded=base)
    folds, final = folds_of(data), base
    after = before = foretold(found.problem, found.posterior, folds)
    if not correctable(found, said, curves=curves):
        loop = refused(loop, found, said, None)
    elif said.places:
        try:
            final = _at(solved(found.problem, found.posterior.grams, said.hypothesis), data)
            left = left_out(found.problem, found.posterior, folds)
        except NotConverged:  # a response that has no inverse
            loop = refused(loop, found, said, None)
        else:
            gain = _gain(left, folds, final, data.context["time"])
            loop = judged(loop, found, said, final, left, gain)
            after = left.after if loop.steps else before
    course, wander = course_of(loop.final, known, course)
    size = (wander.scatter, wander.size)
    loop = replace(
        loop,
        as_recorded=loop.final,
        weighed=rivals_of(found.problem, found.posterior),
        wander=wander,
        ambiguous=ambiguities(loop, course.white(loop.final.at.unit)),
        sums=sums_of(found.problem, found.posterior, base, *size),
    )
    return Closed(loop, course, before, after)


def _explored(plain: Fit, asked: Searched, known: Array) -> tuple[Explored, Course, Told]:
    """The posterior where it stands still: at what it tells, and at the noise beside that."""
    data, fit = plain.observations, plain
    first = components_of(plain.model, data, asked, walks=True)
    near: dict[str, list[str]] = {}
    before: tuple[tuple[Member, float], ...] = ()
    course, _ = course_of(fit, known)
    for _ in range(_ROUNDS):
        at = fit_at(fit.model, _scaled(data, course), fit.theta, fit.covariance)
        problem = problem_of(at, refined(first, near, data, asked), plain.model, single=False)
        every = recorded_grams(problem, course)
        look = looked(problem, every, before)
        grams = every.of(look.kept)
        del every  # the products of all walks are most of the memory
        brief = search(problem, grams, beams=FOLD_BEAMS, deepest=FOLD_DEEPEST)
        found = Explored(replace(plain, observations=at.observations), problem, brief, grams)
        hypothesis = told(problem, brief).hypothesis
        closer = _together(look.values, near_values(found))
        now = tuple((problem.choices[p.choice].member, p.size) for p in hypothesis.picks)
        still = {m.free for m, _ in now} == {m.free for m, _ in before}
        if still and closer.keys() <= near.keys():
            break
        near, before = closer, now
        try:
            one = solved(problem, grams, hypothesis)
            fit = fit_at(one.model, data, one.theta, one.covariance)
        except NotConverged:  # it is told where it stands, and corrects nothing
            break
        course, _ = course_of(fit, known, course)
    whole = replace(found, posterior=search(problem, grams))
    posterior = heard(whole)
    return replace(whole, posterior=posterior), course, told(problem, posterior)


def _together(
    one: Mapping[str, Sequence[str]], other: Mapping[str, Sequence[str]]
) -> dict[str, list[str]]:
    """Values of scans that either has."""
    names = (*one, *(n for n in other if n not in one))
    return {n: sorted({*one.get(n, ()), *other.get(n, ())}) for n in names}


def _scaled(data: Observations, course: Course) -> Observations:
    """With the scatter of a run as the noise of each."""
    return replace(data, sigma=np.full_like(data.sigma, course.scatter))


def _in_units(data: Observations, course: Course) -> Observations:
    """With each run's own noise beside the walk."""
    own = course.scatter * np.sqrt(course.variance)
    return replace(data, sigma=np.broadcast_to(own[:, None, None], data.sigma.shape).copy())


def _at(one: Solved, data: Observations) -> Fit:
    return fit_at(one.model, data, one.theta, one.covariance)


def _gain(left: LeftOut, folds: Sequence[Fold], final: Fit, time: Array) -> Difference:
    """What blocks of time gain but for those that hold a moment at which something changes: without
    one nobody knows when within it that was."""
    part = parts_of(tuple(folds))
    hidden = [k for k, fold in enumerate(folds) if _holds_a_moment(final, fold, time)]
    good = ~np.isin(part, [folds[k].rows[0] for k in hidden])
    sizes = left.before.size[good], left.after.size[good]
    count = len(folds) - len(hidden)
    gain = difference(*sizes, part[good], count, "mean")
    return with_density(gain, np.delete(left.nats, hidden))


def _holds_a_moment(final: Fit, fold: Fold, time: Array) -> bool:
    gone = time[np.setdiff1d(np.arange(time.size), fold.rest)]
    moments = np.array([moment_of(name) for name in final.model.names])
    return bool(np.any((moments >= gone.min()) & (moments <= gone.max())))
