"""Gross errors of single records: how large, and the likely slip of the pen behind each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import permutations

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Noise
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.references import KnownNorm, KnownVector, angles_of
from imucalib.core.sphere import KnownDirection
from imucalib.effects.record_error import is_record_error, record_error, record_of
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop.candidates import ALL_TRIADS
from imucalib.loop.held_out import theta_without, without_records
from imucalib.units import DEG, MG


def set_aside(fit: Fit, row: int) -> Fit:
    """Refit with all numbers of a record free.

    The whole record goes, whichever of its numbers stood out: what is left of it could otherwise
    be fitted by a setting that is as wrong as the number was.
    """
    observations = fit.observations
    triads = observations.reading.shape[1]
    known = fit.at.keep.shape[2] == 3 * triads
    # One number for one: its size is that of gravity, which the axis along gravity shows best.
    along = "xyz"[int(np.argmax(np.abs(observations.reading[row, 0])))]
    axes = "xyz" if known or triads > 1 else along
    effect = record_error(record_number(fit, row), observations.label[row], axes)
    nominal = observations.reference.truth(_settled(fit))
    predicted = fit.model.predict(fit.theta, nominal, observations.context).reading
    off = (observations.reading[row, 0] - predicted[row, 0]) / MG
    return extended(fit, effect, off if known else None)


def foreseen(fit: Fit, aside: Fit) -> bool:
    """Whether the other records tell what one that was set aside should have been. Of several
    triads a rest leaves its attitude open, which no record has to tell."""
    alone = fit.observations.reading.shape[1] == 1
    opened = len(aside.null_directions) > len(fit.null_directions)
    return aside.converged and not (alone and opened)


def _settled(fit: Fit) -> Array:
    """η with the settings as they were meant, for references that have settings."""
    return np.zeros_like(fit.eta) if fit.at.free else fit.eta


def accused(fit: Fit, found: Sequence[tuple[int, float]]) -> tuple[RecordError, ...]:
    """The same of rows and the probability of each, by the number that is farthest off."""
    return tuple(diagnose(fit, row, _channel(fit, row), p) for row, p in found)


def _of_triads_each(fit: Fit, row: int) -> str:
    """The triad that is farther off the others than these are off gravity's size, or all; of a
    single one the norm."""
    context, reference = fit.observations.context, fit.observations.reference
    if len(context.triads) == 1:
        return "norm"
    rows = np.array([row])
    theta = without_records(fit, theta_without(fit, rows))
    force = fit.model.correct(theta, fit.observations.reading[rows], context.take(rows))
    common = context.in_common(force)[0]
    middle = np.median(common, axis=0)
    away = np.linalg.norm(common - middle, axis=1)
    gravity = float(np.linalg.norm(reference.truth(fit.eta)[row, 0]))
    alone = float(away.max()) > abs(float(np.linalg.norm(middle)) - gravity)
    return context.triads[int(np.argmax(away))] if alone else ALL_TRIADS


def _channel(fit: Fit, row: int) -> str:
    """Which axis of a record is off most."""
    if not fit.observations.reference.directed:
        return _of_triads_each(fit, row)
    said = predict_record(fit, row)
    away = np.abs(fit.observations.reading[row, 0] - said.mean)
    return "xyz"[int(np.argmax(away / np.sqrt(np.diag(said.covariance))))]


def extended(
    fit: Fit, effect: Effect, start: Array | None = None, noise: Noise | None = None
) -> Fit:
    """Refit with one more effect, from where the fit is; `start` for the effect's parameters,
    `noise` to hold it at."""
    return _refit(fit, fit.model.plus(effect), effect.name, start, noise)


def reduced(fit: Fit, names: tuple[str, ...]) -> Fit:
    """Refit without some effects, from where the fit is."""
    return _refit(fit, Model(tuple(e for e in fit.model.effects if e.name not in names)))


def _refit(
    fit: Fit,
    model: Model,
    fresh: str = "",
    values: Array | None = None,
    noise: Noise | None = None,
) -> Fit:
    context = fit.observations.context
    start, own = model.start(context), model.slices(context)
    for name, part in fit.model.slices(context).items():
        if name in own:
            start[own[name]] = fit.theta[part]
    if values is not None:
        start[own[fresh]] = values
    return fit_model(model, fit.observations, start=start, noise=noise)


@dataclass(frozen=True)
class RecordError:
    """One record that does not belong to the rest.

    row : index of the observation; where : its label; channel : "x", "y", "z", "norm" or an angle
    size : mg (deg for an angle), how far the record is from what the others predict; sd alike
    likely : the slip that would explain it; fix : channel -> value in m/s² or deg, when known
    """

    row: int
    where: str
    channel: str
    size: float
    sd: float
    unit: str
    likely: str
    fix: tuple[tuple[str, float], ...]
    probability: float


@dataclass(frozen=True)
class Prediction:
    """The other records' prediction of one record: mean (3,) and covariance (3, 3), m/s²."""

    mean: Array
    covariance: Array

    def distance(self, reading: Array) -> float:
        """Squared Mahalanobis distance, chi-square with 3 degrees of freedom."""
        away = reading - self.mean
        return float(away @ np.linalg.solve(self.covariance, away))


def record_number(fit: Fit, row: int) -> int:
    """Number of a record in the whole recording, which a subset keeps; row : of the fit's."""
    return int(fit.observations.context["record"][row])


def record_names(fit: Fit, row: int | None = None) -> tuple[str, ...]:
    """Names of the record errors in a fit's model, of one row or of all."""
    every = [name for name in fit.model.names if is_record_error(name)]
    return tuple(n for n in every if row is None or record_of(n) == record_number(fit, row))


def predict_record(aside: Fit, row: int) -> Prediction:
    """Predict one record (K = 1) from all others, from a fit in which its numbers are free: what
    rows at the same setting tell of the setting's error is part of it."""
    (name,) = record_names(aside, row)
    own = aside.model.slices(aside.observations.context)[name]
    mean = aside.observations.reading[row, 0] - MG * aside.theta[own]
    return Prediction(mean, MG**2 * aside.covariance[own, own])


def diagnose(fit: Fit, row: int, channel: str, probability: float) -> RecordError:
    """Name the error of a record from the fit in which it was set aside."""
    label = fit.observations.label[row]
    reading = fit.observations.reading[row, 0]
    reference = fit.observations.reference
    said = partial(RecordError, row=row, where=label, probability=probability)
    if not reference.directed:
        assert isinstance(reference, KnownNorm)
        if reference.attitude is not None:
            return _of_triads(fit, row, channel, probability)
        size = float(np.linalg.norm(_corrected_without(fit, row)[0])) - reference.gravity
        sd = fit.noise.factor * float(fit.observations.sigma[row, 0, 0]) / MG
        likely = "movement, contact or a wrong record"
        return said(channel="norm", size=size / MG, sd=sd, unit="mg", likely=likely, fix=())
    expected = predict_record(fit, row)
    likely, fix = _slip(fit, row, reading, expected)
    # A slip of one number is that number's error, even where an angle would imitate it.
    channel = fix[0][0] if len(fix) == 1 else channel
    if channel in ("x", "y", "z"):
        axis = "xyz".index(channel)
        size = float(reading[axis] - expected.mean[axis]) / MG
        sd = float(np.sqrt(expected.covariance[axis, axis])) / MG
        return said(channel=channel, size=size, sd=sd, unit="mg", likely=likely, fix=fix)
    away = _angle_away(fit, row, channel) / DEG
    sd = _angle_sd(fit, row, channel) / DEG
    name = channel.replace(" setting", "")
    return said(channel=name, size=away, sd=sd, unit="deg", likely=likely, fix=fix)


def _of_triads(fit: Fit, row: int, channel: str, probability: float) -> RecordError:
    """Of triads that share gravity's direction: how far one of them is off the others, or all off
    gravity's size."""
    context, reference = fit.observations.context, fit.observations.reference
    assert isinstance(reference, KnownNorm)
    force = context.in_common(_corrected_without(fit, row)[None])[0]
    size = float(np.linalg.norm(np.median(force, axis=0))) - reference.gravity
    likely = "movement, or no rest at all"
    if channel in context.triads:
        k = context.triads.index(channel)
        others = np.median(np.delete(force, k, axis=0), axis=0)
        size, likely = float(np.linalg.norm(force[k] - others)), "a chip that hung or was touched"
    sd = fit.noise.factor * float(fit.observations.sigma[row].mean()) / MG
    label = fit.observations.label[row]
    return RecordError(
        row=row,
        where=label,
        channel=channel,
        size=size / MG,
        sd=sd,
        unit="mg",
        likely=likely,
        fix=(),
        probability=probability,
    )


def _corrected_without(fit: Fit, row: int) -> Array:
    """A record (K, 3) in m/s², corrected by a fit of the others."""
    rows = np.array([row])
    data = fit.observations
    theta = without_records(fit, theta_without(fit, rows))
    corrected = fit.model.correct(theta, data.reading[rows], data.context.take(rows))
    return np.asarray(corrected[0])


def _angle_away(fit: Fit, row: int, component: str) -> float:
    """Angle (rad) of the corrected record minus the angle that was set."""
    reference = fit.observations.reference
    corrected = _corrected_without(fit, row)[0]
    if isinstance(reference, KnownDirection):
        along = reference.direction[row]
        across = float(np.linalg.norm(np.cross(along, corrected)))
        return float(np.arctan2(across, along @ corrected))
    assert isinstance(reference, KnownVector)
    inclination, tool_face = angles_of(corrected)
    if component.startswith("inclination"):
        return float(inclination - reference.inclination[row])
    away = float(tool_face - reference.tool_face[row])
    return float(np.mod(away + np.pi, 2.0 * np.pi) - np.pi)


def _angle_sd(fit: Fit, row: int, component: str) -> float:
    """Standard deviation (rad) of `_angle_away`: of the setting, and of the reading across it."""
    reference = fit.observations.reference
    assert isinstance(reference, KnownVector | KnownDirection)
    setting = fit.noise.sd[fit.noise.component.index(component)]
    across = fit.noise.factor * float(fit.observations.sigma[row].max()) / reference.gravity
    if isinstance(reference, KnownVector) and not component.startswith("inclination"):
        across /= max(float(np.cos(reference.inclination[row])), across)
    return float(np.hypot(setting, across))


def _wrong_face(stood: Array, meant: Array) -> str:
    """In words, the direction of a record whose direction is not the one that was meant."""
    if stood @ meant > _SAME_FACE:
        return "no single slip explains it"
    axis = int(np.argmax(np.abs(stood)))
    if abs(stood[axis]) > _SAME_FACE:
        return f"direction: the record fits face {'+' if stood[axis] > 0.0 else '-'}{'xyz'[axis]}"
    return f"direction: the record fits {stood[0]:+.3f}, {stood[1]:+.3f}, {stood[2]:+.3f}"


_SAME_FACE = float(np.cos(5.0 * DEG))
_NEAR = 16.3  # chi-square with 3 degrees of freedom, p = 0.001
_FAR = 4.0  # standard deviations of an angle that no hand sets


def _slip(
    fit: Fit, row: int, reading: Array, expected: Prediction
) -> tuple[str, tuple[tuple[str, float], ...]]:
    """The one-step slip that brings the record nearest to its prediction, if near enough."""
    tries: list[tuple[float, str, tuple[tuple[str, float], ...]]] = []
    for axis, name in enumerate("xyz"):
        for factor, words in (
            (-1.0, f"lost sign of {name}"),
            (10.0, f"{name} is ten times too small"),
            (0.1, f"{name} is ten times too large"),
        ):
            changed = reading.copy()
            changed[axis] *= factor
            tries.append((expected.distance(changed), words, ((name, float(changed[axis])),)))
    for order in permutations(range(3)):
        if order != (0, 1, 2):
            changed = reading[list(order)]
            moved = ", ".join("xyz"[k] for k in order)
            fix = tuple(zip("xyz", (float(v) for v in changed), strict=True))
            tries.append((expected.distance(changed), f"columns swapped (read as {moved})", fix))
    others = fit.observations.reading[:, 0]
    same = np.flatnonzero(np.all(np.isclose(others, reading, rtol=1e-12, atol=0.0), axis=1))
    if same.size > 1:
        twin = next(k for k in same if k != row)
        return f"a copy of {fit.observations.label[twin]}", ()
    distance, words, fix = min(tries, key=lambda t: t[0])
    if distance < _NEAR:
        return words, fix
    return _wrong_angle(fit, row)


def _wrong_angle(fit: Fit, row: int) -> tuple[str, tuple[tuple[str, float], ...]]:
    """A reading of the right size in another direction was taken at another setting."""
    reference = fit.observations.reference
    assert isinstance(reference, KnownVector | KnownDirection)
    corrected = _corrected_without(fit, row)[0]
    off = abs(float(np.linalg.norm(corrected)) - reference.gravity)
    if off > 5.0 * fit.noise.factor * float(fit.observations.sigma[row].max()):
        return "no single slip explains it", ()
    if isinstance(reference, KnownDirection):
        return _wrong_face(corrected / np.linalg.norm(corrected), reference.direction[row]), ()
    angles = [name for name in fit.noise.component[: fit.at.free] if name]
    if all(abs(_angle_away(fit, row, a)) < _FAR * _angle_sd(fit, row, a) for a in angles):
        return "no single slip explains it", ()
    inclination, tool_face = (float(a) / DEG for a in angles_of(corrected))
    return f"angle: the tool stood at inclination {inclination:.1f}, tool-face {tool_face:.1f}", ()
