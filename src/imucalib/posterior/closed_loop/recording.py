"""The closed loop of a recording: the same posterior where the bias walks through all of it.

What is missing moves the point of linearisation, the scatter and the weights of runs that seemed
outliers beside it: all are made anew beside what is told, until that stands still.

The course of a bias that drifts, where it is the sensor's, is the walk's posterior mean, followed.
Given what is read, the walk at any moments g is normal, C its covariance with the readings:

    w_g | y, θ ~ N(Cᵀ V⁻¹ (y - X θ),  K_gg - Cᵀ V⁻¹ C)

A calibration holds it as a smooth curve of time. It is followed only where short stretches of the
recording, each predicted by the others, are told no worse with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.effects.forms import curve
from imucalib.effects.scans import moment_of
from imucalib.errors import NotConverged
from imucalib.posterior.candidates import SearchedEffects
from imucalib.posterior.closed_loop.closed import accept_or_reject, start_loop
from imucalib.posterior.closed_loop.folds import LeftOut, base_left_out
from imucalib.posterior.closed_loop.found import FitLoop
from imucalib.posterior.closed_loop.recorded import (
    RunCourse,
    course_of,
    fit_at,
    multiply_course,
    score_walks,
    whitener,
    with_jumps,
)
from imucalib.posterior.closed_loop.separation import ambiguities
from imucalib.posterior.closed_loop.sums import sums_of
from imucalib.posterior.closed_loop.words import SelectedModel, rivals_of, select_model
from imucalib.posterior.held_out import (
    Difference,
    Predictions,
    difference,
    folds_of,
    parts_of,
)
from imucalib.posterior.odds import EVERY, FOLD_BEAMS, FOLD_DEEPEST, SEARCHES, STRETCHES
from imucalib.posterior.search.catalogue import Component, Member, components_of
from imucalib.posterior.search.driver import search_until_settled
from imucalib.posterior.search.explored import (
    SearchedPosterior,
    keep_plausible_noises,
    refine_scans,
    values_found,
)
from imucalib.posterior.search.problem import Problem, problem_of
from imucalib.posterior.search.solution import Solved, solve
from imucalib.posterior.search.space import Hypothesis, search
from imucalib.units import MG

#: Cosines of the curve, and moments of each at which the walk is predicted.
_TERMS, _MOMENTS = 24, 4
_UNKNOWN = 1e8  # times the variance of a run that is left out


@dataclass(frozen=True)
class ClosedRecording:
    """A finished loop. course : the noise beside its final model; before, after : every run
    predicted without its block of time, by the base model and by what the search finds there"""

    loop: FitLoop
    course: RunCourse
    before: Predictions
    after: Predictions


def close_recording(
    plain: Fit, wanted: SearchedEffects, known: Array, *, curves: bool = True
) -> ClosedRecording:
    """Search beside a fitted base model, and judge on blocks of time what that was worth.

    known : (n,) m²/s⁴, the part of each run's variance that its windows and the resolution explain
    """
    found, course, said = _search_posterior(plain, wanted, known)
    problem, posterior = found.problem, found.posterior
    data = found.base.observations
    own = course.scatter * np.sqrt(course.variance)  # of each run, beside the walk
    data = replace(data, sigma=np.broadcast_to(own[:, None, None], data.sigma.shape).copy())

    def refit_at(one: Solved) -> Fit:
        return fit_at(one.model, data, one.theta, one.covariance)

    base = refit_at(solve(problem, posterior.grams, posterior.base))
    loop, left = accept_or_reject(
        replace(start_loop(base, plain, wanted, said), as_recorded=base),
        said,
        refit_at,
        _gain,
        curves=curves,
    )
    before = left.before if left else base_left_out(problem, posterior, folds_of(data))
    course, drift = course_of(loop.final, known, course)
    loop = replace(
        loop,
        as_recorded=loop.final,
        weighed=rivals_of(problem, posterior),
        drift=drift,
        ambiguous=ambiguities(loop.final, loop.alternatives, course.white(loop.final.at.unit)),
        sums=sums_of(problem, posterior, base, drift.scatter, drift.size),
    )
    return ClosedRecording(loop, course, before, left.after if left else before)


def _search_posterior(
    plain: Fit, wanted: SearchedEffects, known: Array
) -> tuple[SearchedPosterior, RunCourse, SelectedModel[Problem]]:
    """The posterior where it stands still: at what it tells, and at the noise beside that."""
    data = plain.observations
    every = components_of(plain.model, data, wanted, walks=True)

    def brief(state: _Beside) -> _Look:
        components = refine_scans(every, state.values, data, wanted)
        searched, leading = _look(state.fit, plain, components, state.course, state.before)
        selected = select_model(searched.problem, searched.posterior)
        likely = values_found(searched)
        values = {
            name: sorted({*leading.get(name, ()), *likely.get(name, ())})
            for name in (*leading, *likely)
        }
        scans = frozenset((*values, *state.values))
        return _Look(searched, selected.hypothesis, values, scans)

    def refit(state: _Beside, look: _Look) -> tuple[_Beside, bool] | None:
        try:
            one = solve(look.searched.problem, look.searched.every, look.selected)
            fit = fit_at(one.model, data, one.theta, one.covariance)
        except NotConverged:  # it is told where it stands, and corrects nothing
            return None
        course, _ = course_of(fit, known, state.course)
        return _Beside(fit, course, look.told, look.values), False

    settled = search_until_settled(
        _Beside(plain, course_of(plain, known)[0]),
        brief,
        refit,
        told=lambda look: (frozenset(m.free for m, _ in look.told), look.scans),
        held=lambda at: (frozenset(m.free for m, _ in at.before), frozenset(at.values)),
        rounds=SEARCHES,
    )
    found = settled.found.searched
    whole = replace(found, posterior=search(found.problem, found.every))
    whole = replace(whole, posterior=keep_plausible_noises(whole))
    return whole, settled.state.course, select_model(whole.problem, whole.posterior)


@dataclass(frozen=True)
class _Beside:
    """A fit with what was told before, members and sizes, the noise beside it, and values around
    which scans are refined."""

    fit: Fit
    course: RunCourse
    before: tuple[tuple[Member, float], ...] = ()
    values: Mapping[str, Sequence[str]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Look:
    """A brief search; selected : what it tells; values : of scans, that count in it; scans : of
    these and of those before it"""

    searched: SearchedPosterior
    selected: Hypothesis
    values: Mapping[str, Sequence[str]]
    scans: frozenset[str]

    @property
    def told(self) -> tuple[tuple[Member, float], ...]:
        """Members and sizes."""
        choices = self.searched.problem.choices
        return tuple((choices[p.choice].member, p.size) for p in self.selected.picks)


def _look(
    fit: Fit,
    plain: Fit,
    components: tuple[Component, ...],
    course: RunCourse,
    before: Sequence[tuple[Member, float]],
) -> tuple[SearchedPosterior, dict[str, list[str]]]:
    """The posterior by a brief search beside a fit, and what `score_walks` says of scans."""
    data = plain.observations
    scaled = replace(data, sigma=np.full_like(data.sigma, course.scatter))
    at = fit_at(fit.model, scaled, fit.theta, fit.covariance)
    problem = problem_of(at, components, plain.model)
    every = multiply_course(problem, course)
    problem = with_jumps(problem, every)
    kept, leading = score_walks(problem, every, before)
    grams = every.of(kept)
    brief = search(problem, grams, beams=FOLD_BEAMS, deepest=FOLD_DEEPEST)
    return SearchedPosterior(replace(plain, observations=scaled), problem, brief, grams), leading


def _gain(final: Fit, left: LeftOut) -> Difference:
    """What blocks of time gain but for those that hold a moment at which something changes: without
    one nobody knows when within it that was."""
    folds, time = folds_of(final.observations), final.observations.context["time"]
    part, every = parts_of(folds), np.arange(time.size)
    moments = np.array([moment_of(name) for name in final.model.names])
    hidden = []
    for k, fold in enumerate(folds):
        gone = time[np.setdiff1d(every, fold.rest)]
        if np.any((moments >= gone.min()) & (moments <= gone.max())):
            hidden.append(k)
    good = ~np.isin(part, [folds[k].rows[0] for k in hidden])
    sizes = left.before.size[good], left.after.size[good]
    return difference(*sizes, part[good], len(folds) - len(hidden), "mean")


def follow_bias(fit: Fit, course: RunCourse) -> Fit | None:
    """The fit with the course of its bias, or None where none is likely or held-out stretches speak
    against it; course : the noise beside the fit."""
    misfit = fit.at.residual * fit.at.unit / course.scatter
    if not course.likeliest.size.any() or not _holds(course, misfit):
        return None
    time = course.time
    effect = curve(f"bias:time:{time[0]:.10g}:{time[-1]:.10g}:{_TERMS}")
    model = Model((*fit.model.effects, effect))
    return _join_curve(fit, model, effect.name, _curve_of_walk(fit, course, misfit))


def _holds(course: RunCourse, misfit: Array) -> bool:
    """Whether stretches that are left out are predicted no worse with the walk."""
    time, walk = course.time, course.likeliest
    unit = (time - time[0]) / max(float(np.ptp(time)), 1e-300)
    stretch = np.minimum((STRETCHES * unit).astype(int), STRETCHES - 1)
    out = stretch % EVERY == np.arange(EVERY)[:, None]
    variance = course.variance * np.where(out, _UNKNOWN, 1.0)
    shares = (course.shares * walk.size)[None]
    white = whitener(time, variance, shares, np.full(EVERY, walk.memory))
    predicted = variance * white.back(white(misfit[:, None]))[..., 0]
    after = predicted[stretch % EVERY, np.arange(time.size)]
    return difference(np.abs(misfit), np.abs(after), stretch, EVERY, "mean").holds


@dataclass(frozen=True)
class _Curve:
    """The walk as a constant and cosines of time, mg, axis by axis: mean (3, 1 + T), slope by θ
    (3 (1 + T), p), covariance; rough : mg², what these cannot express of an axis' bias"""

    mean: Array
    slope: Array
    covariance: Array
    rough: float


def _curve_of_walk(fit: Fit, course: RunCourse, misfit: Array) -> _Curve:
    time, walk, size = course.time, course.likeliest, course.scatter / MG
    moments = np.linspace(time[0], time[-1], _MOMENTS * _TERMS)
    across = np.exp(-np.abs(time[:, None] - moments) / walk.memory)
    apart = np.exp(-np.abs(moments[:, None] - moments) / walk.memory)
    columns = [walk.size[a] ** 2 * course.shares[:, a : a + 1] * across for a in range(3)]
    unit = (fit.at.unit / course.scatter)[:, None]
    white = course.whitener((walk,))(np.column_stack([misfit, fit.at.jacobian * unit, *columns]))[0]
    p, g = fit.theta.size, moments.size
    r, x, c = white[:, 0], white[:, 1 : 1 + p], white[:, 1 + p :]
    prior = np.kron(np.diag(walk.size**2), apart)
    spread = prior - c.T @ c
    # A constant and cosines nearest to the course.
    phase = np.pi * (moments - time[0]) / np.ptp(time)
    basis = np.cos(np.arange(_TERMS + 1) * phase[:, None])
    nearest = np.linalg.pinv(basis)
    turn = np.kron(np.eye(3), nearest)
    mean = (c.T @ r).reshape(3, g)
    lost = np.kron(np.eye(3), np.eye(g) - basis @ nearest)
    rough = float(np.mean(np.diag(lost @ spread @ lost.T))) + float(
        np.mean((mean - mean @ nearest.T @ basis.T) ** 2)
    )
    return _Curve(
        mean=size * mean @ nearest.T,
        slope=-size * turn @ (c.T @ x),
        covariance=size**2 * turn @ spread @ turn.T,
        rough=size**2 * rough,
    )


def _join_curve(fit: Fit, model: Model, name: str, walk: _Curve) -> Fit:
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
    inner, cross = fit.covariance, walk.slope @ fit.covariance
    whole = np.block([[inner, cross.T], [cross, walk.covariance + cross @ walk.slope.T]])
    covariance = turn @ whole @ turn.T
    covariance[bias, bias] += walk.rough
    return fit_at(model, fit.observations, theta, 0.5 * (covariance + covariance.T))
