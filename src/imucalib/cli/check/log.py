"""The log of `imucal check`: its noise, its misfits, its line in the history."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from imucalib.cli.gravity_options import gravity_of
from imucalib.cli.output import pairs
from imucalib.cli.recording_options import mapping_of, one_scale, still_of

if TYPE_CHECKING:
    from imucalib.calibration.calibration import Calibration
    from imucalib.calibration.checking.check import Check, Measured
    from imucalib.calibration.checking.e_value import PastCheck
    from imucalib.calibration.checking.misfit import CheckNoise


def noise_of(calibration: Calibration, options: dict[str, Any]) -> CheckNoise:
    """What the options and the calibration say of the noise."""
    from imucalib.calibration.checking.limits import sessions_of, size_of
    from imucalib.calibration.checking.misfit import check_noise
    from imucalib.units import MG

    reading = options["noise"] and MG * size_of(options["noise"], {"mg": "force"})[0]
    session = sessions_of(options["between_sessions"])
    return check_noise(calibration, reading=reading, session=session)


def measured_of(
    calibration: Calibration,
    log: Path,
    noise: CheckNoise,
    options: dict[str, Any],
    past: tuple[PastCheck, ...],
) -> tuple[list[Measured], tuple[str, ...]]:
    """The log as misfits, sensor by sensor."""
    from dataclasses import replace

    from imucalib.calibration.checking.e_value import counted_once
    from imucalib.calibrators.check_log import Asked, array_log, sensor_log
    from imucalib.calibrators.lab.files import LabFiles

    files = LabFiles(log, None, pairs(options["columns"], "--columns"), mapping_of(options))
    stated = options["gravity"] is not None or options["latitude"] is not None
    gravity = gravity_of(options)[0] if stated else calibration.gravity
    asked = Asked(
        gravity, still_of(options), options["unit"], one_scale(options["lsb"]), options["triad"]
    )
    make = array_log if calibration.triads else sensor_log
    measured, notes = make(replace(calibration, gravity=gravity), files, noise, asked)
    with_past = [
        replace(m, past=counted_once([o.sensors[m.name] for o in past if m.name in o.sensors],
                                     m.misfits.value))
        for m in measured
    ]  # fmt: skip
    before = max((sum(m.name in one.sensors for one in past) for m in measured), default=0)
    if again := before - max((len(m.past) for m in with_past), default=0):
        checks = "a check" if again == 1 else f"{again} checks"
        notes = (*notes, f"{checks} of the history had readings that came again: counted once")
    return with_past, notes


def append(path: Path, past: tuple[PastCheck, ...], found: Check, content: dict[str, Any]) -> None:
    """One more line, with when it was written."""
    from datetime import UTC, datetime

    from imucalib.calibration.checking.check import look_of
    from imucalib.calibration.checking.e_value import PastCheck, append_check

    told = {k: content[k] for k in ("calibration_sha256", "log", "verdict", "p", "e_value")}
    told["time"] = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    sensors = {s.name: look_of(s.misfits, s.p) for s in found.sensors}
    append_check(path, past, PastCheck(sensors, told))
