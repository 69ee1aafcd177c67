"""Calibrations of one sensor against each other: differences, what a power-up explains, drifts.

A calibration of one power-up states how well that one is known: its bias and its seat are the
day's. One of several states the mean, and the scatter about it. Against another day's, the first
lacks the scatter whole; the other's mean holds its share, known from as many power-ups as it has.

Drift is weighted least squares of a value on time, the variances those of the calibrations plus
what they scatter by about the line beyond them (from three on, as in `agreement`).
Intervals are Student's with m - 2 degrees of freedom, of two calibrations normal ones by the stated
sds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.noise import (
    FAMILIES,
    Limits,
    Scatter,
    check_noise,
    read_sessions,
    sizes_in_words,
)
from imucalib.calibration.comparison.agreement import (
    Agreement,
    Basis,
    DirectionErrors,
    ParameterScatter,
    PowerUps,
    Worst,
    agreement,
    basis_of,
    direction_errors,
    kind_of,
    scatter,
    worst_pair,
    worst_size,
    worst_turn,
    worst_vector,
)
from imucalib.errors import UNEXPLAINED_EXIT_CODE, LimitBroken, UnreadableInput, UsageError
from imucalib.estimators.power_ups import excess, fit_line
from imucalib.posterior.closed_loop.changes import NOISE
from imucalib.units import DEG, MG

Verdict = Literal["agree", "differ", "undecided"]
#: Stated standard deviations that a difference may reach where no limit is given.
SIGNIFICANT = 2.0
#: Attitudes that chance sees independently: the largest of what nine parameters of like effect do
#: over 400 attitudes exceeds its 95 % quantile as the largest of 29 to 34 numbers does (simulated).
_INDEPENDENT = 30
#: Days between the first and the last from which on times of the runs stand in for recordings.
_APART = 1.0


@dataclass(frozen=True)
class Dates:
    """days : (m,) since the first; start : of the first; words : where they are from"""

    days: Array
    start: datetime
    words: str


def dates_of(calibrations: Sequence[Calibration], stated: Sequence[str]) -> Dates | None:
    """As stated, else as the recordings say, else by the runs where these lie days apart; None
    where none of this tells a difference. Raises UsageError for dates that are none."""
    if stated:
        if len(stated) != len(calibrations):
            raise UsageError(
                f"{len(stated)} dates for {len(calibrations)} calibrations",
                remedy="give one a file, in their order: --dates 2026-01-31,2026-07-31",
            )
        found = _dates([_parse_date(text) for text in stated], "dates as given")
        if found is None:
            raise UsageError(
                "all dates are the same: nothing can drift between them",
                remedy="leave out --dates, or give the times of day",
            )
        return found
    starts = [(c.facts.get("clock") or {}).get("start_ns") for c in calibrations]
    if all(isinstance(s, int) for s in starts):
        known = [datetime.fromtimestamp(s / 1e9, UTC) for s in starts if s is not None]
        return _dates(known, "dates as the recordings have them")
    runs = [(c.facts.get("provenance") or {}).get("time") for c in calibrations]
    when = [_parse_date(r) for r in runs if isinstance(r, str)]
    if len(when) < len(runs):
        return None
    found = _dates(
        when,
        "dates are those of the runs of imucal, not of the recordings, which state none (--dates)",
    )
    return found if found is not None and np.ptp(found.days) >= _APART else None


def _parse_date(text: str) -> datetime:
    try:
        found = datetime.fromisoformat(text.strip())
    except ValueError:
        raise UsageError(
            f"'{text}' is no date", remedy="write it as 2026-07-31 or 2026-07-31T12:00:00Z"
        ) from None
    return found if found.tzinfo else found.replace(tzinfo=UTC)


def _dates(when: list[datetime], words: str) -> Dates | None:
    first = min(when)
    days = np.array([(w - first).total_seconds() / 86400.0 for w in when])
    return Dates(days, first, words) if np.ptp(days) > 0.0 else None


def is_mounted(calibration: Calibration) -> bool:
    """Whether a calibration ties a frame to a tool."""
    return any(p.effect == "mounting" for p in calibration.parameters)


def remarks(
    calibrations: Sequence[Calibration], names: Sequence[str], *, framed: bool
) -> tuple[str, ...]:
    """One sentence each. framed : whether directions can be compared."""
    notes = []
    provenance = [c.facts.get("provenance") or {} for c in calibrations]
    inputs = [set(b.get("inputs_sha256") or [b.get("sha256")]) - {None, ""} for b in provenance]
    if len(set().union(*inputs)) < sum(map(len, inputs)):
        notes.append(
            "two of them were made from the same recording: their errors are shared, so the "
            "standard deviations of the difference are too large and they seem to agree too well"
        )
    gravities = [c.gravity for c in calibrations]
    if np.ptp(gravities) > 1e-9:
        size, each = np.ptp(gravities) / MG, ", ".join(f"{g:.5f}" for g in gravities)
        notes.append(
            f"they assume gravities {size:.2g} mg apart ({each} m/s²): right where "
            "they were recorded in different places, else this difference is in all scales"
        )
    if len({c.raw_to_si for c in calibrations}) > 1:
        units = ", ".join(c.raw_unit for c in calibrations)
        notes.append(f"their readings are in {units}: compared in m/s²")
    makers = [c.calibrator for c in calibrations]
    if len(set(makers)) > 1:
        notes.append(f"they were made by {', '.join(makers)}")
    if not framed:
        tied = [n for n, c in zip(names, calibrations, strict=True) if is_mounted(c)]
        notes.append(
            f"only {', '.join(tied)} tie{'s' * (len(tied) == 1)} a frame to a tool: directions are "
            "not compared"
        )
    notes += [
        f"status of {name}: {c.status}" + (f" ({'; '.join(c.reasons)})" if c.reasons else "")
        for name, c in zip(names, calibrations, strict=True)
        if c.status != "ok"
    ]
    return tuple(notes)


def with_power_ups(
    calibrations: Sequence[Calibration], given: Mapping[str, float]
) -> tuple[tuple[Calibration, ...], PowerUps | None, str]:
    """The calibrations with what power-ups scatter by in their covariances; what of them that is,
    or None where nothing tells it; and in words where it is from.

    given : kind of change -> its scatter (bias mg, mounting deg) instead of what files state
    """
    stated = [read_sessions(c) for c in calibrations]
    scatter = {kind: Scatter(size) for kind, size in given.items()} or _pool_variances(stated)
    if not scatter:
        words = (
            "what a power-up changes is in no sd: a bias that differs may be another day's "
            "(--between-sessions)"
        )
        return tuple(calibrations), None, words
    made, share = [], []
    for calibration, own in zip(calibrations, stated, strict=True):
        # The mean of several power-ups holds its share, one of them none.
        count = len(calibration.facts["between_sessions"]["sessions"]) if own else 1
        sizes = own or scatter
        sds = [sizes[p.effect].sd if p.effect in sizes else 0.0 for p in calibration.parameters]
        part = np.diag(np.square(np.array(sds, np.float64)) / count)
        whole = calibration.covariance if own else calibration.covariance + part
        made.append(replace(calibration, covariance=whole))
        share.append(part)
    source = "as given" if given else "as the calibrations of several state"
    alone = sum(not one for one in stated)
    words = (
        f"power-ups scatter by {sizes_in_words(scatter)}, {source}: in the sds of {alone} of one "
        "power-up"
    )
    return tuple(made), PowerUps(share, min(s.dof for s in scatter.values())), words


def _pool_variances(stated: Sequence[Mapping[str, Scatter]]) -> dict[str, Scatter]:
    """Mean of the variances that files state, by their degrees of freedom."""
    found = {}
    for kind in FAMILIES:
        every = [one[kind] for one in stated if kind in one]
        if every:
            dof = sum(s.dof for s in every)
            found[kind] = Scatter((sum(s.dof * s.sd**2 for s in every) / dof) ** 0.5, dof)
    return found


def meanings_of(
    found: Mapping[str, DirectionErrors], limits: Limits, *, turns: bool
) -> tuple[Worst, ...]:
    """Force, and where it can be compared direction, of the sensor where it is largest."""
    sds = [one.largest_sd for one in found.values()]
    force, direction = limits.get("mg"), limits.get("deg")
    if not limits:
        force, direction = (SIGNIFICANT * max(column) for column in zip(*sds, strict=True))
    made = []
    for limit, worst in ((force, worst_size), (direction if turns else None, worst_turn)):
        if limit is not None:
            every = [replace(worst(one), sensor=name, limit=limit) for name, one in found.items()]
            made.append(max(every, key=lambda one: one.value))
    return tuple(made)


def array_meanings(
    calibrations: Sequence[Calibration], basis: Basis, limits: Limits
) -> tuple[tuple[Worst, ...], tuple[str, ...]]:
    """Positions in mm and biases of gyroscopes in deg/s, of which the files state no sd."""
    limit = limits.get("mm")
    if not limits:
        limit = SIGNIFICANT * float(np.sqrt(np.einsum("kii->ki", basis.covariance).max()))
    made = () if limit is None else (_places(calibrations, basis, limit),)
    rates = np.array([[t.gyro_bias / DEG for t in c.triads] for c in calibrations])
    pair, away, at = worst_pair(len(rates), lambda i, j: np.abs(rates[j] - rates[i]))
    k, axis = divmod(at, 3)
    name = calibrations[0].triads[k].name
    said = (
        f"the gyroscopes' biases differ by {away:.2g} deg/s at most ({name}, {'xyz'[axis]}); the "
        "files state no uncertainty of these, so they are told and not tested"
    )
    if "deg/s" in limits:
        along, limit = np.eye(3)[axis], limits["deg/s"]
        worst = Worst(pair, away, math.nan, "deg/s", along, sensor=name, limit=limit)
        made = (*made, worst)
    return made, (said,)


def _places(calibrations: Sequence[Calibration], basis: Basis, limit: float) -> Worst:
    """The IMU whose position differs most."""
    places = basis.value.reshape(len(calibrations), -1, 3)
    m, imus = places.shape[:2]
    each = basis.covariance.reshape(m, imus, 3, imus, 3)
    own = np.stack([each[:, k, :, k] for k in range(imus)], axis=1)
    worst, k = worst_vector(places, own, "mm")
    return replace(worst, sensor=calibrations[0].triads[k + 1].name, limit=limit)


@dataclass(frozen=True)
class Slope:
    """Per day, with the half width of its 95 % interval, in the value's unit."""

    value: float
    half: float

    @property
    def shown(self) -> bool:
        """Whether the interval excludes zero."""
        return abs(self.value) > self.half


@dataclass(frozen=True)
class Due:
    """When a drift reaches a limit, days after the last calibration. attitude : (3,) where it does
    first; slope : there; expected : by the slope itself, infinite where none shows; earliest : by
    the upper edge of its interval"""

    slope: Slope
    attitude: Array
    limit: float
    unit: str
    expected: float
    earliest: float


def slope_of(days: Array, value: Array, variance: Array, among: int = 1) -> Slope:
    """days, value, variance : (m,); among : so many at once that the interval holds for all"""
    from scipy.special import ndtri, stdtrit

    dof = days.size - 2
    design = np.column_stack([np.ones(days.size), days - days.mean()])
    extra = excess(float(dof), value, variance, design) if dof else 0.0
    b, covariance, _ = fit_line(value, variance + extra, design)
    level = 1.0 - 0.025 / among
    quantile = float(stdtrit(dof, level) if dof else ndtri(level))
    return Slope(float(b[1]), quantile * float(covariance[1, 1]) ** 0.5)


def due(
    days: Array, value: Array, variance: Array, attitude: Array, limit: float, *, sensors: int = 1
) -> Due:
    """value, variance : (m, n) in mg, in n attitudes (n, 3); limit : mg; sensors : so many"""
    among = _INDEPENDENT * sensors
    slopes = [slope_of(days, v, s, among) for v, s in zip(value.T, variance.T, strict=True)]
    reach = np.array([abs(s.value) + s.half for s in slopes])
    shown = np.array([abs(s.value) if s.shown else 0.0 for s in slopes])
    at = int(np.argmax(np.where(shown.any(), shown, reach)))
    fastest = float(shown.max())
    return Due(
        slope=slopes[at],
        attitude=attitude[at],
        limit=limit,
        unit="mg",
        expected=limit / fastest if fastest > 0.0 else np.inf,
        earliest=float(limit / reach.max()),
    )


@dataclass(frozen=True)
class CalibrationDrift:
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
    scatter: ParameterScatter | None
    meanings: tuple[Worst, ...]
    seen: Mapping[str, DirectionErrors]
    drift: CalibrationDrift | None
    stated: bool
    notes: tuple[str, ...]

    @property
    def differ(self) -> bool:
        """Whether it is likelier that they differ than that they scatter as they state."""
        return self.agreement.answer.told

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
        """Of three and more, the files that differ from the others."""
        return tuple(self.names[k] for k in self.agreement.odd)

    @property
    def differing(self) -> Mapping[str, float]:
        """Probability of each kind of parameters that it differs, in any file, and of a scatter
        beyond what is stated."""
        kinds = dict.fromkeys(map(kind_of, self.basis.names))
        found = {kind: self.agreement.differs_in(kind) for kind in kinds}
        return {**found, "scatter": self.agreement.answer.of(NOISE)}


def compare(
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
    framed = arrays or len({is_mounted(c) for c in calibrations}) == 1
    # Of each covariance's scale, by the noise that its file states.
    dof = np.array([check_noise(c).reading.dof for c in calibrations])
    if arrays and between:
        raise UsageError(
            "arrays are compared without the scatter of power-ups",
            remedy="leave out --between-sessions",
        )
    calibrations, power_ups, words = with_power_ups(calibrations, between or {})
    basis = basis_of(calibrations, dof, framed=framed, power_ups=power_ups)
    gravity = calibrations[0].gravity
    imus = {t.name: k for k, t in enumerate(calibrations[0].triads)}
    sensors: dict[str, int | None] = {**imus} or {"": None}
    found = {name: direction_errors(calibrations, imu, gravity) for name, imu in sensors.items()}
    turns = framed and not arrays
    if "deg" in limits and not turns:
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
        notes = (*notes, words)
    when = dates_of(calibrations, dates)
    return Comparison(
        names=tuple(names),
        basis=basis,
        agreement=agreement(basis),
        scatter=scatter(basis),
        meanings=meanings,
        seen=found,
        drift=None if when is None else _drift(when, basis, found, meanings),
        stated=bool(limits),
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


def _drift(
    dates: Dates, basis: Basis, found: Mapping[str, DirectionErrors], meanings: tuple[Worst, ...]
) -> CalibrationDrift:
    variance = np.einsum("kii->ik", basis.covariance)
    slopes = tuple(
        slope_of(dates.days, value, own) for value, own in zip(basis.value.T, variance, strict=True)
    )
    force = next((m for m in meanings if m.unit == "mg"), None)
    limit = force.limit if force else SIGNIFICANT * max(s.largest_sd[0] for s in found.values())
    reached = [
        due(dates.days, one.size, one.size_sd**2, one.attitude, limit, sensors=len(found))
        for one in found.values()
    ]
    return CalibrationDrift(dates, slopes, min(reached, key=lambda d: (d.expected, d.earliest)))
