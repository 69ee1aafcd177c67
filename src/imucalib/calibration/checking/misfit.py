"""Misfits of a later recording, linearised once, with the parts of their covariance.

    misfit = reading - predicted = J (θ - θ̂) + N η + noise + C (change)

With the calibration's full covariance Cθ the misfits of an unchanged sensor have the covariance
V = s² W + J Cθ Jᵀ + Σ sd² N Nᵀ + Σ session² C Cᵀ. Each part's size was estimated with degrees of
freedom of its own; the calibration's covariance goes with the noise of its readings. Directions
that are not known (the attitude of a rest) are projected out as in `core.balance`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from imucalib.arrays import Array, Index
from imucalib.calibration.calibration import Calibration, where_assumed
from imucalib.calibration.checking.noise import FAMILIES, CheckNoise, Scatter
from imucalib.calibration.triads import Triad, gain_and_bias_slope
from imucalib.core.balance import Balanced, balance
from imucalib.core.effect import Truth
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import tangents
from imucalib.effects import named
from imucalib.errors import UnreadableInput
from imucalib.posterior.closed_loop.changes import ChangeQuestion, CovariancePart, Suspect
from imucalib.units import DEG, MG

#: Of an effect's parameter in the unit of its kind of change.
_PER_UNIT = {"bias": 1.0, "scale": 1e-3, "mounting": 1.0}
#: What the noise of readings is called among the parts of a covariance.
READING = "reading"
#: What a rest is called that does not belong to the others.
BAD_REST = "one bad rest"


@dataclass(frozen=True)
class Misfits:
    """N misfits of n rests or positions.

    value : (N,) m/s²; noise : `READING` and the components of what was set
    session : by the kind of change, what a power-up brings, in its unit
    jacobian : (N, p) by all of the calibration's parameters, zero for those that do not act here
    parameters : (p, p) their covariance; changes : per kind, (N, 3) m/s² per unit
    owner : (N,) row of each; label : (n,) of the rows; force : (n, 3) m/s² corrected
    directed : whether directions are known
    """

    value: Array
    noise: Mapping[str, CovariancePart]
    session: Mapping[str, Scatter]
    jacobian: Array
    parameters: Array
    changes: Mapping[str, Array]
    owner: Index
    label: tuple[str, ...]
    force: Array
    directed: bool

    @property
    def n(self) -> int:
        return len(self.label)

    @cached_property
    def parts(self) -> tuple[CovariancePart, ...]:
        """Readings with the calibration's own error, settings, power-up."""
        carried = self.jacobian @ self.parameters @ self.jacobian.T
        reading = self.noise[READING]
        columns = {k: s.sd * self.changes[k] for k, s in self.session.items() if k in self.changes}
        return (
            replace(reading, covariance=reading.covariance + carried),
            *(part for name, part in self.noise.items() if name != READING),
            *(CovariancePart(c @ c.T, self.session[kind].dof) for kind, c in columns.items()),
        )

    @cached_property
    def covariance(self) -> Array:
        """(N, N) of an unchanged sensor."""
        return np.asarray(np.sum([part.covariance for part in self.parts], axis=0))

    def take(self, rows: Index) -> Misfits:
        """Some of the rows, in order."""
        kept = np.flatnonzero(np.isin(self.owner, rows))
        both = np.ix_(kept, kept)
        return replace(
            self,
            value=self.value[kept],
            noise={n: CovariancePart(p.covariance[both], p.dof) for n, p in self.noise.items()},
            jacobian=self.jacobian[kept],
            changes={name: c[kept] for name, c in self.changes.items()},
            owner=np.searchsorted(rows, self.owner[kept]),
            label=tuple(self.label[r] for r in rows),
            force=self.force[rows],
        )

    def join(self, other: Misfits) -> Misfits:
        """Both, of one power-up: the calibration's errors and the session's are common to all."""
        nothing = [
            CovariancePart(np.zeros((m.value.size, m.value.size)), 0.0) for m in (self, other)
        ]
        noise = {}
        for name in {**self.noise, **other.noise}:
            one, two = self.noise.get(name, nothing[0]), other.noise.get(name, nothing[1])
            noise[name] = CovariancePart(
                block_diag(one.covariance, two.covariance), one.dof or two.dof
            )
        return replace(
            self,
            value=np.concatenate([self.value, other.value]),
            noise=noise,
            jacobian=np.concatenate([self.jacobian, other.jacobian]),
            changes={n: np.concatenate([c, other.changes[n]]) for n, c in self.changes.items()},
            owner=np.concatenate([self.owner, other.owner + self.n]),
            label=(*self.label, *other.label),
            force=np.concatenate([self.force, other.force]),
        )


def misfits_of(
    calibration: Calibration, observations: Observations, noise: CheckNoise, *, fixture: bool = True
) -> tuple[Misfits, tuple[str, ...]]:
    """Misfits of a recording, and what there is to say of how they were made.

    observations : sigma is 1 m/s² where a row has the noise of a reading, more where it is noisier
    fixture : whether known directions were set on the calibration's own bench
    Raises UnreadableInput for a covariate of which not even the calibrated range is known.
    """
    directed, notes = observations.reference.directed, []
    model, theta = calibration.model(fixture=directed and fixture)
    if len(model.parameters(observations.context)) != theta.size:
        # Effects of the bench whose parameters belong to the rows of the calibration.
        gone = ", ".join(e.name for e in model.effects if e.stage == "fixture")
        notes.append(f"{gone}: of the bench on the calibration's day, not expected now")
        model, theta = calibration.model()
    observations, more = _complete(calibration, model, observations)
    corrected = model.correct(theta, observations.reading, observations.context)
    eta = observations.reference.start(corrected)
    at = balance(model, theta, eta, observations)
    jacobian = np.zeros((at.unit.size, len(calibration.parameters)))
    jacobian[:, calibration.places(model)] = at.jacobian * at.unit[:, None]
    force = model.predict(theta, observations.reference.truth(eta), observations.context).force
    changes = _changes(force, observations, at)
    return Misfits(
        value=at.residual * at.unit,
        noise={
            READING: CovariancePart(_readings(at, noise, changes["bias"]), noise.reading.dof),
            **_settings(at, noise),
        },
        session=noise.session,
        jacobian=jacobian,
        parameters=calibration.covariance,
        changes=changes,
        owner=at.owner,
        label=observations.label,
        force=corrected[:, 0],
        directed=directed,
    ), (*notes, *more)


def _complete(
    calibration: Calibration, model: Model, observations: Observations
) -> tuple[Observations, tuple[str, ...]]:
    """With covariates that were not recorded where a later reading finds them; times are the
    calibration's own and mean nothing later."""
    context, notes = observations.context, []
    needed = {name for effect in model.effects for name in effect.needs}
    held = {"order", "time"} & needed | (needed - set(context.covariates))
    found = dict(context.covariates)
    for name in sorted(held):
        if name not in calibration.valid:
            raise UnreadableInput(
                f"the calibration's effects need {name}, which the recording lacks",
                remedy="record it, or calibrate without those effects (--without)",
            )
        value = calibration.assume(name)
        found[name] = np.full(context.n, value)
        notes.append(f"{name} is taken as {where_assumed(name)} of the calibration, {value:.3g}")
    return replace(observations, context=replace(context, covariates=found)), tuple(notes)


def _readings(at: Balanced, noise: CheckNoise, bias: Array) -> Array:
    """(N, N) of the readings' noise, rows in their order. bias : (N, 3) m/s² per mg"""
    square = noise.reading.sd**2
    alone = np.diag(square * at.unit**2)
    if not noise.share:
        return np.asarray(alone)
    apart = np.abs(np.subtract.outer(at.owner, at.owner))
    together = square * (bias @ bias.T) * np.exp(-apart / noise.memory) / MG**2
    return np.asarray((1.0 - noise.share) * alone + noise.share * together)


def _settings(at: Balanced, noise: CheckNoise) -> dict[str, CovariancePart]:
    """What the errors of settings do, component by component."""
    found = {}
    for name, matrix in zip(at.component, at.settings, strict=True):
        scatter = noise.setting.get(name)
        if scatter is not None and scatter.sd > 0.0:
            scaled = scatter.sd * matrix * at.unit[:, None]
            found[name] = CovariancePart(scaled @ scaled.T, scatter.dof)
    return found


def _changes(force: Array, observations: Observations, at: Balanced) -> dict[str, Array]:
    """Columns of every kind of change that these readings could show."""
    found = {}
    for name in FAMILIES:
        if name != "mounting" or observations.reference.directed:
            effect = named(name)
            start = np.zeros(len(effect.parameters(observations.context)))
            slope = effect.act(start, Truth(force), observations.context).d_theta
            found[name] = at.columns(slope * _PER_UNIT[name]) * at.unit[:, None]
    return found


def change_question(
    misfits: Misfits, matters: Mapping[str, float], among: int = 1
) -> ChangeQuestion:
    """What changed: a kind of change, one bad rest, more noise.

    matters : kind of change -> the size in its unit that matters
    among : sensors that share the prior odds of a change
    """
    kinds = [Suspect(name, (matters[name] * c,)) for name, c in misfits.changes.items()]
    own = matters["bias"] * MG * np.eye(misfits.value.size)
    rests = tuple(own[:, misfits.owner == row] for row in range(misfits.n))
    none = np.zeros((misfits.value.size, 0))
    suspects = (*kinds, Suspect(BAD_REST, rests, "loose"))
    return ChangeQuestion(misfits.value, misfits.parts, suspects, none, among)


def triad_misfits(
    calibration: Calibration, triad: Triad, reading: Array, noise: CheckNoise, more: Array
) -> Misfits:
    """Misfits of one IMU. reading : (n, 3) m/s² in package axes, one a rest; more : (n,) (m/s²)²,
    variance of a rest beyond the array's usual one.

    reading = gain · force + bias in board axes; what its direction is, is not known.
    """
    n = len(reading)
    force = triad.force(reading)
    direction = force / np.linalg.norm(force, axis=1, keepdims=True)
    truth = calibration.gravity * direction
    across = triad.gain @ tangents(direction)
    keep = np.cross(across[..., 0], across[..., 1])
    keep = keep / np.linalg.norm(keep, axis=1, keepdims=True)
    away = (reading - triad.reading(truth)) @ triad.rotation.T
    return Misfits(
        value=np.einsum("ni,ni->n", keep, away),
        noise={READING: CovariancePart(np.diag(noise.reading.sd**2 + more), noise.reading.dof)},
        session=noise.session,
        jacobian=np.einsum("ni,nip->np", keep, gain_and_bias_slope(truth)),
        parameters=triad.covariance,
        changes={"bias": MG * keep, "scale": 1e-3 * keep * truth},
        owner=np.arange(n, dtype=np.intp),
        label=tuple(f"rest {k + 1}" for k in range(n)),
        force=force,
        directed=False,
    )


@dataclass(frozen=True)
class GyroRest:
    """A gyroscope at rest. bias : (3,) deg/s that it reads beyond its calibrated bias; sd : (3,)
    by the scatter between rests, the calibration's rests included; dof : of these"""

    bias: Array
    sd: Array
    dof: int

    def chance_beyond(self, limit: float) -> float:
        """Probability that any axis moved by more than a limit (deg/s)."""
        from scipy.special import stdtr

        high, low = ((sign * self.bias - limit) / self.sd for sign in (1.0, -1.0))
        within = 1.0 - stdtr(self.dof, high) - stdtr(self.dof, low)
        return float(1.0 - np.prod(np.maximum(within, 0.0)))


def gyro_rest(triad: Triad, rate: Array, rests: Mapping[str, float]) -> GyroRest | None:
    """rate : (n, 3) rad/s in package axes, one a rest; rests : of the calibration, its block.

    None where fewer than three rests have a rate: their scatter is the only noise that counts.
    """
    known = rate[np.isfinite(rate).all(axis=1)]
    if len(known) < 3:
        return None
    moved = triad.rate(known) / DEG
    before = float(rests.get("count") or len(known))
    sd = moved.std(axis=0, ddof=1) * np.sqrt(1.0 / len(known) + 1.0 / before)
    return GyroRest(moved.mean(axis=0), np.maximum(sd, 1e-12), len(known) - 1)
