"""A calibration of one sensor made ready for a recording: what it needs, what it has to do without,
how far it reaches.

An effect whose covariate was not recorded acts as in the middle of what was calibrated, which
leaves the least of it, or as at its end where time drives it; that, and samples beyond the
calibrated range, are counted and said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import chain, product

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration, lacking, where_assumed
from imucalib.calibration.file import identity
from imucalib.calibration.gyroscope import correct_rates, gyroscope_of
from imucalib.calibration.series import part_at, parts_of
from imucalib.calibration.shared_gravity import GravityAtRest
from imucalib.calibration.undo import Undo
from imucalib.core.effect import Context, Effect, Truth
from imucalib.effects.thermal import LAG, ROWS
from imucalib.errors import UnreadableInput, UsageError
from imucalib.recording.identity import accelerometer_of, says_which
from imucalib.recording.recording import AppliedCalibration as Mark
from imucalib.recording.recording import Channel, Recording
from imucalib.recording.sensors import accelerometer
from imucalib.rests.thermal import (
    ThermalHistory,
    is_remembered,
    lacks_temperature,
    pair_thermometer,
    remember,
    temperature_at,
    thermal_history,
    thermometer_of,
)
from imucalib.units import MG, STANDARD_GRAVITY

Spans = Mapping[str, tuple[float, float]]
#: Covariates with a range: what a message calls them, and their unit.
_RANGED = {"temperature": ("temperature", " °C"), "order": ("time as a share of the session", "")}
_MARGIN = 0.1  # share of a range by which a sample may leave it
_AS_WARM = (
    "the sensor is taken to be as warm as its thermometer: in what the calibration's rows tell of "
    "its lag there is no time"
)
_GRAVITY = 1.1 * STANDARD_GRAVITY  # m/s² on one axis: calibrations by gravity see no more


class Corrector:
    """Corrects a recording of one sensor, block by block, and remembers what to say of it.

    sensor : which one, empty where there is one; use : "parts" or "whole" of a calibration in
    parts, by default what it says; again : correct what is corrected already
    """

    def __init__(
        self, calibration: Calibration, sensor: str, *, use: str | None, again: bool
    ) -> None:
        self._calibration, self._sensor, self._again = calibration, sensor, again
        self._parts = parts_of(calibration, use)
        chosen = [own for _, own in self._parts] or [calibration]
        self._models = [one.model() for one in chosen]
        self._undo = [Undo(model, theta) for model, theta in self._models]
        models = [model for model, _ in self._models]
        self._needs = {n for model in models for effect in model.effects for n in effect.needs}
        self._by_rows = {n for n in self._needs if n.startswith(LAG.prefix) and n.endswith(ROWS)}
        # What the temperature's past tells, and whether its present tells something.
        self._remembered = sorted(filter(is_remembered, self._needs))
        self._warm = "temperature" in self._needs or bool(self._by_rows)
        self._history: ThermalHistory | None = None
        self._gyro = gyroscope_of(calibration)
        self._bent = any(undo.bent for undo in self._undo)
        self._samples = self._far = self._unsettled = self._unheard = 0
        self._left: dict[str, tuple[int, float, float]] = {}
        self._held: dict[str, None] = {}
        self._rests, self._said, self._path = GravityAtRest(), again, ""

    def correct_blocks(self, blocks: Callable[[], Iterator[Recording]]) -> Iterator[Recording]:
        """The blocks of a recording with acceleration, and rate, corrected; what follows the
        temperature goes through them twice. Errors as of `apply.apply_to_recording`."""
        if self._warm or self._remembered:
            name, found = self._name_thermometer(blocks())
            self._history = thermal_history(found, name)
        name, found = self._name_thermometer(blocks())
        alone = ((block, None) for block in found)
        for block, thermometer in pair_thermometer(found, name) if self._warm else alone:
            yield self._block(block, thermometer)
        if not self._said:
            stated = self._calibration.find_error({"mg": 1.0}, "final")
            self._rests.demand_better(self._calibration.gravity, stated, self._path)

    def _name_thermometer(self, found: Iterator[Recording]) -> tuple[str, Iterator[Recording]]:
        """The sensor whose thermometer counts, and the blocks."""
        first = next(found, None)
        if first is None:
            return "", iter(())
        self._sensor = accelerometer_of(self._calibration.sensor, first, self._sensor).triad
        self._said = self._again or says_which(self._calibration.sensor, first, self._sensor)
        self._path = first.path
        return self._sensor, chain([first], found)

    def _block(self, recording: Recording, thermometer: Channel | None) -> Recording:
        calibration = self._calibration
        name, channel = self._choose(recording)
        if not self._again:
            refuse_second(recording, channel.triad)
        thermometer = thermometer or thermometer_of(recording, channel.triad)
        values = self._force(recording, channel, thermometer)
        self._rests.add(channel, values)
        note = f"{name} corrected with a calibration by {calibration.calibrator}"
        if self._parts:
            count = len(self._parts)
            note += f", each sample with the one of {count} parts that is valid at its time"
        done = replace(
            recording,
            channels={**recording.channels, name: replace(channel, values=values)},
            notes=(*recording.notes, note),
            corrections=(*recording.corrections, mark_of(calibration, channel.triad)),
        )
        if self._gyro is None:
            return done
        return correct_rates(self._gyro, done, channel.triad, thermometer)

    def _choose(self, recording: Recording) -> tuple[str, Channel]:
        channel = accelerometer(recording, self._sensor)
        if channel.unit != "m/s2":
            raise UnreadableInput(
                f"the acceleration has no scale (unit {channel.unit})",
                where=recording.path,
                remedy="give --unit, or --unit counts with --lsb",
            )
        name = next(n for n, c in recording.channels.items() if c is channel)
        return name, channel

    def _force(self, recording: Recording, channel: Channel, thermometer: Channel | None) -> Array:
        """Specific force (n, 3) m/s² of a block. Raises UnreadableInput where a covariate is
        missing of which not even the calibrated range is known."""
        known = self._find_covariates(recording, channel, thermometer)
        context = Context(len(channel.t), self._complete(known, len(channel.t), recording))
        self._samples += len(channel.t)
        if self._bent:
            x, y, z = np.abs(channel.values).T > _GRAVITY
            self._far += int(np.count_nonzero(x | y | z))
        if not self._parts:
            return self._of_part(0, channel.values, context)
        out, valid = np.empty_like(channel.values), part_at(self._parts, known["time"])
        for number in np.unique(valid):
            rows = np.flatnonzero(valid == number)
            out[rows] = self._of_part(int(number), channel.values[rows], context.take(rows))
        return out

    def _of_part(self, number: int, values: Array, context: Context) -> Array:
        force, settled = self._undo[number](values, context)
        self._unsettled += int((~settled).sum())
        return force

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done without, and what lies beyond the calibrated range."""
        found = [*self._held, *self._rests.words(self._calibration.gravity)]
        for name, (count, lowest, highest) in self._left.items():
            word, unit = _RANGED[name]
            low, high = self._calibration.valid[name]
            found.append(
                f"{count} of {self._samples} samples lie outside the calibrated {word}, "
                f"{low:.3g} to {high:.3g}{unit}: {lowest:.3g} to {highest:.3g}{unit} were "
                "recorded; their correction is extrapolated"
            )
        if self._unheard:
            found.append(
                f"{self._unheard} of {self._samples} samples have no temperature, for the "
                "thermometer jumps there as no case can: what depends on it acts as in the middle "
                "of what was calibrated"
            )
        if self._far:
            found.append(
                f"{self._far} of {self._samples} samples read more than 1.1 g on an axis, beyond "
                "what gravity calibrates: the curved part of their correction is extrapolated"
            )
        if self._unsettled:
            found.append(
                f"{self._unsettled} of {self._samples} samples lie where the curved part cannot be "
                "undone: the linear part alone corrects them"
            )
        return tuple(found)

    def _find_covariates(
        self, recording: Recording, channel: Channel, thermometer: Channel | None
    ) -> dict[str, Array]:
        known, history = _clock(self._calibration, recording, channel), self._history
        if thermometer is not None:
            known |= self._warmth(thermometer, channel.t)
            if self._by_rows:
                self._held[_AS_WARM] = None
        if history is not None and history.time.size:
            known |= {name: remember(history, name, channel.t) for name in self._remembered}
        for name in _RANGED:
            if name in self._needs and name in known:
                self._count(name, known[name])
        return known

    def _warmth(self, thermometer: Channel, at: Array) -> dict[str, Array]:
        """The temperature (n,) by the names that it has; where the thermometer jumps, the middle of
        what was calibrated, as without one."""
        warm, history = temperature_at(thermometer, at), self._history
        names = sorted({"temperature", *self._by_rows})
        lost = None if history is None else lacks_temperature(thermometer, history, at)
        if not self._warm or lost is None or not lost.any():
            return dict.fromkeys(names, warm)
        self._unheard += int(lost.sum())
        valid = self._calibration.valid
        return {n: np.where(lost, 0.5 * sum(valid[n]), warm) for n in names if n in valid}

    def _count(self, name: str, values: Array) -> None:
        low, high = self._calibration.valid.get(name, (-np.inf, np.inf))
        margin = _MARGIN * (high - low)
        outside = int(((values < low - margin) | (values > high + margin)).sum())
        if outside:
            count, lowest, highest = self._left.get(name, (0, np.inf, -np.inf))
            span = min(lowest, float(values.min())), max(highest, float(values.max()))
            self._left[name] = (count + outside, *span)

    def _complete(self, known: dict[str, Array], n: int, recording: Recording) -> dict[str, Array]:
        """The covariates that are needed; those that are missing in the middle of their range."""
        valid = self._calibration.valid
        found = {name: known[name] for name in self._needs if name in known}
        absent = self._needs - set(found)
        for model, theta in self._models:
            slices = model.slices(Context(1))
            for effect in model.effects:
                lost = sorted(set(effect.needs) & absent)
                if not lost:
                    continue
                if unknown := [name for name in lost if name not in valid]:
                    raise lacking(effect.name, unknown, recording.path)
                size = _swing(effect, theta[slices[effect.name]], self._calibration, lost)
                self._held[_describe_held(effect.name, lost, valid, size)] = None
        usual = self._calibration.assume
        return found | {name: np.full(n, usual(name)) for name in absent}


def _describe_held(effect: str, lost: list[str], valid: Spans, size: float) -> str:
    spans = ", ".join(f"{valid[name][0]:.3g} to {valid[name][1]:.3g}" for name in lost)
    names = ", ".join(lost)
    where = " and ".join(dict.fromkeys(where_assumed(name) for name in lost))
    return (
        f"{effect} is left out, for the recording has no {names}: it acts as "
        f"{where} of what was calibrated ({spans}), which leaves up to {size / MG:.2g} mg"
    )


def _swing(effect: Effect, theta: Array, calibration: Calibration, lost: list[str]) -> float:
    """m/s², how far the effect goes from where it acts to the ends of its covariates'
    ranges, at most, with gravity along any axis."""
    valid, usual = calibration.valid, calibration.assume
    ends = np.array(list(product(*[(usual(n), *valid[n]) for n in lost])))
    along = STANDARD_GRAVITY * np.concatenate([np.eye(3), -np.eye(3)])
    force = np.tile(along, (len(ends), 1))
    every = {n: np.repeat(ends[:, k], len(along)) for k, n in enumerate(lost)}
    rest = {n: np.full(len(force), usual(n)) for n in effect.needs if n not in every}
    context = Context(len(force), {**rest, **every})
    delta = effect.act(theta, Truth(force[:, None]), context).delta[:, 0]
    moved = delta.reshape(len(ends), len(along), 3) - delta[: len(along)]
    return float(np.linalg.norm(moved, axis=2).max())


def _clock(calibration: Calibration, recording: Recording, channel: Channel) -> dict[str, Array]:
    """Time as the calibration counts it, where it says how: drifts and steps belong to its time,
    and a recording without a date counts as the one that was calibrated."""
    clock = calibration.facts.get("clock")
    if not clock:
        return {}
    own, dated = recording.start_ns, clock["start_ns"]
    shift = 0.0 if own is None or dated is None else (own - int(dated)) / 1e9
    time = channel.t + shift
    known = {"time": time, "order": time / float(clock["span_s"])}
    if own is None or dated is not None:
        start = int(dated or 0) if own is None else own
        known["time_of_day"] = 2.0 * np.pi * ((channel.t + start / 1e9 % 86400.0) / 86400.0 % 1.0)
    return known


def mark_of(calibration: Calibration, triad: str) -> Mark:
    """The mark of a calibration."""
    return Mark(triad, calibration.calibrator, identity(calibration))


def refuse_second(recording: Recording, triad: str) -> None:
    """Raise UsageError when the sensor is corrected already.

    A mark whose sensor the recording does not have, since it was renamed, may be any of them.
    """
    present = {c.triad for c in recording.channels.values()}
    for mark in recording.corrections:
        if mark.triad == triad or mark.triad not in present:
            raise UsageError(
                str(mark),
                where=recording.path,
                remedy="correct the recording that it was made from, or insist with --again",
            )
