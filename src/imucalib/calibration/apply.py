"""Apply a calibration to a recording: the acceleration corrected, all else as it was."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.correction import Corrector
from imucalib.calibration.shared_gravity import check_against_gravity
from imucalib.calibration.triads import (
    DRIFT,
    Triad,
    correct_triads,
    pair_triads,
    select_triads,
    undo_drift,
)
from imucalib.effects.forms import in_words
from imucalib.errors import Undetermined
from imucalib.readers import blocks, read, reader_for
from imucalib.recording.identity import demand_device
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.pairing import Pairing
from imucalib.recording.recording import REST, Channel, Recording
from imucalib.rests.segments import Segments, find_segments, still_segments
from imucalib.units import MG
from imucalib.writers import ChannelsChange, write, write_blocks

_OF_MESSAGES = ("mcap", "rosbag")


def apply_to_recording(
    calibration: Calibration,
    recording: Recording,
    sensor: str = "",
    *,
    use: str | None = None,
    again: bool = False,
) -> Recording:
    """A recording whose acceleration of one sensor is corrected specific force in m/s²; with the
    calibration of an array all its IMUs', and their rates.

    sensor : which one, when there are several
    use : "parts" or "whole", of a calibration in parts; by default what it says itself
    again : correct what is marked as corrected already
    Raises UsageError when it is not clear which sensor, and when that one is corrected already;
    UnreadableInput when a covariate is missing of which not even the calibrated range is known,
    and for sensors of an array that cannot be paired; Undetermined as `check_against_gravity`.
    """
    ready = _corrector(calibration, sensor, use, again)
    (found,) = ready.correct_blocks(lambda: iter([recording]))
    return replace(found, notes=(*found.notes, *ready.notes))


class ArrayCorrector:
    """Corrects a recording of an array, block by block, as `Corrector` does one of a sensor.

    only : the IMU that is wanted, or empty
    """

    def __init__(self, calibration: Calibration, only: str) -> None:
        self._calibration, self._only = calibration, only
        self.notes: tuple[str, ...] = ()

    def correct_blocks(self, blocks: Callable[[], Iterator[Recording]]) -> Iterator[Recording]:
        """The blocks with every IMU's acceleration and rate corrected; they are gone through twice.
        Errors as of `apply_to_recording`."""
        pairing = _pair_at_rest(self._calibration.triads, blocks())
        self.notes = pairing.notes
        for block in blocks():
            yield imus_corrected(self._calibration, block, pairing.partner, self._only)


def _corrector(
    calibration: Calibration, sensor: str, use: str | None, again: bool
) -> Corrector | ArrayCorrector:
    if calibration.triads:
        return ArrayCorrector(calibration, sensor)
    return Corrector(calibration, sensor, use=use, again=again)


def _pair_at_rest(triads: Sequence[Triad], found: Iterable[Recording]) -> Pairing:
    """Whose sensors are whose in a recording that comes in blocks, held against gravity at its
    rests. Errors as in `pairing.paired` and `check_against_gravity`."""
    first: list[Recording] = []
    pairing: list[Pairing] = []

    def watch() -> Iterator[Recording]:
        for block in found:
            if block.channels and not pairing:
                first.append(block)
                pairing.append(pair_triads(triads, block))
            yield block

    try:
        segments = find_segments(watch())
    except Undetermined as error:
        if not pairing:
            raise
        notes: tuple[str, ...] = (f"whose sensors are whose shows no rest: {error.what}",)
    else:
        notes = check_against_gravity(triads, pairing[0].partner, segments, first[0].path)
    return replace(pairing[0], notes=(*pairing[0].notes, *notes))


def imus_corrected(
    calibration: Calibration,
    recording: Recording,
    partner: Mapping[str, int],
    only: str = "",
) -> Recording:
    """Every IMU's acceleration and rate by its gains and biases, in board axes.

    partner : recorded sensor -> index of its triad; only : the one that is wanted, or empty
    """
    demand_device(calibration.sensor, recording)
    facts, notes = calibration.facts, []
    chosen = select_triads(calibration.triads, partner, only)
    drift = (facts.get("rests") or {}).get("drift")
    made_of = (facts.get("provenance") or {}).get("sha256")
    if made_of is None or made_of != recording.sha256:
        drift = None
    source = undo_drift(recording, partner, drift) if drift else recording
    channels = correct_triads(chosen, source)
    notes.append("corrected with a calibration by array; vectors are in the board's axes")
    notes += [
        f"{name}: rates in {c.unit} stay as they are"
        for name, c in channels.items()
        if c.quantity == "angular_rate" and c.unit != "rad/s"
    ]
    notes += ["undone in what was calibrated: drift of the rests"] if drift else []
    notes += [
        f"not undone: {in_words(row['effect'])}, {row['rms']:.3g} {row['unit']} rms while it was "
        "calibrated"
        for row in facts.get("not_undone", ())
        if not (drift and row["effect"] == DRIFT)
    ]
    return replace(recording, channels=channels, notes=(*recording.notes, *notes))


def correct_file(
    calibration: Calibration,
    source: Path,
    target: Path,
    mapping: FieldMapping,
    *,
    strict: bool = False,
    use: str | None = None,
    again: bool = False,
) -> tuple[str, ...]:
    """Correct a recording into a file of the target's suffix; returns the recording's notes.

    Goes block by block, so a week takes no more memory than an hour. Logs of messages are held
    whole, since their topics come at their own times; from these to MCAP every other topic is
    copied untouched. What follows the temperature takes a first pass of its own; the sensor is the
    mapping's. Options and errors as in `apply_to_recording`.
    """
    sensor, mapping = mapping.sensor, replace(mapping, sensor="")

    def at_once() -> tuple[str, ...]:
        whole = read(source, mapping, strict=strict)
        corrected = apply_to_recording(calibration, whole, sensor, use=use, again=again)
        write_over(corrected, source, target)
        return corrected.notes

    if reader_for(source).name in _OF_MESSAGES:
        return at_once()
    ready = _corrector(calibration, sensor, use, again)
    notes: dict[str, None] = {}

    def collect_notes() -> Iterator[Recording]:
        for block in ready.correct_blocks(partial(blocks, source, mapping, strict=strict)):
            notes.update(dict.fromkeys(block.notes))
            yield block

    try:
        write_blocks(collect_notes(), target)
    except ChannelsChange:  # the format must know its columns or topics first
        return at_once()
    return (*notes, *ready.notes)


def write_over(corrected: Recording, source: Path, target: Path) -> None:
    """Write a whole recording; from messages to MCAP, every other topic of the source is kept."""
    if reader_for(source).name in _OF_MESSAGES and target.suffix.lower() == ".mcap":
        from imucalib.writers.mcap_over import write_with_topics_of

        write_with_topics_of(corrected, source, target)
    else:
        write(corrected, target)


def add_residuals(
    calibration: Calibration,
    recording: Recording,
    sensor: str = "",
    *,
    use: str | None = None,
    again: bool = False,
) -> Recording:
    """The corrected sensors of a recording, each with a channel "<triad>/rest" of its rests: t (n,)
    their middles, s, and values (n, 9) as in `REST_COLUMNS`.

    Options and errors as in `apply_to_recording`; Undetermined where the recording has no rest.
    """
    corrected = apply_to_recording(calibration, recording, sensor, use=use, again=again)
    rests = still_segments(recording)
    if rests.n == 0:
        raise Undetermined(
            "no rest, so there is no residual against gravity",
            where=recording.path,
            remedy="`imucal inspect FILE --rests` tells what refused them",
        )
    changed = {
        channel.triad
        for name, channel in corrected.channels.items()
        if channel.quantity == "acceleration" and channel is not recording.channels.get(name)
    }
    kept = {n: c for n, c in corrected.channels.items() if c.triad in changed}
    for name, channel in tuple(kept.items()):
        if channel.quantity != "acceleration":
            continue
        k = rests.triads.index(channel.triad)
        scale = 1.0 if recording.channels[name].unit == "m/s2" else calibration.raw_to_si
        after = rests.means(channel.values, k)
        values = _rows(rests, scale * rests.mean[:, k], after, calibration.gravity)
        made = Channel(rests.middle, values, "", REST, channel.triad, 0.0)
        kept[f"{channel.triad}/{REST}"] = made
    return replace(corrected, channels=kept)


def _rows(rests: Segments, before: Array, after: Array, gravity: float) -> Array:
    sizes = (np.linalg.norm(vector, axis=1) for vector in (before, after))
    residuals = [(size - gravity) / MG for size in sizes]
    return np.column_stack([rests.stop - rests.start, before, after, *residuals])
