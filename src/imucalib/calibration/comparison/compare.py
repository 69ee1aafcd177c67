"""Calibrations of one sensor beside each other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.limits import Limits
from imucalib.calibration.comparison.agreement import (
    Agreement,
    Scatter,
    agreement,
    odd_ones,
    scatter,
)
from imucalib.calibration.comparison.attitudes import Seen, largest_sd, seen
from imucalib.calibration.comparison.basis import Basis, basis_of
from imucalib.calibration.comparison.dates import Dates, dates_of
from imucalib.calibration.comparison.drift import Due, Slope, due, slope_of
from imucalib.calibration.comparison.meaning import (
    SIGNIFICANT,
    Meaning,
    array_meanings,
    meanings_of,
)
from imucalib.calibration.comparison.power_ups import with_power_ups
from imucalib.calibration.comparison.remarks import mounted, remarks
from imucalib.calibration.comparison.sensor import ArrayImu, CalibratedSensor, sensor_of
from imucalib.errors import UNEXPLAINED_EXIT_CODE, LimitBroken, UnreadableInput, UsageError

Verdict = Literal["agree", "differ", "undecided"]
ALPHA = 0.05


@dataclass(frozen=True)
class Drift:
    """dates; slopes : of every parameter a day; due : of what is corrected"""

    dates: Dates
    slopes: tuple[Slope, ...]
    due: Due


@dataclass(frozen=True)
class Comparison:
    """m calibrations. names : of the files; meanings : force first; seen : of each sensor
    stated : whether the user gave the limits; notes : what must be said of comparing these
    """

    names: tuple[str, ...]
    basis: Basis
    agreement: Agreement
    scatter: Scatter | None
    meanings: tuple[Meaning, ...]
    seen: Mapping[str, Seen]
    drift: Drift | None
    stated: bool
    notes: tuple[str, ...]

    @property
    def differ(self) -> bool:
        """Whether they differ by more than they state."""
        return self.agreement.p <= ALPHA

    @property
    def verdict(self) -> Verdict:
        """Beyond a limit and beyond chance they differ; beyond a limit that was stated but within
        chance, they are too uncertain to tell."""
        if not any(m.beyond for m in self.meanings):
            return "agree"
        if self.differ:
            return "differ"
        return "undecided" if self.stated else "agree"

    @property
    def exit_code(self) -> int:
        """0 agree, 1 differ beyond the limit, 5 undecided."""
        codes = {"agree": 0, "differ": LimitBroken.exit_code}
        return codes.get(self.verdict, UNEXPLAINED_EXIT_CODE)

    @property
    def odd(self) -> tuple[str, ...]:
        """Of three and more, the files without which the others agree."""
        return tuple(self.names[k] for k in odd_ones(self.basis, ALPHA))


def compared(
    calibrations: Sequence[Calibration],
    names: Sequence[str],
    limits: Limits,
    dates: Sequence[str] = (),
    between: Mapping[str, float] | None = None,
) -> Comparison:
    """Two or more calibrations of one sensor or one array.

    between : scatter from power-up to power-up by the kind of change (bias mg, mounting deg),
    instead of what those of several power-ups state
    Raises UsageError for sensors that are not comparable, UnreadableInput for a file without a
    covariance.
    """
    arrays = _demand(calibrations, names)
    framed = arrays or _same_frame(calibrations)
    dof = np.array([_dof(c) for c in calibrations])
    if arrays and between:
        raise UsageError("arrays are compared without the scatter of power-ups",
                         remedy="leave out --between-sessions")  # fmt: skip
    days = with_power_ups(calibrations, between or {})
    calibrations = days.calibrations
    basis = basis_of(calibrations, dof, framed=framed, power_ups=days.power_ups)
    every = _every(calibrations)
    gravity = calibrations[0].gravity
    found = {name: seen(sensors, gravity) for name, sensors in every.items()}
    turns = framed and not arrays
    if limits.direction is not None and not turns:
        raise UsageError(
            "directions of these calibrations cannot be compared: not all tie a frame to a tool",
            remedy="give the limit in mg, or calibrate all with known angles",
        )
    meanings = meanings_of(found, limits, turns=turns)
    notes = remarks(calibrations, names, framed=framed)
    if arrays:
        own, said = array_meanings(calibrations, basis, limits)
        meanings, notes = (*meanings, *own), (*notes, *said)
    else:
        notes = (*notes, days.words)
    when = dates_of(calibrations, dates)
    return Comparison(
        names=tuple(names),
        basis=basis,
        agreement=agreement(basis),
        scatter=scatter(basis),
        meanings=meanings,
        seen=found,
        drift=None if when is None else _drift(when, basis, found, meanings),
        stated=limits != Limits(),
        notes=notes,
    )


def _demand(calibrations: Sequence[Calibration], names: Sequence[str]) -> bool:
    """Whether they are of arrays; all or none."""
    if len(calibrations) < 2:
        raise UsageError("one calibration has nothing to compare with", remedy="name two or more")
    for calibration, name in zip(calibrations, names, strict=True):
        own = [c.covariance for c in calibration.triads] or [calibration.covariance]
        if not all(np.trace(c) > 0.0 for c in own):
            raise UnreadableInput(
                "it states no uncertainty: every standard deviation is zero",
                where=name,
                remedy="without a covariance nothing can be said of a difference; calibrate again",
            )
    imus = [tuple(t.name for t in c.triads) for c in calibrations]
    if any(own != imus[0] for own in imus[1:]):
        odd = next(k for k, own in enumerate(imus) if own != imus[0])
        raise UsageError(
            f"{names[0]} is of {_sensors(imus[0])}, {names[odd]} of {_sensors(imus[odd])}",
            remedy="compare calibrations of one sensor, or of one array",
        )
    return bool(imus[0])


def _sensors(imus: tuple[str, ...]) -> str:
    return f"an array of {len(imus)} IMUs ({', '.join(imus)})" if imus else "one accelerometer"


def _dof(calibration: Calibration) -> float:
    """Degrees of freedom behind the covariance's scale, by the noise that the file states."""
    from imucalib.calibration.checking.noise import check_noise

    try:
        return check_noise(calibration).reading.dof
    except UnreadableInput:
        return math.inf


def _same_frame(calibrations: Sequence[Calibration]) -> bool:
    return len({mounted(c) for c in calibrations}) == 1


def _every(calibrations: Sequence[Calibration]) -> dict[str, list[CalibratedSensor]]:
    """The sensors by name, of each calibration."""
    if not calibrations[0].triads:
        return {"": [sensor_of(c) for c in calibrations]}
    return {
        t.name: [ArrayImu(c.triads[k]) for c in calibrations]
        for k, t in enumerate(calibrations[0].triads)
    }


def _drift(
    dates: Dates, basis: Basis, found: Mapping[str, Seen], meanings: tuple[Meaning, ...]
) -> Drift:
    slopes = tuple(
        slope_of(dates.days, basis.value[:, k], basis.covariance[:, k, k])
        for k in range(len(basis.names))
    )
    force = next((m for m in meanings if m.worst.unit == "mg"), None)
    limit = force.limit if force else SIGNIFICANT * max(largest_sd(s)[0] for s in found.values())
    reached = [
        due(dates.days, one.size, one.size_sd**2, one.attitude, limit, sensors=len(found))
        for one in found.values()
    ]
    return Drift(dates, slopes, min(reached, key=lambda d: (d.expected, d.earliest)))
