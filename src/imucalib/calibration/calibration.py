"""A calibration apart from the data it came from: made from a fit, applied to readings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.triads import Triad
from imucalib.calibration.uncertainty import force_slopes, select_correctable
from imucalib.core.effect import Context
from imucalib.core.fit import Fit, StoredParameter
from imucalib.core.model import Model
from imucalib.data import fields
from imucalib.effects import known
from imucalib.effects.record_error import is_record_error
from imucalib.errors import UnreadableInput, UsageError
from imucalib.recording.identity import NAMELESS, Identity
from imucalib.units import ACCELERATION_UNITS, DEG, MG

#: The reason of a calibration that is none, kept for the record errors in its report.
UNSETTLED = "the fit did not settle"


#: Times gravity from which on a reading of usual size is in another unit.
_ANOTHER_UNIT = 4.0
#: Stages of parameters that no correction of a reading undoes.
NEVER_APPLIED = ("fixture", "array", "gyroscope")
#: Covariates by which time drives an effect: a later reading finds what they have come to.
PASSING = ("order", "record", "time")
#: Effects that make up the matrices.
LINEAR = ("mounting", "bias", "scale", "non_orthogonality")


def where_assumed(covariate: str) -> str:
    """In words, where in what was calibrated a covariate acts that was not recorded."""
    return "at the end" if covariate in PASSING else "in the middle"


def lacking(effect: str, names: Sequence[str], where: str = "") -> UnreadableInput:
    """The error of an effect whose covariates a recording lacks. where : the recording's path"""
    return UnreadableInput(
        f"effect {effect} needs {', '.join(names)}, which the recording lacks",
        where=where,
        remedy=f"record it, or calibrate with --without {effect}",
    )


@dataclass(frozen=True)
class Matrices:
    """corrected = M raw + b and raw = S corrected + c, raw and corrected in m/s².

    scale : (3,) length of S's rows, sensitivity of each axis; angle : (3,) deg between the sensing
    axes xy, xz, yz. Both are free of the frame: a rotation of the tool does not change them.
    *_sd : standard deviations, same shapes
    """

    M: Array
    b: Array
    S: Array
    S_sd: Array
    c: Array
    M_sd: Array
    b_sd: Array
    scale: Array
    scale_sd: Array
    angle: Array
    angle_sd: Array
    bias_mg: Array
    bias_mg_sd: Array

    def as_dict(self) -> dict[str, Any]:
        """The block of calibration.yaml and report.json."""
        pairs = ("xy", "xz", "yz")
        corrected = {"formula": "a = M raw + b, m/s2", **fields(self, "M b M_sd b_sd")}
        return {
            "corrected_from_raw": corrected,
            "raw_from_corrected": {"formula": "raw = S a + c, m/s2", **fields(self, "S c")},
            "intrinsic": {
                **fields(self, "scale scale_sd"),
                "axis_angle_deg": dict(zip(pairs, self.angle.tolist(), strict=True)),
                "axis_angle_sd_deg": dict(zip(pairs, self.angle_sd.tolist(), strict=True)),
            },
        }


def linear_numbers(sensitivity: Array, offset: Array) -> dict[str, Array]:
    """What raw = S corrected + c says, by the names of `Matrices`; S (3, 3), c (3,) m/s²."""
    inverse = np.linalg.inv(sensitivity)
    length = np.linalg.norm(sensitivity, axis=1)
    unit = sensitivity / length[:, None]
    cosines = [unit[0] @ unit[1], unit[0] @ unit[2], unit[1] @ unit[2]]
    return {
        "M": inverse,
        "b": -inverse @ offset,
        "S": sensitivity,
        "c": offset,
        "scale": length,
        "angle": np.arccos(cosines) / DEG,
        "bias_mg": offset / MG,
    }


def linear_slopes(sensitivity: Array, offset: Array) -> dict[str, Array]:
    """(size, 12) derivatives of each of `linear_numbers` by S (rows first) and c, by central
    differences."""
    at = np.concatenate([sensitivity.ravel(), offset])
    step = 1e-5
    moved = [
        [linear_numbers(one[:9].reshape(3, 3), one[9:]) for one in (at + by, at - by)]
        for by in step * np.eye(12)
    ]
    return {
        name: np.stack([(up[name] - down[name]).ravel() / (2 * step) for up, down in moved], -1)
        for name in moved[0][0]
    }


def matrices(model: Model, theta: Array, covariance: Array) -> Matrices:
    """Linear part of a correcting model (K = 1); standard deviations to first order.

    model, theta : without fixture effects; covariance : (p, p) of θ
    """
    # Only effects whose derivative is free of covariates make up the matrices.
    linear = Model(tuple(e for e in model.effects if not e.needs and e.name in LINEAR))
    slices = model.slices(Context(1))
    pick = [k for name in linear.names for k in range(slices[name].start, slices[name].stop)]
    # Without a force, and with one along each axis.
    force = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    seen = linear.predict(theta[pick], force[:, None], Context(4))
    reading, by_theta = seen.reading[:, 0], seen.d_theta[:, 0]
    sensitivity, offset = (reading[1:] - reading[0]).T, reading[0]
    gains = np.swapaxes(by_theta[1:] - by_theta[0], 0, 1).reshape(9, -1)
    slope = np.concatenate([gains, by_theta[0]])
    spread = slope @ covariance[np.ix_(pick, pick)] @ slope.T
    numbers = linear_numbers(sensitivity, offset)
    sds = {
        f"{name}_sd": np.sqrt(np.maximum(np.diag(by @ spread @ by.T), 0.0)).reshape(
            numbers[name].shape
        )
        for name, by in linear_slopes(sensitivity, offset).items()
        if name != "c"
    }
    return Matrices(**numbers, **sds)


@dataclass(frozen=True)
class Calibration:
    """A calibration apart from the data it came from.

    parameters : all, fixture included; covariance : (p, p) in their units and order
    raw_unit, raw_to_si : of the readings that it applies to
    facts : the blocks that only people read (gravity, conventions, noise, ranges, provenance)
    triads : of an array, each IMU's linear correction; the parameters then are the positions
    sha256 : of the file that it was read from, or empty
    sensor : whose it is, None where it is used for whichever
    """

    calibrator: str
    parameters: tuple[StoredParameter, ...]
    covariance: Array
    raw_unit: str
    raw_to_si: float
    gravity: float
    status: str
    reasons: tuple[str, ...] = ()
    valid: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    triads: tuple[Triad, ...] = ()
    sha256: str = ""
    sensor: Identity | None = NAMELESS

    def model(self, *, fixture: bool = False) -> tuple[Model, Array]:
        """The correcting part as effects of the catalogue, with its θ; `fixture` : also what the
        bench itself is off by.

        Raises UnreadableInput when the file names an effect that this version does not know.
        """
        skipped = () if fixture else NEVER_APPLIED
        names = dict.fromkeys(p.effect for p in self.parameters if p.stage not in skipped)
        effects = {name: effect for name in names if (effect := known(name)) is not None}
        unknown = [name for name in names if name not in effects]
        if unknown:
            raise UnreadableInput(
                f"the calibration uses unknown effects: {', '.join(unknown)}",
                remedy="load the file that defines them with --effects, or update imucal",
            )
        model = Model(tuple(effects.values()))
        return model, np.array([self.parameters[k].value for k in self.places(model)])

    def places(self, model: Model) -> Index:
        """(p,) of the θ of `model`, in its order, among the file's parameters."""
        every = [p.effect for p in self.parameters]
        at = [k for e in model.effects for k, name in enumerate(every) if name == e.name]
        return np.array(at, np.intp)

    def covariance_of(self, model: Model) -> Array:
        """(p, p) of the θ of `model`, in its order, whatever the order of the file's parameters."""
        at = self.places(model)
        return np.asarray(self.covariance[np.ix_(at, at)])

    def force_covariance(self, force: Array, context: Context) -> Array:
        """(n, 3, 3) (m/s²)² of corrected forces (n, 3) m/s², of the calibration alone."""
        model, theta = self.model()
        slope, _ = force_slopes(model, theta, force, context)
        own = self.covariance_of(model)
        return np.asarray(np.einsum("nip,pq,njq->nij", slope, own, slope))

    def find_error(self, units: Mapping[str, float], of: str) -> float:
        """The first error of "raw" or "final" readings in one of the units, held out or fitted, in
        that of their factors; infinite where none is known."""
        for error in self.facts.get("errors", ()):
            if factor := units.get(error["unit"]):
                for value in (error["held_out"].get(of), error.get(of)):
                    if value is not None and math.isfinite(value):
                        return factor * float(value)
        return math.inf

    def assume(self, covariate: str) -> float:
        """Where an effect acts whose covariate was not recorded: what time has brought about stays,
        so times stand at the end of what was calibrated, all else in the middle of its range.

        Raises KeyError when not even the range is known.
        """
        low, high = self.valid[covariate]
        return high if covariate in PASSING else 0.5 * (low + high)

    def context(self, count: int) -> Context:
        """Of `count` readings of which no covariate was recorded."""
        return Context(count, {n: np.full(count, self.assume(n)) for n in self.valid})

    def apply(self, reading: Array, context: Context | None = None, *, unit: str = "") -> Array:
        """Correct readings (..., 3), one or many, to specific force of the same shape and unit in
        the tool's frame; a DataFrame's three columns too.

        unit : of both; by default that of the readings that were calibrated (`sensor.unit`), as
        they stood in their file, or m/s² where it is not known; then sizes that cannot be gravity
        are a UsageError
        context : covariates of each that the effects need ("temperature"); raises UsageError for
        other shapes, UnreadableInput when a covariate is missing, NotConverged when a reading lies
        outside the calibration's range
        """
        values = np.asarray(reading, np.float64)
        if not values.ndim or values.shape[-1] != 3:
            raise UsageError(
                f"readings of shape {values.shape} are not x, y, z",
                remedy="give three numbers, or an array (n, 3)",
            )
        size, zero = self._unit(unit)
        flat = size * (values.reshape(-1, 3) - zero)
        if not unit:
            self._demand_gravity(flat)
        model, theta = self.model()
        known = context or Context(len(flat))
        for effect in model.effects:
            if absent := [name for name in effect.needs if name not in known]:
                raise lacking(effect.name, absent)
        force = model.correct(theta, flat[:, None], known)[:, 0]
        return np.asarray(force / size).reshape(values.shape)

    def _demand_gravity(self, reading: Array) -> None:
        """Raise UsageError for readings (n, 3) m/s² whose usual size is another unit's."""
        sizes = np.linalg.norm(reading, axis=1)
        usual = float(np.median(sizes)) / self.gravity if sizes.size else 1.0
        if not 1.0 / _ANOTHER_UNIT < usual < _ANOTHER_UNIT:
            own = (self.sensor or NAMELESS).unit or "m/s2"
            raise UsageError(
                f"in {own}, in which this was calibrated, the usual size would be {usual:.3g} g",
                remedy='say which unit it is: unit="m/s2"',
            )

    def _unit(self, unit: str) -> tuple[Array, Array]:
        """m/s² in one of a unit, and what is taken off readings in it, (1,) or one an axis."""
        own, plain = self.sensor or NAMELESS, ACCELERATION_UNITS.get(unit or "m/s2")
        if own.to_m_per_s2 and unit in ("", own.unit):
            return np.array(own.to_m_per_s2), np.array(own.zero or (0.0,))
        if plain is None:
            known = ", ".join(ACCELERATION_UNITS)
            raise UsageError(f"unknown unit '{unit}'", remedy=f"use one of: {known}")
        return np.array([plain]), np.zeros(1)

    def matrices(self) -> Matrices:
        """M, b and S, c of the linear part, with intrinsic scales and angles."""
        model, theta = self.model()
        return matrices(model, theta, self.covariance_of(model))


def stored_parameters(fit: Fit) -> tuple[StoredParameter, ...]:
    """The parameters of a fit, without those of records that were set aside."""
    context = fit.observations.context
    return tuple(
        StoredParameter(
            p.name, effect.name, effect.stage, float(fit.theta[k]), float(fit.sd[k]), p.unit
        )
        for effect in fit.model.effects
        if not is_record_error(effect.name)
        for k, p in enumerate(
            effect.parameters(context), fit.model.slices(context)[effect.name].start
        )
    )


def stored_covariance(fit: Fit) -> Array:
    """(p, p) of `stored_parameters`."""
    slices = fit.model.slices(fit.observations.context)
    kept = [at for name, at in slices.items() if not is_record_error(name)]
    keep = [k for at in kept for k in range(at.start, at.stop)]
    return np.asarray(fit.covariance[np.ix_(keep, keep)])


def from_fit(
    fit: Fit,
    calibrator: str,
    *,
    raw_unit: str,
    raw_to_si: float,
    gravity: float,
    status: str,
    reasons: tuple[str, ...],
    facts: Mapping[str, Any],
    sensor: Identity = NAMELESS,
) -> Calibration:
    """The calibration of a fit; records that were set aside are no part of it."""
    context = fit.observations.context
    needed = {name for effect in select_correctable(fit.model).effects for name in effect.needs}
    valid = {
        name: (float(context[name].min()), float(context[name].max()))
        for name in sorted(needed | ({"temperature"} & set(context.covariates)))
    }
    return Calibration(
        calibrator=calibrator,
        parameters=stored_parameters(fit),
        covariance=stored_covariance(fit),
        raw_unit=raw_unit,
        raw_to_si=raw_to_si,
        gravity=gravity,
        status=status,
        reasons=reasons,
        valid=valid,
        facts=facts,
        sensor=sensor,
    )
