"""Apply a calibration to a recording: the acceleration corrected, all else as it was."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.calibration import Calibration
from imucalib.context import Context
from imucalib.errors import UnreadableInput, UsageError
from imucalib.mapping import FieldMapping
from imucalib.readers import blocks, read, reader_for
from imucalib.recording import Channel, Recording
from imucalib.writers import write, write_blocks

Array = NDArray[np.float64]

_OF_MESSAGES = ("mcap", "rosbag")


def apply_to_recording(
    calibration: Calibration, recording: Recording, triad: str | None = None
) -> Recording:
    """A recording whose acceleration of one triad is corrected specific force in m/s².

    triad : which sensor, when there are several. Raises UsageError when it is not clear which, and
    UnreadableInput when a covariate is missing or leaves the range that was calibrated.
    """
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
            remedy="give --acc-unit, or --acc-unit counts with --lsb",
        )
    corrected = calibration.apply(channel.values, _context(calibration, recording, channel))
    channels = {**recording.channels, chosen[0]: replace(channel, values=corrected)}
    note = f"{chosen[0]} corrected with a {calibration.calibrator} calibration"
    return replace(recording, channels=channels, notes=(*recording.notes, note))


def _context(calibration: Calibration, recording: Recording, channel: Channel) -> Context:
    needed = {name for effect in calibration.model()[0].effects for name in effect.needs}
    known = _clock(calibration, recording, channel)
    warm = [
        c
        for c in recording.channels.values()
        if c.quantity == "temperature" and c.triad in (channel.triad, "")
    ]
    if warm:
        known["temperature"] = np.interp(channel.t, warm[0].t, warm[0].values[:, 0])
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
    start = recording.start_ns
    shift = 0.0
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
) -> tuple[str, ...]:
    """Correct a recording into a file of the target's suffix; returns the recording's notes.

    Goes block by block, so a week takes no more memory than an hour. Logs of messages are held
    whole, since their topics come at their own times; from MCAP to MCAP every other topic is
    copied untouched. Errors as in `apply_to_recording`.
    """
    kind = reader_for(source).name
    if kind in _OF_MESSAGES:
        corrected = apply_to_recording(calibration, read(source, mapping, strict=strict), triad)
        if kind == "mcap" and target.suffix.lower() == ".mcap":
            from imucalib.writers.mcap import write_with_topics_of

            write_with_topics_of(corrected, source, target)
        else:
            write(corrected, target)
        return corrected.notes
    notes: dict[str, None] = {}

    def parts() -> Iterator[Recording]:
        for block in blocks(source, mapping, strict=strict):
            corrected = apply_to_recording(calibration, block, triad)
            notes.update(dict.fromkeys(corrected.notes))
            yield corrected

    write_blocks(parts(), target)
    return tuple(notes)
