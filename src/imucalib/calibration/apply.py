"""Apply a calibration to a recording: the acceleration corrected, all else as it was."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.correction import Correction
from imucalib.calibration.file import identity
from imucalib.calibration.gyroscope import gyroscope_of, with_rates_corrected
from imucalib.calibration.rest_drift import DRIFT, rest_drift, without_drift
from imucalib.calibration.shared_gravity import held_against_gravity
from imucalib.calibration.triads import Triad, correct_triads, named_triads, pairing_of
from imucalib.errors import Undetermined, UnreadableInput, UsageError
from imucalib.readers import blocks, read, reader_for
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.pairing import Pairing
from imucalib.recording.recording import Channel, Recording
from imucalib.recording.recording import Correction as Mark
from imucalib.rests.segments import find_segments
from imucalib.rests.thermal import (
    ThermalHistory,
    thermal_history,
    thermometer_of,
    with_thermometer,
)
from imucalib.writers import ChannelsChange, write, write_blocks

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
    correction: Correction | None = None,
    partner: Mapping[str, int] | None = None,
) -> Recording:
    """A recording whose acceleration of one triad is corrected specific force in m/s²; with the
    calibration of an array all its IMUs', and their rates.

    triad : which sensor, when there are several
    use : "parts" or "whole", of a calibration in parts; by default what it says itself
    again : correct what is marked as corrected already
    history : temperature of the whole recording when this is a block of it
    thermometer : then, its temperature channel with the readings beside this block
    correction : then, made once for all blocks; it keeps the notes on what it did without
    partner : then, of an array, its sensors -> indices of the triads, as paired in the whole
    Raises UsageError when it is not clear which sensor, and when that one is corrected already;
    UnreadableInput when a covariate is missing of which not even the calibrated range is known,
    and for sensors of an array that cannot be paired; Undetermined as `held_against_gravity`.
    """
    if calibration.triads:
        found = Pairing(partner) if partner else paired_at_rest(calibration.triads, [recording])
        return _array_corrected(calibration, recording, found, triad)
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
    ready = correction or Correction(calibration, use)
    if history is None and ready.follows_warmth:
        history = thermal_history([recording], channel.triad)
    thermometer = thermometer or thermometer_of(recording, channel.triad)
    corrected = ready(recording, channel, history, thermometer)
    channels = {**recording.channels, chosen[0]: replace(channel, values=corrected)}
    note = f"{chosen[0]} corrected with a calibration by {calibration.calibrator}"
    if ready.parts:
        note += f", each sample with the one of {len(ready.parts)} parts that is valid at its time"
    said = ready.notes if correction is None else ()
    corrections = (*recording.corrections, mark_of(calibration, channel.triad))
    notes = (*recording.notes, note, *said)
    whole = replace(recording, channels=channels, notes=notes, corrections=corrections)
    gyro = gyroscope_of(calibration)
    if gyro is None:
        return whole
    return with_rates_corrected(gyro, whole, channel.triad, thermometer)


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


def paired_at_rest(triads: Sequence[Triad], found: Iterable[Recording]) -> Pairing:
    """Whose sensors are whose in a recording that comes in blocks, held against gravity at its
    rests. Errors as in `pairing.paired` and `held_against_gravity`."""
    first: list[Recording] = []
    pairing: list[Pairing] = []

    def watched() -> Iterator[Recording]:
        for block in found:
            if block.channels and not pairing:
                first.append(block)
                pairing.append(pairing_of(triads, block))
            yield block

    try:
        segments = find_segments(watched())
    except Undetermined as error:
        if not pairing:
            raise
        notes: tuple[str, ...] = (f"whose sensors are whose shows no rest: {error.what}",)
    else:
        notes = held_against_gravity(triads, pairing[0].partner, segments, first[0].path)
    return replace(pairing[0], notes=(*pairing[0].notes, *notes))


def _array_corrected(
    calibration: Calibration, recording: Recording, found: Pairing, only: str | None
) -> Recording:
    """Every IMU's acceleration and rate by its gains and biases, in board axes."""
    chosen = named_triads(calibration.triads, found.partner, only)
    drift = rest_drift(calibration, recording)
    channels = correct_triads(chosen, without_drift(recording, found.partner, drift))
    notes = [*found.notes, "corrected with a calibration by array; vectors are in the board's axes"]
    notes += [
        f"{name}: rates in {c.unit} stay as they are"
        for name, c in channels.items()
        if c.quantity == "angular_rate" and c.unit != "rad/s"
    ]
    notes += ["undone in what was calibrated: drift of the rests"] if drift else []
    notes += [
        f"not undone: {row['effect']}, {row['rms']:.3g} {row['unit']} rms while it was calibrated"
        for row in calibration.facts.get("not_undone", ())
        if not (drift and row["effect"] == DRIFT)
    ]
    return replace(recording, channels=channels, notes=(*recording.notes, *notes))


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
    copied untouched. What follows the temperature takes a first pass of its own. Options and errors
    as in `apply_to_recording`.
    """

    def at_once() -> tuple[str, ...]:
        whole = read(source, mapping, strict=strict)
        corrected = apply_to_recording(calibration, whole, triad, use=use, again=again)
        write_over(corrected, source, target)
        return corrected.notes

    if reader_for(source).name in _OF_MESSAGES:
        return at_once()
    notes: dict[str, None] = {}
    history, ready = None, None if calibration.triads else Correction(calibration, use)
    partner = None
    if calibration.triads:
        found = paired_at_rest(calibration.triads, blocks(source, mapping, strict=strict))
        partner, notes = found.partner, dict.fromkeys(found.notes)
    if ready is not None and ready.follows_warmth:
        history = _history(blocks(source, mapping, strict=strict), triad)

    def corrected_blocks() -> Iterator[Recording]:
        found = blocks(source, mapping, strict=strict)
        around = ready is not None and ready.warm
        for block, warm in (
            _with_thermometer(found, triad) if around else ((b, None) for b in found)
        ):
            corrected = apply_to_recording(
                calibration,
                block,
                triad,
                use=use,
                again=again,
                history=history,
                thermometer=warm,
                correction=ready,
                partner=partner,
            )
            notes.update(dict.fromkeys(corrected.notes))
            yield corrected

    try:
        write_blocks(corrected_blocks(), target)
    except ChannelsChange:  # the format must know its columns or topics first
        return at_once()
    return (*notes, *(ready.notes if ready is not None else ()))


def write_over(corrected: Recording, source: Path, target: Path) -> None:
    """Write a whole recording; from MCAP to MCAP, every other topic of the source is kept."""
    if reader_for(source).name == "mcap" and target.suffix.lower() == ".mcap":
        from imucalib.writers.mcap_over import write_with_topics_of

        write_with_topics_of(corrected, source, target)
    else:
        write(corrected, target)


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
