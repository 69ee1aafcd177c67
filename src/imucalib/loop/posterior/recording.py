"""The closed loop of a recording: the same posterior where the bias walks through all of it.

What is missing moves the point of linearisation, the scatter and the weights of runs that looked
strange beside it: all are made anew beside what is told, until that stands still.

The course of a bias that wanders, where it is the sensor's: the walk's posterior mean, followed.

Given what is read, the walk at any moments g is normal, C its covariance with the readings:

    w_g | y, θ ~ N(Cᵀ V⁻¹ (y - X θ),  K_gg - Cᵀ V⁻¹ C)

A calibration holds it as a smooth curve of time. It is followed only where short stretches of the
recording, each predicted by the others, prove that it tells what a reading there is off by.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.effects.forms import curve
from imucalib.effects.scans import moment_of
from imucalib.errors import NotConverged
from imucalib.loop.candidates import Searched
from imucalib.loop.found import FitLoop
from imucalib.loop.held_out import (
    Difference,
    Fold,
    Held,
    difference,
    folds_of,
    parts_of,
    with_density,
)
from imucalib.loop.posterior.catalogue import Member, components_of
from imucalib.loop.posterior.closed import correctable, empty, judged, refused
from imucalib.loop.posterior.explored import Explored, heard, refined, values_found
from imucalib.loop.posterior.held_out import LeftOut, base_left_out, left_out
from imucalib.loop.posterior.odds import FOLD_BEAMS, FOLD_DEEPEST
from imucalib.loop.posterior.problem import problem_of
from imucalib.loop.posterior.recorded import (
    Course,
    course_of,
    fit_at,
    looked,
    recorded_grams,
    whitener,
)
from imucalib.loop.posterior.solution import Solved, solved
from imucalib.loop.posterior.space import search
from imucalib.loop.posterior.words import Told, rivals_of, told
from imucalib.loop.separation import ambiguities
from imucalib.loop.sums import sums_of
from imucalib.units import MG

#: Short stretches of a recording, every twelfth of which is predicted by the others: as far from
#: what was recorded as a reading that is corrected may be.
_STRETCHES, _FOLDS = 120, 12
#: Cosines of the curve, and moments of each at which the walk is asked.
_TERMS, _MOMENTS = 24, 4
_UNKNOWN = 1e8  # times the variance of a run that is left out


def followed(fit: Fit, course: Course) -> Fit | None:
    """The fit with the course of its bias, or None where nothing proves that there is one to
    follow; course : the noise beside the fit."""
    misfit = fit.at.residual * fit.at.unit / course.scatter
    if not course.likeliest.size.any() or not _proved(course, misfit):
        return None
    walk = _asked(fit, course, misfit)
    time = course.time
    effect = curve(f"bias:time:{time[0]:.10g}:{time[-1]:.10g}:{_TERMS}")
    model = Model((*fit.model.effects, effect))
    return _joined(fit, model, effect.name, walk)


def _proved(course: Course, misfit: Array) -> bool:
    """Whether stretches that are left out are predicted better with the walk, beyond chance."""
    time, walk = course.time, course.likeliest
    unit = (time - time[0]) / max(float(np.ptp(time)), 1e-300)
    stretch = np.minimum((_STRETCHES * unit).astype(int), _STRETCHES - 1)
    out = stretch % _FOLDS == np.arange(_FOLDS)[:, None]
    variance = course.variance * np.where(out, _UNKNOWN, 1.0)
    shares = (course.shares * walk.size)[None]
    white = whitener(time, variance, shares, np.full(_FOLDS, walk.memory))
    left = variance * white.back(white(misfit[:, None]))[..., 0]
    after = left[stretch % _FOLDS, np.arange(time.size)]
    return difference(np.abs(misfit), np.abs(after), stretch, _FOLDS, "mean").plain_low > 0.0


@dataclass(frozen=True)
class _Course:
    """Of the walk as a constant and cosines of time, mg, axis by axis: mean (3, 1 + T), slope by θ
    (3 (1 + T), p), covariance; left : mg², what these cannot express of an axis' bias"""

    mean: Array
    slope: Array
    covariance: Array
    left: float


def _asked(fit: Fit, course: Course, misfit: Array) -> _Course:
    time, walk, size = course.time, course.likeliest, course.scatter / MG
    asked = np.linspace(time[0], time[-1], _MOMENTS * _TERMS)
    near = np.exp(-np.abs(time[:, None] - asked) / walk.memory)
    apart = np.exp(-np.abs(asked[:, None] - asked) / walk.memory)
    across = [walk.size[a] ** 2 * course.shares[:, a : a + 1] * near for a in range(3)]
    unit = (fit.at.unit / course.scatter)[:, None]
    white = course.whitener((walk,))(np.column_stack([misfit, fit.at.jacobian * unit, *across]))[0]
    p, g = fit.theta.size, asked.size
    r, x, c = white[:, 0], white[:, 1 : 1 + p], white[:, 1 + p :]
    prior = np.kron(np.diag(walk.size**2), apart)
    spread = prior - c.T @ c
    # A constant and cosines nearest to the course.
    phase = np.pi * (asked - time[0]) / np.ptp(time)
    basis = np.cos(np.arange(_TERMS + 1) * phase[:, None])
    nearest = np.linalg.pinv(basis)
    turn = np.kron(np.eye(3), nearest)
    mean = (c.T @ r).reshape(3, g)
    lost = np.kron(np.eye(3), np.eye(g) - basis @ nearest)
    rough = float(np.mean(np.diag(lost @ spread @ lost.T))) + float(
        np.mean((mean - mean @ nearest.T @ basis.T) ** 2)
    )
    return _Course(
        mean=size * mean @ nearest.T,
        slope=-size * turn @ (c.T @ x),
        covariance=size**2 * turn @ spread @ turn.T,
        left=size**2 * rough,
    )


def _joined(fit: Fit, model: Model, name: str, walk: _Course) -> Fit:
    """The fit with the curve in it: the constant is the bias' own."""
    context, p = fit.observations.context, fit.theta.size
    slices, own = model.slices(context), fit.model.slices(context)
    count = 3 * (_TERMS + 1)
    turn = np.zeros((len(model.parameters(context)), p + count))
    for effect, part in own.items():
        turn[slices[effect], part] = np.eye(part.stop - part.start)
    at = p + np.arange(count).reshape(3, -1)
    bias = np.arange(slices["bias"].start, slices["bias"].stop)
    turn[bias, at[:, 0]] = 1.0
    turn[np.arange(slices[name].start, slices[name].stop), at[:, 1:].ravel()] = 1.0
    theta = turn @ np.concatenate([fit.theta, walk.mean.ravel()])
    inner = fit.covariance
    cross = walk.slope @ inner
    whole = np.block(
        [[inner, cross.T], [cross, walk.covariance + walk.slope @ inner @ walk.slope.T]]
    )
    covariance = turn @ whole @ turn.T
    covariance[bias, bias] += walk.left
    return fit_at(model, fit.observations, theta, 0.5 * (covariance + covariance.T))


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
    after = before = base_left_out(found.problem, found.posterior, folds)
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
        ambiguous=ambiguities(loop.final, loop.alternatives, course.white(loop.final.at.unit)),
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
        problem = problem_of(at, refined(first, near, data, asked), plain.model)
        every = recorded_grams(problem, course)
        look = looked(problem, every, before)
        grams = every.of(look.kept)
        del every  # the products of all walks are most of the memory
        brief = search(problem, grams, beams=FOLD_BEAMS, deepest=FOLD_DEEPEST)
        found = Explored(replace(plain, observations=at.observations), problem, brief, grams)
        hypothesis = told(problem, brief).hypothesis
        closer = _together(look.values, values_found(found))
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
