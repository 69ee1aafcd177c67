"""Apply a calibration to a recording: the acceleration corrected, all else as it was."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.mark import mark_of, refuse_second
from imucalib.calibration.series import CalibrationPart, part_at, parts_of
from imucalib.calibration.triads import correct_triads
from imucalib.core.context import Context
from imucalib.effects.thermal_lag import PREFIX, hours_of
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers import blocks, read, reader_for
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.thermal_history import (
    ThermalHistory,
    temperature_at,
    thermal_history,
    thermometer_of,
    with_thermometer,
)  # fmt: skip
from imucalib.writers import write, write_blocks

_OF_MESSAGES = ("mcap", "rosbag")


def apply_to_recording(
    calibration: Calibration,
    recording: Recording,
    triad: str | None = None,
    *,
    use: str | None = None,
    again: bool = False,
    history: ThermalHistory | None = None,
    thermometer: Channel | None = None,
) -> Recording:
    """A recording whose acceleration of one triad is corrected specific force in m/s²; with the
    calibration of an array all its IMUs', and their rates.

    triad : which sensor, when there are several
    use : "parts" or "whole", of a calibration in parts; by default what it says itself
    again : correct what is marked as corrected already
    history : temperature of the whole recording when this is a block of it
    thermometer : then, its temperature channel with the readings beside this block
    Raises UsageError when it is not clear which sensor, and when that one is corrected already;
    UnreadableInput when a covariate is missing or leaves the range that was calibrated.
    """
    if calibration.triads:
        return _array_corrected(calibration, recording, triad)
    names = [n for n, c in recording.channels.items() if c.quantity == "acceleration"]
    chosen = [n for n in names if triad is None or recording.channels[n].triad == triad]
    if len(chosen) != 1:
        known = ", ".join(recording.channels[n].triad for n in names)
        raise UsageError(
            f"{len(chosen)} accelerometers to choose from",
            where=recording.path,
            remedy=f"name one with --triad: {known}",
        )
    channel = recording.channels[chosen[0]]
    if channel.unit != "m/s2":
        raise UnreadableInput(
            f"the acceleration has no scale (unit {channel.unit})",
            where=recording.path,
            remedy="give --unit, or --unit counts with --lsb",
        )
    if not again:
        refuse_second(recording, channel.triad)
    parts = parts_of(calibration, use)
    if history is None and _lags(calibration, parts):
        history = thermal_history([recording], channel.triad)
    thermometer = thermometer or thermometer_of(recording, channel.triad)
    context = _context(calibration, parts, recording, channel, (history, thermometer))
    corrected = _corrected(calibration, parts, channel, context)
    channels = {**recording.channels, chosen[0]: replace(channel, values=corrected)}
    note = f"{chosen[0]} corrected with a calibration by {calibration.calibrator}"
    if parts:
        note += f", each sample with the one of {len(parts)} parts that is valid at its time"
    marks = (*recording.corrections, mark_of(calibration, channel.triad))
    return replace(recording, channels=channels, notes=(*recording.notes, note), corrections=marks)


def _array_corrected(calibration: Calibration, recording: Recording, only: str | None) -> Recording:
    """Every IMU's acceleration and rate by its gains and biases, in board axes."""
    channels = correct_triads(calibration.triads, recording, only)
    notes = ["corrected with a calibration by array; vectors are in the board's axes"]
    notes += [
        f"{name}: rates in {c.unit} stay as they are"
        for name, c in channels.items()
        if c.quantity == "angular_rate" and c.unit != "rad/s"
    ]
    notes += [
        f"not undone: {row['effect']}, {row['rms']:.3g} {row['unit']} rms while it was calibrated"
        for row in calibration.facts.get("not_undone", ())
    ]
    return replace(recording, channels=channels, notes=(*recording.notes, *notes))


def _needs(calibration: Calibration, parts: tuple[CalibrationPart, ...]) -> set[str]:
    """Covariates of every effect that may be undone."""
    everything = {id(c): c for c in (calibration, *(p.calibration for p in parts))}
    models = [c.model()[0] for c in everything.values()]
    return {name for model in models for effect in model.effects for name in effect.needs}


def _lags(calibration: Calibration, parts: tuple[CalibrationPart, ...]) -> dict[str, float]:
    """The lagged temperatures that are needed, with their hours."""
    names = [n for n in _needs(calibration, parts) if n.startswith(PREFIX)]
    return {name: hours_of(name.removeprefix(PREFIX)) for name in names}


def _corrected(
    calibration: Calibration, parts: tuple[CalibrationPart, ...], channel: Channel, known: Context
) -> Array:
    if not parts:
        return calibration.apply(channel.values, known)
    out, valid = np.empty_like(channel.values), part_at(parts, known["time"])
    for number in np.unique(valid):
        rows = np.flatnonzero(valid == number)
        out[rows] = parts[number].calibration.apply(channel.values[rows], known.take(rows))
    return out


def _context(
    calibration: Calibration,
    parts: tuple[CalibrationPart, ...],
    recording: Recording,
    channel: Channel,
    warmth: tuple[ThermalHistory | None, Channel | None],
) -> Context:
    needed = _needs(calibration, parts) | ({"time"} if parts else set())
    known = _clock(calibration, recording, channel)
    history, thermometer = warmth
    if thermometer is not None:
        known["temperature"] = temperature_at(thermometer, channel.t)
    if history is not None:
        lags = _lags(calibration, parts)
        known |= {name: history.lagged(hours, channel.t) for name, hours in lags.items()}
    found = {name: values for name, values in known.items() if name in needed}
    for name, values in found.items():
        _demand_range(calibration, recording, name, values)
    return Context(len(channel.t), found)


#: Covariates with a range: what a message calls them, and their unit.
_RANGED = {"temperature": ("temperature", "°C"), "order": ("time, as a share of the session,", "")}


def _demand_range(calibration: Calibration, recording: Recording, name: str, values: Array) -> None:
    """Raise UnreadableInput where a covariate leaves what was calibrated by more than a tenth."""
    low, high = calibration.valid.get(name, (-np.inf, np.inf))
    margin = 0.1 * (high - low)
    if name.startswith(PREFIX):
        name = "temperature"
    if not values.size:
        return
    if name in _RANGED and (values.min() < low - margin or values.max() > high + margin):
        word, unit = _RANGED[name]
        raise UnreadableInput(
            f"{word} {values.min():.1f} to {values.max():.1f} {unit} leaves the "
            f"calibrated range {low:.1f} to {high:.1f} {unit}".replace("  ", " ").rstrip(),
            where=recording.path,
            remedy=f"calibrate over the range of use, or without {name} effects",
        )


def _clock(calibration: Calibration, recording: Recording, channel: Channel) -> dict[str, Array]:
    """Time as the calibration counts it, where it says how: drifts and steps belong to its time."""
    clock = calibration.facts.get("clock")
    if not clock:
        return {}
    start, shift = recording.start_ns, 0.0
    if start is not None and clock["start_ns"] is not None:
        shift = (start - int(clock["start_ns"])) / 1e9
    time = channel.t + shift
    known = {"time": time, "order": time / float(clock["span_s"])}
    if start is not None:
        known["time_of_day"] = 2.0 * np.pi * ((channel.t + start / 1e9 % 86400.0) / 86400.0 % 1.0)
    return known


def correct_file(
    calibration: Calibration,
    source: Path,
    target: Path,
    mapping: FieldMapping,
    *,
    triad: str | None = None,
    strict: bool = False,
    use: str | None = None,
    again: bool = False,
) -> tuple[str, ...]:
    """Correct a recording into a file of the target's suffix; returns the recording's notes.

    Goes block by block, so a week takes no more memory than an hour. Logs of messages are held
    whole, since their topics come at their own times; from MCAP to MCAP every other topic is
    copied untouched. A lag of the temperature takes a first pass of its own. Options and errors as
    in `apply_to_recording`.
    """
    kind = reader_for(source).name
    if kind in _OF_MESSAGES:
        whole = read(source, mapping, strict=strict)
        corrected = apply_to_recording(calibration, whole, triad, use=use, again=again)
        if kind == "mcap" and target.suffix.lower() == ".mcap":
            from imucalib.writers.mcap.writer import write_with_topics_of

            write_with_topics_of(corrected, source, target)
        else:
            write(corrected, target)
        return corrected.notes
    notes: dict[str, None] = {}
    history, parts = None, parts_of(calibration, use)
    if _lags(calibration, parts):
        history = _history(blocks(source, mapping, strict=strict), triad)

    def corrected_blocks() -> Iterator[Recording]:
        found = blocks(source, mapping, strict=strict)
        around = "temperature" in _needs(calibration, parts)
        for block, warm in (
            _with_thermometer(found, triad) if around else ((b, None) for b in found)
        ):
            corrected = apply_to_recording(
                calibration, block, triad, use=use, again=again, history=history, thermometer=warm
            )
            notes.update(dict.fromkeys(corrected.notes))
            yield corrected

    write_blocks(corrected_blocks(), target)
    return tuple(notes)


def _history(found: Iterator[Recording], triad: str | None) -> ThermalHistory | None:
    """The temperature beside the accelerometer that is corrected."""
    name, every = _corrected_triad(found, triad)
    return thermal_history(every, name)


def _with_thermometer(
    found: Iterator[Recording], triad: str | None
) -> Iterator[tuple[Recording, Channel | None]]:
    name, every = _corrected_triad(found, triad)
    return with_thermometer(every, name)


def _corrected_triad(
    found: Iterator[Recording], triad: str | None
) -> tuple[str, Iterator[Recording]]:
    """The accelerometer that is corrected, and the blocks."""
    first = next(found, None)
    if first is None:
        return "", iter(())
    names = [c.triad for c in first.channels.values() if c.quantity == "acceleration"]
    return triad or (names[0] if names else ""), chain([first], found)
