"""Wrong records and slips of hand in the same posterior: each is another sheet, solved anew.

Every class of slip proposes what gains most at first glance, beside nothing and beside the
likeliest sets. The best few are solved again as sheets of their own, physics included, and what
decides is the odds of the two sheets. A record that no slip explains is set aside, its numbers
free.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.core.references import KnownVector
from imucalib.effects.record_error import GROSS_MG
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop.candidates import Searched
from imucalib.loop.faults.angles import angles
from imucalib.loop.faults.cells import base_of, blocks, cells, exchanges, other_axes, prior_of
from imucalib.loop.faults.sheet import Fault, Sheet
from imucalib.loop.posterior.gram import Grams, beside, freed, log_sum
from imucalib.loop.posterior.odds import ACCUSED, OPEN
from imucalib.loop.posterior.problem import known_sd
from imucalib.loop.posterior.solution import Explored, explored
from imucalib.loop.posterior.space import Pick, block_logs, blocks_of
from imucalib.loop.record_errors import set_aside
from imucalib.units import DEG, MG

#: Slips of one sheet, sheets that are refitted and that are searched again for each, and rows up to
#: which all are compared with all: a sheet with more slips is better written anew, longer ones are
#: recordings.
_MOST, _REFITTED, _TRIED, _LONGEST = 5, 16, 2, 250


@dataclass(frozen=True)
class Written:
    """A sheet as its rows see it; cell : (n, 3) the readings in its own unit; unit : what one
    degree is in its columns of inclination and tool-face"""

    sheet: Sheet
    cell: Array
    unit: tuple[float, float] = (1.0, 1.0)


@dataclass(frozen=True)
class Mended:
    """found : the exploration with every slip mended and every other wrong record aside
    slips : what was mended; aside : (row, probability) of the records that are set aside
    """

    found: Explored
    slips: tuple[Fault, ...] = ()
    aside: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True)
class _Trial:
    """score : nats at first glance; prior : log odds; row : that is set aside, or -1
    fault, sheet : the slip and the sheet without it, of anything else
    """

    score: float
    prior: float
    row: int = -1
    fault: Fault | None = None
    sheet: Sheet | None = None


def mended(base: Fit, asked: Searched, written: Written | None = None) -> Mended:
    """The posterior of a table with everything that is likelier wrong in it than not set right.

    written : the sheet, where its angles are known; without one only records are asked
    """
    state = Mended(explored(base, asked))
    for _ in range(_MOST):
        best = _best(state, asked, written)
        if best is None:
            break
        state, sheet = best
        written = replace(written, sheet=sheet) if written and sheet else None
    return state


def log_density(found: Explored) -> float:
    """Log evidence of a sheet over all sets and noises, with the priors of what is free in it."""
    sd = known_sd(found.base)
    told = np.isfinite(sd)
    return found.posterior.evidence + float(np.log(found.base.noise.factor / sd[told]).sum())


def _best(
    state: Mended, asked: Searched, written: Written | None
) -> tuple[Mended, Sheet | None] | None:
    """The likeliest of the sheets that are solved again, where the sheet as it stands is less
    likely than all of them together."""
    trials = [t for t in _trials(state, written) if t.score > -OPEN / 3.0]
    now, odds = log_density(state.found), []
    for trial, base in _likeliest(trials, state, written):
        found = explored(base, asked)
        odds.append((log_density(found) - now + trial.prior, trial, found))
    odds.sort(key=lambda o: -o[0])
    whole = float(log_sum(np.array([o for o, _, _ in odds]))) if odds else -np.inf
    if whole < np.log(ACCUSED):
        return None
    nats, trial, found = odds[0]
    share = float(np.exp(nats - np.logaddexp(0.0, whole)))
    if trial.fault is None:
        aside = (*state.aside, (trial.row, share))
        return replace(state, found=found, aside=aside), _sheet(written)
    near = (t.fault.line for o, t, _ in odds[1:] if t.fault and o > nats - OPEN / 3.0)
    fault = replace(trial.fault, probability=share, rivals=tuple(dict.fromkeys(near)))
    return replace(state, found=found, slips=(*state.slips, fault)), trial.sheet


def _likeliest(
    trials: Sequence[_Trial], state: Mended, written: Written | None
) -> list[tuple[_Trial, Fit]]:
    """The trials whose sheets the base model fits best, refitted: the first of every class, since
    a glance is off by more in one class than in another, then the others that are near."""
    first, others, seen = list[_Trial](), list[_Trial](), set[str]()
    for trial in sorted(trials, key=lambda t: -t.score):
        kind = trial.fault.kind if trial.fault else "record"
        if kind not in seen:
            first.append(trial)
        elif trial.score > first[0].score - OPEN:
            others.append(trial)
        seen.add(kind)
    fits = []
    for trial in (*first, *others)[:_REFITTED]:
        base = _solved_again(state.found.base, trial, written)
        if base is not None:
            fits.append((base.log_likelihood + trial.prior, trial, base))
    fits.sort(key=lambda f: -f[0])
    return [(trial, base) for _, trial, base in fits[:_TRIED]]


def _sheet(written: Written | None) -> Sheet | None:
    return written.sheet if written else None


def _trials(state: Mended, written: Written | None) -> Iterator[_Trial]:
    found = state.found
    n = found.base.observations.n
    if n > _LONGEST:
        return
    sets = _sets(found)
    sheets = _beside_each(found, sets)
    gains = np.array([_freed(found, one) for one in sheets])
    order = np.argsort(-gains.max(axis=1) - [*sets.values()])
    leading = dict.fromkeys((0, *map(int, order[:2])))
    touched = {row for fault in state.slips for row in fault.rows}
    taken = {row for row, _ in state.aside}
    alone = gains.max(axis=0) + prior_of(n)
    for row in map(int, np.argsort(-alone)[:_TRIED]):
        if row not in taken:
            yield _Trial(float(alone[row]), prior_of(n), row=row)
    if written is None:
        return
    best: dict[str, _Trial] = {}
    for k in leading:
        base = base_of(found, written.sheet, sheets[k])
        own = written.cell[written.sheet.place]
        every = (
            *exchanges(base),
            *cells(base, own),
            *blocks(base),
            *angles(base, written.unit),
            *other_axes(base),
        )
        for slip in every:
            fault, old = slip.fault, best.get(slip.fault.line)
            better = old is None or fault.score > old.score
            if better and not touched & set(fault.rows):
                best[fault.line] = _Trial(fault.score, slip.prior, fault=fault, sheet=slip.repaired)
    yield from best.values()


def _sets(found: Explored) -> dict[tuple[Pick, ...], float]:
    """Sets beside which a record may be wrong, the base model first, and how many nats each is
    behind the likeliest: what a record hides leads only once it is set right."""
    posterior = found.posterior
    behind = np.log(np.maximum(posterior.probability / posterior.probability[0], 1e-300))
    known = {h.picks: float(b) for h, b in zip(posterior.hypotheses, behind, strict=True)}
    base = posterior.base.picks
    return {base: known[base]} | {p: b for p, b in known.items() if b > -OPEN}


def _solved_again(base: Fit, trial: _Trial, written: Written | None) -> Fit | None:
    """The base model of the sheet that a trial would leave, or None where it cannot be fitted."""
    if trial.sheet is None or written is None:
        return set_aside(base, trial.row)
    data = _observed(base.observations, written.sheet, trial.sheet)
    other = fit_model(base.model, data, start=base.theta)
    return other if other.converged else None


def _observed(data: Observations, before: Sheet, after: Sheet) -> Observations:
    """The observations of a sheet that was mended."""
    kept = np.flatnonzero(np.isin(before.row, after.row))
    some = data.take(kept).with_reading(MG * after.reading[:, None])
    old = before.take(kept)
    if np.array_equal(old.inclination, after.inclination) and np.array_equal(
        old.tool_face, after.tool_face
    ):
        return some
    reference = some.reference
    assert isinstance(reference, KnownVector)
    inclination, tool_face = after.angles()
    moved = replace(
        reference,
        inclination=inclination,
        tool_face=tool_face,
        inclination_setting=_settings(reference.inclination_setting, old, after, "inclination"),
        tool_face_setting=_settings(reference.tool_face_setting, old, after, "tool_face"),
    )
    return replace(some, reference=moved, context=_turned(some.context, after))


def _settings(ids: Index, before: Sheet, after: Sheet, name: str) -> Index:
    """Setting ids of a dial once rows have other angles."""
    changed = getattr(before, name) != getattr(after, name)
    if not changed.any():
        return ids
    fresh: Index = getattr(after, f"{name}_setting")
    found = fresh if after.ordered else np.where(changed, ids.max() + 1, ids)
    # A setting that no row has any more has no number either.
    return np.asarray(np.unique(found, return_inverse=True)[1], np.intp)


def _turned(context: Context, sheet: Sheet) -> Context:
    inclination, tool_face = sheet.angles()
    found = {**context.covariates, "inclination": inclination, "tool_face": tool_face}
    dials = {"inclination_dial": sheet.inclination, "tool_face_dial": sheet.tool_face}
    found |= {name: value * DEG for name, value in dials.items() if name in context}
    return replace(context, covariates=found)


def _beside_each(found: Explored, sets: Iterable[tuple[Pick, ...]]) -> list[Grams]:
    """Of each set the Grams beside the base model and it: of the columns of all sets, then the
    readings' own numbers and y."""
    every = [blocks_of(found.problem.choices, picks) for picks in sets]
    columns = np.unique(
        np.concatenate([np.zeros(0, np.intp), *(c for one in every for c, _ in one)])
    )
    flat = freed(found.every, found.problem, columns)
    return [beside(flat, ((np.searchsorted(columns, c), s) for c, s in one)) for one in every]


def _freed(found: Explored, one: Grams) -> Array:
    """(n,) nats that freeing each record gains beside a set, before anything is solved again; one :
    the Grams beside it, the readings' own numbers before y"""
    dof, fit = found.posterior.dof, found.base
    first = one.along.shape[1] - 1 - len(fit.at.owner)
    rows = [first + np.flatnonzero(fit.at.owner == row) for row in range(fit.observations.n)]
    size = GROSS_MG * MG / float(np.median(fit.at.unit)) / fit.noise.factor
    logs = block_logs(one, np.array(rows), np.array([size]), dof)[0][..., 0]
    return log_sum(logs) - one.evidence(dof)
