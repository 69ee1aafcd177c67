"""Wrong records and slips of hand in the same posterior: each is another sheet, solved anew.

Every class of slip proposes what gains most at first glance, beside nothing and beside the
likeliest sets. The best few are solved again as sheets of their own, physics included, and what
decides is the odds of the two sheets. A record that no slip explains is set aside, its numbers
free.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.balance import below
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.core.references import KnownVector
from imucalib.effects.record_error import GROSS_MG
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.posterior.candidates import SearchedEffects
from imucalib.posterior.odds import ACCUSED, LONGEST, OPEN, REFITTED, SLIPS_TOLD, TRIED
from imucalib.posterior.record_errors import set_aside
from imucalib.posterior.search.explored import SearchedPosterior, search_posterior
from imucalib.posterior.search.gram import Grams, Multiplied, log_sum, marginalize
from imucalib.posterior.search.problem import known_sd
from imucalib.posterior.search.space import Pick, block_logs, blocks_of
from imucalib.posterior.sheet.sheet import Fault, Sheet, Trial
from imucalib.posterior.slips.angles import angles
from imucalib.posterior.slips.cells import base_of, blocks, cells, exchanges, other_axes, prior_of
from imucalib.units import DEG, MG


@dataclass(frozen=True)
class Written:
    """A sheet as its rows see it; cell : (n, 3) the readings in its own unit; unit : what one
    degree is in its columns of inclination and tool-face"""

    sheet: Sheet
    cell: Array
    unit: tuple[float, float] = (1.0, 1.0)


def repair_sheet(
    found: SearchedPosterior, wanted: SearchedEffects, written: Written | None = None
) -> SearchedPosterior:
    """The posterior of a table with everything that is likelier wrong in it than not set right.

    found : that of the table as it stands
    written : the sheet, where its angles are known; without one only records are asked
    """
    for _ in range(SLIPS_TOLD):
        best = _best(found, wanted, written)
        if best is None:
            break
        found, sheet = best
        written = replace(written, sheet=sheet) if written and sheet else None
    return found


def log_density(found: SearchedPosterior) -> float:
    """Log evidence of a sheet over all sets and noises, with the priors of what is free in it, of
    which those that the data settle are no numbers that tell of the noise."""
    sd, factor = known_sd(found.base), found.base.noise.factor
    kept = found.problem.numbers - len(found.base.at.owner)
    priors = -float(np.log(sd[np.isfinite(sd)]).sum())
    return found.posterior.evidence + priors + kept * float(np.log(factor))


def _best(
    state: SearchedPosterior, wanted: SearchedEffects, written: Written | None
) -> tuple[SearchedPosterior, Sheet | None] | None:
    """The likeliest of the sheets that are solved again, where the sheet as it stands is less
    likely than all of them together."""
    trials = [t for t in _trials(state, written) if t.fault.score > -OPEN / 3.0]
    now, odds = log_density(state), []
    for trial, base in _likeliest(trials, state, written):
        found = search_posterior(base, wanted)
        odds.append((log_density(found) - now + trial.prior, trial, found))
    odds.sort(key=lambda o: -o[0])
    whole = float(np.logaddexp.reduce([o for o, _, _ in odds])) if odds else -np.inf
    if whole < np.log(ACCUSED):
        return None
    nats, trial, found = odds[0]
    share = float(np.exp(nats - np.logaddexp(0.0, whole)))
    if trial.repaired is None:
        aside = (*state.aside, (trial.fault.rows[0], share))
        found = replace(found, slips=state.slips, aside=aside)
        return found, written.sheet if written else None
    close = (t.fault.line for o, t, _ in odds[1:] if t.repaired and o > nats - OPEN / 3.0)
    fault = replace(trial.fault, probability=share, rivals=tuple(dict.fromkeys(close)))
    assert written is not None
    place = {int(row): k for k, row in enumerate(trial.repaired.row)}
    numbers = ((int(written.sheet.row[row]), chance) for row, chance in state.aside)
    aside = tuple((place[row], chance) for row, chance in numbers if row in place)
    slips = (*state.slips, fault)
    return replace(found, slips=slips, aside=aside), trial.repaired


def _likeliest(
    trials: Sequence[Trial], state: SearchedPosterior, written: Written | None
) -> list[tuple[Trial, Fit]]:
    """The trials whose sheets the base model fits best, refitted: the first of every class, since
    a glance is off by more in one class than in another, then the others that are close."""
    first, others = dict[str, Trial](), list[Trial]()
    ranked = sorted(trials, key=lambda t: -t.fault.score)
    for trial in ranked:
        among_best = trial.fault.score > ranked[0].fault.score - OPEN
        if first.setdefault(trial.fault.kind, trial) is not trial and among_best:
            others.append(trial)
    fits = []
    for trial in (*first.values(), *others)[:REFITTED]:
        base = _solve_again(state.base, trial, written)
        if base is not None:
            fits.append((base.log_likelihood + trial.prior, trial, base))
    fits.sort(key=lambda f: -f[0])
    return [(trial, base) for _, trial, base in fits[:TRIED]]


def _trials(found: SearchedPosterior, written: Written | None) -> Iterator[Trial]:
    """Records that may be set aside, and every slip at its best, at first glance beside nothing and
    beside the sets where a record counts most."""
    n = found.base.observations.n
    if n > LONGEST:
        return
    sets = _sets(found)
    beside = _condition_on_each(found, list(sets))
    gains = np.array([_gains_of_records(found, beside(k)) for k in range(len(sets))])
    order = np.argsort(-gains.max(axis=1) - [*sets.values()])
    best, prior = gains.max(axis=0) + prior_of(n), prior_of(n)
    aside = {row for row, _ in found.aside}
    for row in map(int, np.argsort(-best)[:TRIED]):
        if row not in aside:
            yield Trial(Fault("record", "", (row,), float(best[row]), ""), None, prior)
    if written is None:
        return
    touched = {row for fault in found.slips for row in fault.rows}
    slips = dict[str, Trial]()
    for k in dict.fromkeys((0, *map(int, order[:2]))):
        base = base_of(found, written.sheet, beside(k))
        for slip in (
            *exchanges(base),
            *cells(base, written.cell[written.sheet.place]),
            *blocks(base),
            *angles(base, written.unit),
            *other_axes(base),
        ):
            old = slips.get(slip.fault.line)
            better = old is None or slip.fault.score > old.fault.score
            if better and not touched & set(slip.fault.rows):
                slips[slip.fault.line] = slip
    yield from slips.values()


def _sets(found: SearchedPosterior) -> dict[tuple[Pick, ...], float]:
    """Sets beside which a record may be wrong, the base model first, and how many nats each is
    from the likeliest: what a record hides leads only once it is set right."""
    posterior = found.posterior
    nats = np.log(np.maximum(posterior.probability / posterior.probability[0], 1e-300))
    known = {h.picks: float(b) for h, b in zip(posterior.hypotheses, nats, strict=True)}
    base = posterior.base.picks
    return {base: known[base]} | {p: b for p, b in known.items() if b > -OPEN}


def _condition_on_each(
    found: SearchedPosterior, sets: Sequence[tuple[Pick, ...]]
) -> Callable[[int], Grams]:
    """What makes of a set's place the products beside the base model and it: of one column for each
    number of a reading by itself, of the columns of all sets, and y. A number that is free is as
    good as one that is not there."""
    problem, grams, p = found.problem, found.every, found.problem.base
    every = [blocks_of(problem.choices, picks) for picks in sets]
    used = np.array(sorted({int(k) for one in every for at, _ in one for k in at}), np.intp)
    own, n = np.r_[:p, used, grams.columns.shape[1] - 1], len(grams.columns)
    columns = np.hstack([grams.columns[:, own[:p]], np.eye(n), grams.columns[:, own[p:]]])
    known = np.insert(problem.columns[n:, own], [p] * n, 0.0, axis=1)
    matrix = np.empty((len(grams.points), columns.shape[1] - p, columns.shape[1] - p))
    log_size = np.empty(len(matrix))
    for k, solve in enumerate(grams.solves):  # of many readings one noise alone fills the memory
        whole = columns.T @ solve(columns) + known.T @ known
        # The base model leaves as in `marginalize`, multiplied out.
        lower = np.linalg.cholesky(whole[:p, :p])
        across = below(lower, whole[:p, p:])
        np.subtract(whole[p:, p:], across.T @ across, out=matrix[k])
        log_size[k] = np.log(np.diag(lower)).sum()
    base = replace(
        grams,
        products=Multiplied(matrix),
        removed=np.zeros((len(matrix), 0, matrix.shape[1])),
        log_weight=grams.log_weight - log_size,
        inverse=None,
    )
    blocks = [[(n + np.searchsorted(used, at), size) for at, size in one] for one in every]
    return lambda k: marginalize(base, *blocks[k])


def _gains_of_records(found: SearchedPosterior, one: Grams) -> Array:
    """(n,) nats that freeing each record gains beside a set, before anything is solved again; one :
    the products beside it, the readings' own numbers first"""
    dof, fit = found.posterior.dof, found.base
    rows = np.arange(len(fit.at.owner)).reshape(fit.observations.n, -1)
    size = np.array([GROSS_MG * MG / float(np.median(fit.at.unit)) / fit.noise.factor])
    logs = block_logs(one, rows, size, dof)[0][..., 0]
    return np.asarray(log_sum(logs) - one.evidence(dof))


def _solve_again(base: Fit, trial: Trial, written: Written | None) -> Fit | None:
    """The base model of the sheet that a trial would leave, or None where it cannot be fitted."""
    if trial.repaired is None or written is None:
        return set_aside(base, trial.fault.rows[0])
    data = _observe(base.observations, written.sheet, trial.repaired)
    other = fit_model(base.model, data, start=base.theta)
    return other if other.converged else None


def _observe(data: Observations, before: Sheet, after: Sheet) -> Observations:
    """The observations of a sheet that was mended."""
    kept = np.flatnonzero(np.isin(before.row, after.row))
    some = data.take(kept).set_reading(MG * after.reading[:, None])
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
    return replace(some, reference=moved, context=_turn(some.context, after))


def _settings(ids: Index, before: Sheet, after: Sheet, name: str) -> Index:
    """Setting ids of a dial once rows have other angles."""
    changed = getattr(before, name) != getattr(after, name)
    if not changed.any():
        return ids
    fresh: Index = getattr(after, f"{name}_setting")
    found = fresh if after.ordered else np.where(changed, ids.max() + 1, ids)
    # A setting that no row has any more has no number either.
    return np.asarray(np.unique(found, return_inverse=True)[1], np.intp)


def _turn(context: Context, sheet: Sheet) -> Context:
    inclination, tool_face = sheet.angles()
    found = {**context.covariates, "inclination": inclination, "tool_face": tool_face}
    dials = {"inclination_dial": sheet.inclination, "tool_face_dial": sheet.tool_face}
    found |= {name: value * DEG for name, value in dials.items() if name in context}
    return replace(context, covariates=found)
