"""From many tables to a fleet: each calibrated alone, then together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibrators.lab.calibration import lab_calibration
from imucalib.calibrators.lab.files import LabFiles, calibrate_files
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun
from imucalib.calibrators.population import Population
from imucalib.cohort.fleet.device import Device, device_of, moderated
from imucalib.cohort.fleet.following import population_of
from imucalib.cohort.fleet.left_out import foretold, next_size
from imucalib.cohort.fleet.pooled import told_by_others
from imucalib.cohort.fleet.search import Rules, Search, search
from imucalib.cohort.fleet.shrunk import Prior, held_out, with_priors
from imucalib.cohort.fleet.spread import Outlier, Spread, outliers, spread_of
from imucalib.core.effect import Effect
from imucalib.errors import ImucalError, UsageError
from imucalib.loop.asked import searched
from imucalib.loop.difference import Difference, difference
from imucalib.units import MG

#: Devices up to which each one's folds are predicted, with and without what was found.
_HELD_OUT = 60
_GROUPS = 20


@dataclass(frozen=True)
class Member:
    """A device of the fleet. base, final : held-out rms, mg, NaN where not computed
    calibration : with the fleet's effects; told : effects that the others find without it, which
    `final` stands on"""

    name: str
    run: LabRun
    calibration: Calibration
    base: float
    final: float
    told: tuple[str, ...] = ()


@dataclass(frozen=True)
class Fleet:
    """members : in the order given; failed : file -> why it is no member
    difference : held-out error over all members, mg, None where nothing was found
    following : what it says of the next device, None for fewer than four"""

    members: tuple[Member, ...]
    failed: tuple[tuple[str, str], ...]
    search: Search
    spreads: tuple[Spread, ...]
    outliers: tuple[Outlier, ...]
    difference: Difference | None
    request: LabRequest
    following: Population | None = None

    @property
    def verdict(self) -> str:
        """ "explained", "suspected", "unexplained" or "nothing found"."""
        if not self.search.found:
            return "unexplained" if self.search.refused else "nothing found"
        proved = self.difference is not None and self.difference.proved
        return "explained" if proved else "suspected"

    @property
    def exit_code(self) -> int:
        """5 where something is left open: a suspicion, an outlying device, a file that failed."""
        open_ = self.verdict in ("suspected", "unexplained") or self.outliers or self.failed
        return 5 if open_ else 0


def run_fleet(
    tables: Sequence[LabFiles], request: LabRequest, rules: Rules, say: Callable[[str], None]
) -> Fleet:
    """Calibrate every table alone, find what they share, and calibrate each with it.

    Raises UsageError for fewer than two devices and for devices of different models.
    """
    alone = replace(request, settings=replace(request.settings, loop=False))
    effects = searched(
        request.settings.only, request.settings.without, request.settings.extra_effects
    ).effects
    runs, failed = _calibrated(tables, alone, say)
    if len(runs) < 2:
        why = "; ".join(f"{name}: {text}" for name, text in failed)
        raise UsageError(
            f"a fleet needs two devices or more, and {len(runs)} could be calibrated" + (
                f" ({why})" if why else ""),
            remedy="give a table for each device",
        )  # fmt: skip
    say(f"{len(runs)} devices calibrated alone; searching for what they share")
    own = [device_of(name, run.result.final, effects) for name, run in runs]
    devices = moderated(own)
    found = search(devices, rules, np.random.default_rng(request.seed))
    for one in found.found:
        say(f"{one.effect}: in {len(one.able)} devices, p {one.pooled.p:.2g}")
    priors = _priors(devices, found, effects)
    inner: dict[str, list[Prior]] = {}
    if found.found and len(runs) <= _HELD_OUT:
        inner = foretold(own, effects, rules, request.seed)
    members, gain = _members(runs, priors, inner, bool(found.found))
    spreads = _spreads(members)
    names = tuple(member.name for member in members)
    return Fleet(
        members=members,
        failed=failed,
        search=found,
        spreads=spreads,
        outliers=outliers(names, spreads),
        difference=gain,
        request=request,
        following=population_of(
            [run.result.final for _, run in runs],
            spreads,
            {one.effect: next_size(devices, one.effect) for one in found.found},
            request.reference,
        ),
    )


def _calibrated(
    tables: Sequence[LabFiles], request: LabRequest, say: Callable[[str], None]
) -> tuple[list[tuple[str, LabRun]], tuple[tuple[str, str], ...]]:
    """Runs by name, and what could not be calibrated; one bad file loses no other."""
    names = _names([files.table for files in tables])
    runs, failed = list[tuple[str, LabRun]](), list[tuple[str, str]]()
    for name, files in zip(names, tables, strict=True):
        try:
            runs.append((name, calibrate_files(files, request, lambda _: None)))
        except ImucalError as error:
            failed.append((name, str(error)))
            say(f"{name}: {error}")
    return runs, tuple(failed)


def _names(paths: Sequence[Path]) -> list[str]:
    stems = [path.stem for path in paths]
    if len(set(stems)) == len(stems):
        return stems
    return [f"{path.parent.name}_{path.stem}" if path.parent.name else path.stem for path in paths]


def _priors(
    devices: Sequence[Device], found: Search, effects: Mapping[str, Effect]
) -> dict[str, list[Prior]]:
    """Of each device what the others say, effect by effect."""
    every: dict[str, list[Prior]] = {device.name: [] for device in devices}
    for one in found.found:
        able = [device for device in devices if one.effect in device.columns]
        at = [device.columns[one.effect] for device in able]
        gram = np.stack([d.gram[np.ix_(k, k)] for d, k in zip(able, at, strict=True)])
        along = np.stack([d.along[k] for d, k in zip(able, at, strict=True)])
        told = told_by_others(gram, along, min(len(able), _GROUPS))
        for device, (mean, covariance) in zip(able, told, strict=True):
            every[device.name].append(Prior(effects[one.effect], mean, covariance))
    return every


def _members(
    runs: Sequence[tuple[str, LabRun]],
    priors: Mapping[str, list[Prior]],
    inner: Mapping[str, list[Prior]],
    found: bool,
) -> tuple[tuple[Member, ...], Difference | None]:
    """inner : of each device, as the others alone have found and sized it: what is held out"""
    members, pairs = list[Member](), list[tuple[Array, Array]]()
    folds = 2
    for name, run in runs:
        fit = run.result.final
        final = with_priors(fit, priors[name])
        base_error = final_error = float("nan")
        if len(runs) <= _HELD_OUT:
            before, after = held_out(fit, inner.get(name, []))
            base_error, final_error = before.rms() / MG, after.rms() / MG
            pairs.append((before.size / MG, after.size / MG))
            folds = max(folds, min(len(before.size), 30))
        result = replace(run.result, final=final)
        made = lab_calibration(run.outcome, result, run.raw, run.request, run.details)
        told = tuple(prior.effect.name for prior in inner.get(name, []))
        members.append(Member(name, run, made, base_error, final_error, told))
    gain = None
    if found and pairs:
        before_all = np.concatenate([before for before, _ in pairs])
        after_all = np.concatenate([after for _, after in pairs])
        # Of these devices, not of the next: every position that was left out is one number.
        part = np.arange(len(before_all))
        gain = difference(before_all, after_all, part, folds, "rms")
    return tuple(members), gain


def _spreads(members: Sequence[Member]) -> tuple[Spread, ...]:
    """Every parameter that all members have."""
    tables = [{p.name: p for p in member.calibration.parameters} for member in members]
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
