"""A bias that wanders so far that its course is worth following."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.difference import difference
from imucalib.loop.found import Unexplained, Wander
from imucalib.loop.wander.beside.courses import waves
from imucalib.loop.wander.beside.parts import driven
from imucalib.loop.wander.choice import Search
from imucalib.loop.wander.left.courses import FINE, curve_of
from imucalib.loop.wander.left.stretch import rest_of
from imucalib.loop.wander.left.strongest import Told, Way
from imucalib.loop.wander.left.swing import even_parts
from imucalib.loop.wander.likelihood import Terms, levels
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.walk import beside
from imucalib.loop.wander.words import unexplained

#: Scatters of a run from which on a walk is followed.
_FAR = 2.0
#: Short stretches of the recording, every twelfth of which is foretold by the others: as far from
#: what was recorded as a reading that is corrected may be.
_STRETCHES, _FOLDS = 120, 12
WANDER = "noise"


def wandering(problem: Problem, found: Search) -> Told | None:
    """The walk of the noise, with the curve of the bias that follows it; None where it is small."""
    bank, level = found.bank, found.level
    walk, parts = bank.walks[level.walk], even_parts(problem, found)
    if walk.rho == 0.0 or "bias" not in parts:
        return None
    scatter, time = problem.noise.scatter * float(np.sqrt(level.variance)), bank.course.time
    rest = rest_of(found)
    size = float(np.sqrt(np.mean((rest - beside(bank.course, walk, rest)) ** 2)))
    every = levels(bank, found.terms, np.ones(bank.course.parts, dtype=bool))
    evidence = every[level.walk].nats - every[0].nats
    wander = Wander(problem.noise.scatter * size, walk.tau / 3600.0, scatter, evidence)
    told: tuple[Unexplained, ...] = unexplained(wander)
    if not told or wander.size < _FAR * scatter:
        return None
    drive = driven(parts["bias"], waves(time, FINE))
    by = curve_of("bias", "time", time, FINE)
    return Told(Way(wander.words, "order", WANDER, drive, effect=by), told[0])


def follows(base: Terms, course: Search) -> bool:
    """Whether a search with the course behind its terms foretells short stretches better than the
    one without, beyond doubt. base : of the one without"""
    bank = course.bank
    time = bank.course.time
    unit = (time - time[0]) / max(float(np.ptp(time)), 1e-300)
    stretch = np.minimum((_STRETCHES * unit).astype(int), _STRETCHES - 1)
    sizes = [np.abs(_foretold(course, terms, stretch % _FOLDS)) for terms in (base, course.terms)]
    return difference(sizes[0], sizes[1], stretch, _FOLDS, "mean").low > 0.0


def _foretold(found: Search, terms: Terms, fold: Array) -> Array:
    """(n,) errors of rows by the rows of other folds, in units of the columns."""
    bank, errors = found.bank, np.empty(fold.size)
    x, y = bank.columns[:, terms.columns], bank.columns[:, bank.data]
    weighed = x / bank.course.variance[:, None]
    for k in np.unique(fold):
        test, rest = fold == k, fold != k
        precise = weighed[rest].T @ x[rest] + np.diag(terms.precision)
        theta = np.linalg.solve(precise, weighed[rest].T @ y[rest])
        errors[test] = y[test] - x[test] @ theta
    return errors
