"""Gross errors of single records: how large, and the likely slip of the pen behind each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.references import KnownVector, angles_of
from imucalib.core.sphere import KnownDirection
from imucalib.effects.record_error import is_record_error, record_error, record_of
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.posterior.held_out import theta_without, without_records
from imucalib.posterior.odds import FAR_ANGLE, FAR_SIZE, SAME_FACE, WITHIN
from imucalib.units import DEG, MG

#: Name of an error that all triads of one rigid body share.
ALL_TRIADS = "all"
_UNEXPLAINED = "no single slip explains it"
_Fix = tuple[tuple[str, float], ...]
#: Channel, size and sd (m/s²), the likely slip, and what would mend it.
_Said = tuple[str, float, float, str, _Fix]


@dataclass(frozen=True)
class RecordError:
    """One record that does not belong to the rest.

    row : index of the observation; where : its label; channel : "x", "y", "z", "norm" or a triad
    size : mg, how far the record is from what the others predict; sd alike
    likely : the slip that would explain it; fix : channel -> value in m/s², when known
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


def refit(fit: Fit, model: Model, values: Mapping[str, Array] | None = None) -> Fit:
    """Another model fitted to the same observations, from where the fit is; values : to start from
    of effects that the fit does not have."""
    context = fit.observations.context
    start, own = model.start(context), model.slices(context)
    known = {name: fit.theta[part] for name, part in fit.model.slices(context).items()}
    for name, value in {**known, **(values or {})}.items():
        if name in own:
            start[own[name]] = value
    return fit_model(model, fit.observations, start=start)


def drop_effects(fit: Fit, names: Sequence[str]) -> Fit:
    """Refit without some effects, from where the fit is."""
    return refit(fit, Model(tuple(e for e in fit.model.effects if e.name not in names)))


def record_names(fit: Fit) -> tuple[str, ...]:
    """Names of the record errors in a fit's model."""
    return tuple(name for name in fit.model.names if is_record_error(name))


def set_aside(fit: Fit, row: int) -> Fit | None:
    """Refit with all numbers of a record free; None where the others do not tell what it should
    have been. Of several triads a rest leaves its attitude open, which no record has to tell.

    The whole record goes, whichever of its numbers stood out: what is left of it could otherwise
    be fitted by a setting that is as wrong as the number was.
    """
    data = fit.observations
    alone = data.reading.shape[1] == 1
    known = fit.at.keep.shape[2] == 3 * data.reading.shape[1]
    # One number for one: its size is that of gravity, which the axis along gravity shows best.
    along = "xyz"[int(np.argmax(np.abs(data.reading[row, 0])))]
    effect = record_error(
        int(data.context["record"][row]), data.label[row], along if alone and not known else "xyz"
    )
    values = {}
    if known:
        # Settings as they were meant: fitted ones have followed the wrong numbers.
        meant = data.reference.truth(np.zeros_like(fit.eta) if fit.at.free else fit.eta)
        predicted = fit.model.predict(fit.theta, meant, data.context).reading
        values[effect.name] = (data.reading[row, 0] - predicted[row, 0]) / MG
    aside = refit(fit, fit.model.plus(effect), values)
    opened = len(aside.null_directions) > len(fit.null_directions)
    return aside if aside.converged and not (alone and opened) else None


def accuse(fit: Fit, found: Sequence[tuple[int, float]]) -> tuple[RecordError, ...]:
    """Of rows and the probability of each, from the fit in which their numbers are free: the number
    that is farthest off, or the one that a slip of the pen explains."""
    return tuple(_diagnose(fit, row, probability) for row, probability in found)


def _diagnose(fit: Fit, row: int, probability: float) -> RecordError:
    if fit.observations.reference.directed:
        said = _of_numbers(fit, row)
    elif len(fit.observations.context.triads) == 1:
        said = _of_norm(fit, row)
    else:
        said = _of_triads(fit, row)
    channel, size, sd, likely, fix = said
    return RecordError(
        row=row,
        where=fit.observations.label[row],
        channel=channel,
        size=size / MG,
        sd=sd / MG,
        unit="mg",
        likely=likely,
        fix=fix,
        probability=probability,
    )


def _of_norm(fit: Fit, row: int) -> _Said:
    size = float(np.linalg.norm(_correct_by_others(fit, row)[0])) - _gravity(fit, row)
    sd = fit.noise.factor * float(fit.observations.sigma[row, 0, 0])
    return "norm", size, sd, "movement, contact or a wrong record", ()


def _of_triads(fit: Fit, row: int) -> _Said:
    """The triad that is farther off the others than these are off gravity's size, or all."""
    context = fit.observations.context
    force = context.in_common(_correct_by_others(fit, row)[None])[0]
    middle = np.median(force, axis=0)
    away = np.linalg.norm(force - middle, axis=1)
    size = float(np.linalg.norm(middle)) - _gravity(fit, row)
    sd = fit.noise.factor * float(fit.observations.sigma[row].mean())
    if not away.max() > abs(size):
        return ALL_TRIADS, size, sd, "movement, or no rest at all", ()
    k = int(np.argmax(away))
    others = np.median(np.delete(force, k, axis=0), axis=0)
    apart = float(np.linalg.norm(force[k] - others))
    return context.triads[k], apart, sd, "a chip that hung or was touched", ()


def _of_numbers(fit: Fit, row: int) -> _Said:
    """A slip of one number is that number's error, even where an angle would imitate it."""
    mean, covariance = _predict(fit, row)
    away = fit.observations.reading[row, 0] - mean
    sd = np.sqrt(np.diag(covariance))
    likely, fix = _slip(fit, row, mean, covariance)
    axis = "xyz".index(fix[0][0]) if len(fix) == 1 else int(np.argmax(np.abs(away) / sd))
    return "xyz"[axis], float(away[axis]), float(sd[axis]), likely, fix


def _predict(aside: Fit, row: int) -> tuple[Array, Array]:
    """Mean (3,) and covariance (3, 3), m/s², of one record (K = 1) by all others, from a fit in
    which its numbers are free: what rows at the same setting tell of its error is part of it."""
    data = aside.observations
    number = int(data.context["record"][row])
    (name,) = (n for n in record_names(aside) if record_of(n) == number)
    own = aside.model.slices(data.context)[name]
    mean = data.reading[row, 0] - MG * aside.theta[own]
    return mean, MG**2 * aside.covariance[own, own]


def _correct_by_others(fit: Fit, row: int) -> Array:
    """A record (K, 3) in m/s², corrected by a fit of the others."""
    rows, data = np.array([row]), fit.observations
    theta = without_records(fit, theta_without(fit, rows))
    corrected = fit.model.correct(theta, data.reading[rows], data.context.take(rows))
    return np.asarray(corrected[0])


def _gravity(fit: Fit, row: int) -> float:
    return float(np.linalg.norm(fit.observations.reference.truth(fit.eta)[row, 0]))


def _slip(fit: Fit, row: int, mean: Array, covariance: Array) -> tuple[str, _Fix]:
    """The one-step slip that brings the record nearest to its prediction, if near enough."""
    every = fit.observations.reading[:, 0]
    same = np.flatnonzero(np.all(np.isclose(every, every[row], rtol=1e-12, atol=0.0), axis=1))
    if same.size > 1:
        twin = next(k for k in same if k != row)
        return f"a copy of {fit.observations.label[twin]}", ()

    def distance(changed: Array) -> float:
        """Chi-square with 3 degrees of freedom."""
        away = changed - mean
        return float(away @ np.linalg.solve(covariance, away))

    words, changed = min(_slips(every[row]), key=lambda slip: distance(slip[1]))
    if distance(changed) >= WITHIN:
        return _wrong_angle(fit, row), ()
    moved = zip("xyz", changed, every[row], strict=True)
    return words, tuple((name, float(new)) for name, new, old in moved if new != old)


def _slips(reading: Array) -> Iterator[tuple[str, Array]]:
    """Every slip in words, and the reading (3,) without it."""
    for axis, name in enumerate("xyz"):
        for factor, words in (
            (-1.0, f"lost sign of {name}"),
            (10.0, f"{name} is ten times too small"),
            (0.1, f"{name} is ten times too large"),
        ):
            changed = reading.copy()
            changed[axis] *= factor
            yield words, changed
    for order in list(permutations(range(3)))[1:]:
        moved = ", ".join("xyz"[k] for k in order)
        yield f"columns swapped (read as {moved})", reading[list(order)]


def _wrong_angle(fit: Fit, row: int) -> str:
    """A reading of the right size in another direction was taken at another setting."""
    reference = fit.observations.reference
    assert isinstance(reference, KnownVector | KnownDirection)
    corrected = _correct_by_others(fit, row)[0]
    noise = fit.noise.factor * float(fit.observations.sigma[row].max())
    if abs(float(np.linalg.norm(corrected)) - reference.gravity) > FAR_SIZE * noise:
        return _UNEXPLAINED
    if isinstance(reference, KnownDirection):
        return _wrong_face(corrected / np.linalg.norm(corrected), reference.direction[row])
    stood = np.array(angles_of(corrected))
    away = stood - [reference.inclination[row], reference.tool_face[row]]
    away[1] = np.mod(away[1] + np.pi, 2.0 * np.pi) - np.pi
    across = noise / reference.gravity
    level = max(float(np.cos(reference.inclination[row])), across)
    sd = np.hypot(fit.noise.sd[: fit.at.free], [across, across / level][: fit.at.free])
    if np.all(np.abs(away[: sd.size]) < FAR_ANGLE * sd):
        return _UNEXPLAINED
    inclination, tool_face = stood / DEG
    return f"angle: the tool stood at inclination {inclination:.1f}, tool-face {tool_face:.1f}"


def _wrong_face(stood: Array, meant: Array) -> str:
    """In words, the direction of a record whose direction is not the one that was meant."""
    if stood @ meant > SAME_FACE:
        return _UNEXPLAINED
    axis = int(np.argmax(np.abs(stood)))
    if abs(stood[axis]) > SAME_FACE:
        return f"direction: the record fits face {'+' if stood[axis] > 0.0 else '-'}{'xyz'[axis]}"
    return f"direction: the record fits {stood[0]:+.3f}, {stood[1]:+.3f}, {stood[2]:+.3f}"
