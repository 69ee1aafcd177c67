"""From many tables to a fleet: each calibrated alone, then together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.lab.files import LabFiles, calibrate_files
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun, lab_calibration
from imucalib.cohort.fleet.left_out import Said, said_by
from imucalib.cohort.fleet.outcome import (
    Asked,
    Fleet,
    Member,
    Recording,
    Spread,
    noise_of,
    outliers,
    population_of,
    spread_of,
)
from imucalib.cohort.fleet.pooled import device_of
from imucalib.cohort.fleet.search import Rules
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.prior import Prior
from imucalib.errors import ImucalError, UnreadableInput, UsageError
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop.candidates import searched
from imucalib.loop.held_out import Difference, Held, by_folds, difference, errors, folds_of
from imucalib.units import MG


def with_priors(fit: Fit, said: Mapping[str, Prior], effects: Mapping[str, Effect]) -> Fit:
    """The fit with effects of whose sizes others say something: θ and covariance of both together.

    said : effect -> its sizes, in typical sizes
    """
    if not said:
        return fit
    return _combined(_extended(fit, _model(fit, said, effects)), said)


def held_out(
    fit: Fit, said: Mapping[str, Prior], effects: Mapping[str, Effect]
) -> tuple[Held, Held]:
    """Errors on each fold of the design, predicted by the rest, without and with the effects."""
    folds = folds_of(fit.observations)
    before = by_folds(fit, folds)
    if not said:
        return before, before
    model = _model(fit, said, effects)
    parts = []
    for fold in folds:
        rest = fit.observations.take(fold.rest)
        start = _start(fit, model)
        own = fit_model(model, rest, start=start, noise=fit.noise)
        parts.append(errors(own, _combined(own, said).theta, fit.observations.take(fold.rows)))
    order = np.argsort(np.concatenate([fold.rows for fold in folds]))

    def each(name: str) -> Array:
        return np.asarray(np.concatenate([getattr(part, name) for part in parts])[order])

    return before, Held(each("corrected"), each("expected"), each("error"))


def _model(fit: Fit, said: Mapping[str, Prior], effects: Mapping[str, Effect]) -> Model:
    return Model((*fit.model.effects, *(effects[name] for name in said)))


def _extended(fit: Fit, model: Model) -> Fit:
    return fit_model(model, fit.observations, start=_start(fit, model), begin=fit.noise)


def _start(fit: Fit, model: Model) -> Array:
    context = fit.observations.context
    start, slices = model.start(context), model.slices(context)
    for name, part in fit.model.slices(context).items():
        start[slices[name]] = fit.theta[part]
    return start


def _combined(fit: Fit, said: Mapping[str, Prior]) -> Fit:
    """Normal prior times normal likelihood, in typical sizes so that rounding stays small."""
    context = fit.observations.context
    typical = np.array([p.typical for p in fit.parameters])
    slices = fit.model.slices(context)
    precision = np.linalg.pinv(fit.covariance / np.outer(typical, typical), hermitian=True)
    whole, towards = precision.copy(), precision @ (fit.theta / typical)
    for name, prior in said.items():
        part, own = slices[name], prior.root.T @ prior.root
        whole[part, part] += own
        towards[part] += own @ prior.mean
    covariance = np.linalg.inv(whole)
    theta = covariance @ towards * typical
    return replace(
        fit,
        theta=theta,
        covariance=covariance * np.outer(typical, typical),
        slope=np.zeros_like(fit.slope),
    )


#: Devices up to which each one's folds are predicted, with and without what was found.
_HELD_OUT = 60


def run_fleet(
    tables: Sequence[LabFiles], request: LabRequest, rules: Rules, say: Callable[[str], None]
) -> Fleet:
    """Calibrate every table alone, find what they share, and calibrate each with it.

    Raises UsageError for fewer than two devices and for devices of different models.
    """
    alone = replace(request, loop=False)
    effects = searched(request.only, request.without, request.extra_effects).effects
    runs, failed = _calibrated(tables, alone, say)
    if len(runs) < 2:
        why = "; ".join(f"{name}: {text}" for name, text in failed)
        raise UsageError(
            f"a fleet needs two devices or more, and {len(runs)} could be calibrated"
            + (f" ({why})" if why else ""),
            remedy="give a table for each device, or calibrations (of recordings: `imucal batch`)",
        )
    say(f"{len(runs)} devices calibrated alone; searching for what they share")
    own = [device_of(name, run.result.final, effects) for name, run in runs]
    said = said_by(own, rules, request.seed, say, without=len(runs) <= _HELD_OUT)
    members, gain = _members(runs, said, effects)
    spreads = _spreads(members, tuple(said.following))
    fits = [run.result.final for _, run in runs]
    by_name = {one.name: one for one in spreads}
    return Fleet(
        members=members,
        failed=failed,
        search=said.search,
        spreads=spreads,
        outliers=outliers([member.name for member in members], spreads),
        difference=gain if said.search.found else None,
        asked=Asked(
            "lab", request.command, request.seed, {**request.stated(), "draws": rules.draws}
        ),
        following=population_of(
            [by_name[p.name] for p in fits[0].parameters],
            said.following,
            noise_of(fits),
            fits[0].observations.context,
            request.reference,
        ),
    )


def _calibrated(
    tables: Sequence[LabFiles], request: LabRequest, say: Callable[[str], None]
) -> tuple[list[tuple[str, LabRun]], tuple[tuple[str, str], ...]]:
    """Runs by name, and what could not be calibrated; one bad file loses no other.

    A table that is there already is no device: counted twice, it would agree with itself."""
    names = _names([files.table for files in tables])
    runs, failed = list[tuple[str, LabRun]](), list[tuple[str, str]]()
    for name, files in zip(names, tables, strict=True):
        try:
            run = calibrate_files(files, request, lambda _: None)
            _demand_new(run, runs)
            runs.append((name, run))
        except ImucalError as error:
            failed.append((name, str(error)))
            say(f"{name}: {error}")
    return runs, tuple(failed)


def _demand_new(run: LabRun, others: Sequence[tuple[str, LabRun]]) -> None:
    own = run.outcome.provenance.sha256
    for name, other in others:
        if other.outcome.provenance.sha256 == own:
            raise UnreadableInput(f"the same table as {name}", remedy="give each device once")


def _names(paths: Sequence[Path]) -> list[str]:
    stems = [path.stem for path in paths]
    if len(set(stems)) == len(stems):
        return stems
    return [f"{path.parent.name}_{path.stem}" if path.parent.name else path.stem for path in paths]


def _members(
    runs: Sequence[tuple[str, LabRun]], said: Said, effects: Mapping[str, Effect]
) -> tuple[tuple[Member, ...], Difference | None]:
    """Held out is what the others alone have found and sized."""
    members, pairs = list[Member](), list[tuple[Array, Array]]()
    folds = 2
    for name, run in runs:
        fit = run.result.final
        final = with_priors(fit, said.told[name], effects)
        others = said.inner.get(name, {})
        base_error = final_error = float("nan")
        if len(runs) <= _HELD_OUT:
            before, after = held_out(fit, others, effects)
            base_error, final_error = before.rms() / MG, after.rms() / MG
            pairs.append((before.size / MG, after.size / MG))
            folds = max(folds, min(len(before.size), 30))
        result = replace(run.result, final=final)
        made = lab_calibration(run.outcome, result, run.raw, run.details)
        one = Recording(name, run.outcome.provenance, made)
        members.append(Member(name, (one,), base_error, final_error, tuple(others)))
    if not pairs:
        return tuple(members), None
    before_all = np.concatenate([before for before, _ in pairs])
    after_all = np.concatenate([after for _, after in pairs])
    # Of these devices, not of the next: every position that was left out is one number.
    gain = difference(before_all, after_all, np.arange(len(before_all)), folds, "rms")
    return tuple(members), gain


def _spreads(members: Sequence[Member], pooled: Sequence[str]) -> tuple[Spread, ...]:
    """Every parameter that all members have, without effects whose sizes are pooled already: there
    each device's value leans on the others'."""
    made = [r.calibration for m in members for r in m.recordings if r.calibration]
    tables = [{p.name: p for p in one.parameters if p.effect not in pooled} for one in made]
    shared = [name for name in tables[0] if all(name in table for table in tables)]
    return tuple(
        spread_of(
            name,
            tables[0][name].unit,
            np.array([table[name].value for table in tables]),
            np.array([table[name].sd for table in tables]),
        )
        for name in shared
    )
