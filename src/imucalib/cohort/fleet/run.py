"""From many tables to a fleet: each calibrated alone, then together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.lab.files import LabFiles, calibrate_files
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun, lab_calibration
from imucalib.cohort.fleet.outcome import (
    DeviceRecording,
    Fleet,
    FleetMember,
    demand_new,
    noise_of,
    outliers,
    population_of,
    shared_parameters,
)
from imucalib.cohort.fleet.search import PooledDevice, Priors, Search, search_fleet
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.prior import Prior
from imucalib.errors import ImucalError, UsageError
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.posterior.candidates import effect_columns, effects_to_search, testable
from imucalib.posterior.held_out import Difference, by_folds, difference, folds_of
from imucalib.posterior.odds import ABSORBED
from imucalib.units import MG

#: λ of a candidate at typical size below which it is rounding.
_SHOWN = 1e-6
#: Devices up to which each one's folds are predicted, with and without what was found.
_HELD_OUT = 60
#: Where the others say nothing: sd of a parameter in typical sizes, and of a log of the noise.
_ANY, _ANY_NOISE = 1e9, 3.0


def run_fleet(tables: Sequence[LabFiles], request: LabRequest, say: Callable[[str], None]) -> Fleet:
    """Calibrate every table alone, find what they share, and calibrate each with it.

    Raises UsageError for fewer than two devices and for devices of different models.
    """
    alone = replace(request, loop=False)
    effects = effects_to_search(request.only, request.without, request.extra_effects).effects
    runs, failed = _calibrate_each(tables, alone, say)
    if len(runs) < 2:
        why = "; ".join(f"{name}: {text}" for name, text in failed)
        raise UsageError(
            f"a fleet needs two devices or more, and {len(runs)} could be calibrated"
            + (f" ({why})" if why else ""),
            remedy="give a table for each device, or calibrations (of recordings: `imucal batch`)",
        )
    say(f"{len(runs)} devices calibrated alone; searching for what they share")
    fits = [run.result.final for _, run in runs]
    own = [_device_of(name, run.result.final, effects) for name, run in runs]
    said = search_fleet(own, say, without=len(runs) <= _HELD_OUT)
    members, gain = _members(runs, said, effects)
    spreads = shared_parameters(members, tuple(said.following))
    return Fleet(
        members=members,
        failed=failed,
        search=said,
        spreads=spreads,
        outliers=outliers([member.name for member in members], spreads),
        difference=gain if said.found else None,
        calibrator="lab",
        command=request.command,
        settings=request.describe_settings(),
        following=population_of(
            [p.name for p in fits[0].parameters],
            spreads,
            said.following,
            noise_of(fits),
            fits[0].observations.context,
            request.reference,
        ),
    )


def _calibrate_each(
    tables: Sequence[LabFiles], request: LabRequest, say: Callable[[str], None]
) -> tuple[list[tuple[str, LabRun]], tuple[tuple[str, str], ...]]:
    """Runs by name, and what could not be calibrated; one bad file loses no other."""
    paths = [files.table for files in tables]
    names = [path.stem for path in paths]
    if len(set(names)) < len(names):
        names = ["_".join(filter(None, (path.parent.name, path.stem))) for path in paths]
    runs, failed, known = list[tuple[str, LabRun]](), list[tuple[str, str]](), dict[str, str]()
    for name, files in zip(names, tables, strict=True):
        try:
            run = calibrate_files(files, request, lambda _: None)
            demand_new(DeviceRecording(name, run.calibration), known, "table")
            runs.append((name, run))
        except ImucalError as error:
            failed.append((name, str(error)))
            say(f"{name}: {error}")
    return runs, tuple(failed)


def _device_of(name: str, fit: Fit, effects: Mapping[str, Effect]) -> PooledDevice:
    """All effects that the data can carry and the base model does not absorb."""
    white, q = fit.white_basis()
    residual = white(fit.at.residual) / fit.noise.factor
    kept, columns, at = list[Array](), dict[str, Index](), 0
    for effect in testable(fit, effects.values()):
        whole = white(effect_columns(fit, effect)) / fit.noise.factor
        rest = whole - q @ (q.T @ whole)
        size = float(np.linalg.norm(rest))
        if size < ABSORBED * float(np.linalg.norm(whole)) or size < _SHOWN:
            continue
        columns[effect.name] = np.arange(at, at + rest.shape[1])
        kept.append(rest)
        at += rest.shape[1]
    every = np.column_stack(kept) if kept else np.zeros((residual.size, 0))
    return PooledDevice(
        name, fit.noise.factor, columns, every.T @ every, every.T @ residual, float(fit.dof)
    )


def _members(
    runs: Sequence[tuple[str, LabRun]], said: Search, effects: Mapping[str, Effect]
) -> tuple[tuple[FleetMember, ...], Difference | None]:
    """Held out is what the others alone have found and sized."""
    members, pairs = list[FleetMember](), list[tuple[Array, Array]]()
    folds = 2
    for name, run in runs:
        fit = run.result.final
        final = _add_priors(fit, said.by_others[name], effects)
        others = said.unseen.get(name, {})
        base_error = final_error = float("nan")
        if len(runs) <= _HELD_OUT:
            design = folds_of(fit.observations)
            pair = (fit, _add_priors(fit, others, effects))
            before, after = (by_folds(one, design) for one in pair)
            base_error, final_error = before.rms() / MG, after.rms() / MG
            pairs.append((before.size / MG, after.size / MG))
            folds = max(folds, min(len(before.size), 30))
        result = replace(run.result, final=final)
        made = lab_calibration(run.outcome, result, run.raw, run.details)
        one = DeviceRecording(name, made)
        members.append(FleetMember(name, (one,), base_error, final_error, tuple(others)))
    if not pairs:
        return tuple(members), None
    before_all, after_all = (np.concatenate(sizes) for sizes in zip(*pairs, strict=True))
    # Of these devices, not of the next: every position that was left out is one number.
    gain = difference(before_all, after_all, np.arange(len(before_all)), folds, "rms")
    return tuple(members), gain


def _add_priors(fit: Fit, said: Priors, effects: Mapping[str, Effect]) -> Fit:
    """The fit with effects of whose sizes others say something: θ and covariance of both together,
    the base model's parameters and the noise as its own data say.

    said : effect -> its sizes, in typical sizes
    """
    if not said:
        return fit
    context = fit.observations.context
    model = Model((*fit.model.effects, *(effects[name] for name in said)))
    mean, slices = model.start(context), model.slices(context)
    for name, part in fit.model.slices(context).items():
        mean[slices[name]] = fit.theta[part]
    typical, root = np.array([p.typical for p in model.parameters(context)]), np.eye(mean.size)
    root /= _ANY * typical
    for name, prior in said.items():
        part = slices[name]
        mean[part] = prior.mean * typical[part]
        root[part, part] = prior.root / typical[part]
    noise = np.log(np.maximum([fit.noise.factor, *fit.noise.sd], 1e-9))
    known = Prior(mean, root, np.column_stack([noise, np.full(noise.size, _ANY_NOISE)]))
    return fit_model(model, fit.observations, start=mean, begin=fit.noise, prior=known)
