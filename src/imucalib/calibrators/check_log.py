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
from imucalib.calibration.shared_gravity import held_against_gravity
from imucalib.calibration.triads import named_triads, pairing_of
from imucalib.calibrators.lab.bench import raw_unit
from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.checks import observations_of
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.files import ANGLES, LabFiles, positions_in, still_rests
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.request import LabRequest
from imucalib.core.effect import Context
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.effects.scans import COLUMN
from imucalib.errors import UsageError
from imucalib.recording.recording import Recording
from imucalib.rests.segments import Segments, StillSettings
from imucalib.units import STANDARD_GRAVITY

_DIRECTION = {"ux", "uy", "uz"}


@dataclass(frozen=True)
class CheckLog:
    """observations : sigma is 1 m/s² where a rest has the noise of a reading; notes : what was made
    of it; start_ns : UTC of its beginning, where it says so"""

    observations: Observations
    notes: tuple[str, ...]
    start_ns: int | None = None


@dataclass(frozen=True)
class Asked:
    """What the user says of the log. gravity : m/s²; still : what counts as a rest of a recording
    unit, lsb_per_g : of a table's readings; triad : which sensor of a recording"""

    gravity: float
    still: StillSettings
    unit: str | None = None
    lsb_per_g: float | None = None
    triad: str | None = None


def _silent(text: str) -> None:
    """What is worth knowing of a log is in its notes."""


def sensor_log(
    calibration: Calibration, files: LabFiles, noise: CheckNoise, asked: Asked
) -> tuple[list[Measured], tuple[str, ...]]:
    """The misfits of one accelerometer, and what was made of the log. Errors as of `lab`."""
    drivers = _drivers(calibration)
    known = replace(files, columns={**drivers, **files.columns})
    table = (positions_in(known) if drivers else None) or positions_in(files)
    if table is not None:
        log = check_table(calibration, table, asked)
    else:
        recording, segments = still_rests(files.table, files.mapping, asked.still, _silent)
        log = check_rests(calibration, segments, recording, asked, noise.reading.sd)
    misfits, notes = misfits_of(calibration, log.observations, noise)
    if (calibration.facts.get(BLOCK) or {}).get("use") == "parts":
        notes = ("of a calibration in parts the one of the whole is checked", *notes)
    return [Measured(misfits)], (*log.notes, *notes)


def _drivers(calibration: Calibration) -> dict[str, str]:
    """Role -> heading of the columns that the calibration follows, as they were called there."""
    needs = {name for effect in calibration.model()[0].effects for name in effect.needs}
    names = sorted(name.removeprefix(COLUMN) for name in needs if name.startswith(COLUMN))
    return {f"driver_{k}": name for k, name in enumerate(names)}


def array_log(
    calibration: Calibration, files: LabFiles, noise: CheckNoise, asked: Asked
) -> tuple[list[Measured], tuple[str, ...]]:
    """The misfits of every IMU of an array, or of the one that is asked for."""
    recording, segments = still_rests(files.table, files.mapping, asked.still, _silent)
    pairing = pairing_of(calibration.triads, recording)
    said = held_against_gravity(calibration.triads, pairing.partner, segments, recording.path)
    triads = named_triads(calibration.triads, pairing.partner, asked.triad)
    rests = calibration.facts.get("rests") or {}
    # The usual scatter holds the usual noise of samples: an IMU that is noisier has more.
    own = segments.noise.max(axis=1) ** 2 / np.maximum(segments.samples, 1)
    more = np.maximum(own - np.median(own), 0.0)
    found = []
    for name, triad in triads.items():
        k = segments.triads.index(name)
        misfits = triad_misfits(calibration, triad, segments.mean[:, k], noise, more[:, k])
        found.append(Measured(misfits, triad.name, gyro_rest(triad, segments.rate[:, k], rests)))
    return found, (*_once(recording.notes), *pairing.notes, *said)


def _once(notes: tuple[str, ...]) -> tuple[str, ...]:
    """What is said of every IMU, said once."""
    alike: dict[str, str] = {}
    for text in notes:
        alike.setdefault(re.sub(r"^\S+: (topic [^,]*, )?", "", text), text)
    return tuple(alike.values())


def check_table(calibration: Calibration, table: PositionTable, asked: Asked) -> CheckLog:
    """Positions with known angles or directions, or still readings in unknown attitudes.

    Directions count only where the calibration holds a mounting: else there is no frame to compare
    with. Counts are the calibration's where nothing else is stated. Errors as of `lab`.
    """
    unit, lsb_per_g = asked.unit, asked.lsb_per_g
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
    settings = LabSettings(sigma=1.0, conventions=conventions)
    request = LabRequest(reference=reference, gravity=asked.gravity, settings=settings)
    made = observations_of(table, raw, request)
    # Counts of samples compare rows of one table only: every row has the noise of a reading.
    return CheckLog(replace(made, sigma=np.ones_like(made.sigma)), tuple(notes))


def check_rests(
    calibration: Calibration,
    segments: Segments,
    recording: Recording,
    asked: Asked,
    reading_sd: float,
) -> CheckLog:
    """The rests of one accelerometer. reading_sd : m/s², noise of a reading; a rest so short
    that its samples alone leave more counts by that.

    Raises UsageError where it is not clear which sensor, or without a scale.
    """
    refuse_second(recording, asked.triad or segments.triads[0])
    names = [t for t in segments.triads if asked.triad in (None, t)]
    if len(names) != 1:
        raise UsageError(
            f"{len(names)} accelerometers to choose from",
            where=recording.path,
            remedy=f"name one with --triad: {', '.join(segments.triads)}",
        )
    k = segments.triads.index(names[0])
    units = {
        c.unit
        for c in recording.channels.values()
        if c.quantity == "acceleration" and c.triad == names[0]
    }
    si = 1.0
    if units != {"m/s2"}:
        if calibration.raw_unit != "counts" or units != {"counts"}:
            raise UsageError(
                f"the acceleration has no scale (unit {', '.join(sorted(units))})",
                where=recording.path,
                remedy="give --unit, or --unit counts with --lsb",
            )
        si = calibration.raw_to_si
    own = si * segments.noise[k].max() / np.sqrt(np.maximum(segments.samples[:, k], 1))
    sigma = np.maximum(own / reading_sd, 1.0)
    reading = si * segments.mean[:, k]
    made = Observations(
        reading=reading[:, None],
        sigma=np.broadcast_to(sigma[:, None, None], (segments.n, 1, 3)).copy(),
        reference=KnownNorm(segments.n, asked.gravity),
        context=Context(segments.n, _covariates(segments, k, reading)),
        group=np.arange(segments.n),
        label=tuple(
            f"rest at {0.5 * (a + b):.1f} s"
            for a, b in zip(segments.start, segments.stop, strict=True)
        ),
    )
    return CheckLog(made, recording.notes, recording.start_ns)


def _covariates(segments: Segments, k: int, reading: Array) -> dict[str, Array]:
    found = {
        f"previous_{a}": np.concatenate([reading[:1, i], reading[:-1, i]])
        for i, a in enumerate("xyz")
    }
    warm = segments.temperature[:, k]
    return found | ({"temperature": warm} if np.isfinite(warm).all() else {})
