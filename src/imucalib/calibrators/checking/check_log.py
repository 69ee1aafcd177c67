"""A log to check a calibration against: a table of positions, or a recording with rests."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.check import Measured
from imucalib.calibration.checking.misfit import gyro_rest, misfits_of, triad_misfits
from imucalib.calibration.checking.noise import CheckNoise
from imucalib.calibration.correction import refuse_second
from imucalib.calibration.series import BLOCK
from imucalib.calibration.shared_gravity import check_against_gravity
from imucalib.calibration.triads import pair_triads, select_triads
from imucalib.calibrators.lab.bench import in_celsius, observations_of, raw_unit
from imucalib.calibrators.lab.files import LabFiles, positions_in, rests_of
from imucalib.calibrators.lab.position_table import ANGLES, PositionTable
from imucalib.calibrators.lab.request import LabRequest
from imucalib.core.angle_conventions import Conventions
from imucalib.core.effect import Context
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.effects.scans import COLUMN
from imucalib.errors import UsageError
from imucalib.readers import read
from imucalib.recording.identity import accelerometer_of, demand_device
from imucalib.recording.recording import Recording
from imucalib.recording.sensors import accelerometer, select_sensor
from imucalib.rests.segments import Segments
from imucalib.rests.stillness import StillSettings
from imucalib.units import STANDARD_GRAVITY

_DIRECTION = {"ux", "uy", "uz"}
#: What was made of a log: the misfits of each sensor, and notes.
Found = tuple[list[Measured], tuple[str, ...]]


@dataclass(frozen=True)
class CheckRequest:
    """What the user says of the log. gravity : m/s²; still : what counts as a rest of a recording
    unit, lsb_per_g : of a table's readings"""

    gravity: float
    still: StillSettings
    unit: str | None = None
    lsb_per_g: float | None = None


def _silent(text: str) -> None:
    """What is worth knowing of a log is in its notes."""


def sensor_log(
    calibration: Calibration, files: LabFiles, noise: CheckNoise, request: CheckRequest
) -> Found:
    """The misfits of one accelerometer. Errors as of `lab`."""
    # Columns that the calibration follows, as they were called there.
    needs = {name for effect in calibration.model()[0].effects for name in effect.needs}
    follows = sorted(name.removeprefix(COLUMN) for name in needs if name.startswith(COLUMN))
    table = None
    if follows:
        columns = {f"driver_{k}": name for k, name in enumerate(follows)} | dict(files.columns)
        table = positions_in(replace(files, columns=columns))
    table = table or positions_in(files)
    if table is not None:
        data, notes = _of_table(calibration, table, request)
    else:
        whole = read(files.table, replace(files.mapping, sensor=""))
        chosen = accelerometer_of(calibration.sensor, whole, files.mapping.sensor).triad
        (recording,) = select_sensor([whole], chosen)
        segments = rests_of(recording, request.still, _silent)
        data = _of_rests(calibration, segments, recording, request, noise.reading.sd)
        notes = recording.notes
    misfits, more = misfits_of(calibration, data, noise)
    if (calibration.facts.get(BLOCK) or {}).get("use") == "parts":
        notes += ("of a calibration in parts the one of the whole is checked",)
    return [Measured(misfits)], (*notes, *more)


def array_log(
    calibration: Calibration, files: LabFiles, noise: CheckNoise, request: CheckRequest
) -> Found:
    """The misfits of every IMU of an array, or of the one that is asked for."""
    recording = read(files.table, replace(files.mapping, sensor=""))
    demand_device(calibration.sensor, recording)
    segments = rests_of(recording, request.still, _silent)
    pairing = pair_triads(calibration.triads, recording)
    said = check_against_gravity(calibration.triads, pairing.partner, segments, recording.path)
    triads = select_triads(calibration.triads, pairing.partner, files.mapping.sensor)
    rests = calibration.facts.get("rests") or {}
    # The usual scatter holds the usual noise of samples: an IMU that is noisier has more.
    own = segments.noise.max(axis=1) ** 2 / np.maximum(segments.samples, 1)
    more = np.maximum(own - np.median(own), 0.0)
    found = []
    for name, triad in triads.items():
        k = segments.triads.index(name)
        misfits = triad_misfits(calibration, triad, segments.mean[:, k], noise, more[:, k])
        found.append(Measured(misfits, triad.name, gyro_rest(triad, segments.rate[:, k], rests)))
    once: dict[str, str] = {}
    for text in recording.notes:  # what is said of every IMU is said once
        once.setdefault(re.sub(r"^\S+: (topic [^,]*, )?", "", text), text)
    return found, (*once.values(), *pairing.notes, *said)


def _of_table(
    calibration: Calibration, table: PositionTable, request: CheckRequest
) -> tuple[Observations, tuple[str, ...]]:
    """Positions with known angles or directions, or still readings in unknown attitudes; sigma is
    1 m/s² where a rest has the noise of a reading.

    Directions count only where the calibration holds a mounting: else there is no frame to compare
    with. Counts are the calibration's where nothing else is stated. Errors as of `lab`.
    """
    unit, lsb_per_g = request.unit, request.lsb_per_g
    if lsb_per_g is None and unit is None and calibration.raw_unit == "counts":
        lsb_per_g = STANDARD_GRAVITY / calibration.raw_to_si
    raw = raw_unit(table, unit, lsb_per_g)
    mounted = any(p.effect == "mounting" for p in calibration.parameters)
    columns, notes = set(table.columns), [raw.sentence]
    reference, conventions = "norm", Conventions()
    if mounted and columns >= ANGLES:
        reference = "vector"
        conventions = Conventions(**(calibration.facts.get("conventions") or {}))
    elif mounted and columns >= _DIRECTION:
        reference = "direction"
    elif columns & (ANGLES | _DIRECTION):
        notes.append("its directions are not used: the calibration ties no frame to them")
    lab = LabRequest(
        reference=reference, gravity=request.gravity, sigma=1.0, conventions=conventions
    )
    data = observations_of(in_celsius(table), raw, lab)
    # Counts of samples compare rows of one table only: every row has the noise of a reading.
    return replace(data, sigma=np.ones_like(data.sigma)), tuple(notes)


def _of_rests(
    calibration: Calibration,
    segments: Segments,
    recording: Recording,
    request: CheckRequest,
    reading_sd: float,
) -> Observations:
    """The rests of one accelerometer. reading_sd : m/s², noise of a reading; a rest so short
    that its samples alone have more counts by that.

    Raises UsageError where it has no scale.
    """
    channel = accelerometer(recording)
    refuse_second(recording, channel.triad)
    if channel.unit != "m/s2" and {channel.unit, calibration.raw_unit} != {"counts"}:
        raise UsageError(
            f"the acceleration has no scale (unit {channel.unit})",
            where=recording.path,
            remedy="give --unit, or --unit counts with --lsb",
        )
    si = 1.0 if channel.unit == "m/s2" else calibration.raw_to_si
    noise = si * segments.noise[0].max() / np.sqrt(np.maximum(segments.samples[:, 0], 1))
    sigma = np.maximum(noise / reading_sd, 1.0)
    reading = si * segments.mean[:, 0]
    middle = segments.middle
    return Observations(
        reading=reading[:, None],
        sigma=np.broadcast_to(sigma[:, None, None], (segments.n, 1, 3)).copy(),
        reference=KnownNorm(segments.n, request.gravity),
        context=Context(segments.n, _covariates(segments, reading)),
        group=np.arange(segments.n),
        label=tuple(f"rest at {t:.1f} s" for t in middle),
    )


def _covariates(segments: Segments, reading: Array) -> dict[str, Array]:
    before = np.concatenate([reading[:1], reading[:-1]])
    found = {f"previous_{a}": before[:, i] for i, a in enumerate("xyz")}
    warm = segments.temperature[:, 0]
    return found | ({"temperature": warm} if np.isfinite(warm).all() else {})
