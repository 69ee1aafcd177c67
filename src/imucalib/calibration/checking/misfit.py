"""A later recording against its calibration, linearised once: misfits, their covariance, and what
each kind of change would do to them.

    misfit = reading - foretold = J (θ - θ̂) + N η + noise + C (change)

With the calibration's full covariance Cθ the misfits of an unchanged sensor have the covariance
V = s² W + J Cθ Jᵀ + Σ sd² N Nᵀ + session² B Bᵀ. Directions that are not known (the attitude of a
rest) are projected out as in `core.balance`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.calibration import NEVER_APPLIED, Calibration
from imucalib.calibration.checking.noise import FAMILIES, CheckNoise
from imucalib.core.balance import Balanced, balance
from imucalib.core.context import Context
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.truth import Truth
from imucalib.effects import known, named
from imucalib.errors import UnreadableInput

#: Of an effect's parameter in the unit of its family.
_PER_UNIT = {"bias": 1.0, "scale": 1e-3, "mounting": 1.0}


@dataclass(frozen=True)
class Misfits:
    """N misfits of n rests or positions.

    value : (N,) m/s²; covariance : (N, N), of an unchanged sensor; jacobian : (N, p) by all of the
    calibration's parameters, zero for those that do not act here; parameters : (p, p) covariance
    noise : (N, N) the part of the covariance that is not the calibration's; session : per family,
    the variance of a power-up in it, unit²
    changes : per family, (N, 3) m/s² per unit; owner : (N,) row of each
    dof : degrees of freedom of the covariance's scale (Satterthwaite)
    label : of the rows; force : (n, 3) m/s² corrected; angles : whether directions are known
    """

    value: Array
    covariance: Array
    jacobian: Array
    parameters: Array
    noise: Array
    session: Mapping[str, float]
    changes: Mapping[str, Array]
    owner: Index
    dof: float
    label: tuple[str, ...]
    force: Array
    directed: bool

    @property
    def n(self) -> int:
        return len(self.label)

    def white(self, columns: Array) -> Array:
        """L⁻¹ columns, V = L Lᵀ."""
        from scipy.linalg import solve_triangular

        lower = np.linalg.cholesky(self.covariance)
        return np.asarray(solve_triangular(lower, columns, lower=True, check_finite=False))

    def without(self, row: int) -> Misfits:
        """All rows but one."""
        left = np.flatnonzero(self.owner != row)
        owner = self.owner[left]
        return replace(
            self,
            value=self.value[left],
            covariance=self.covariance[np.ix_(left, left)],
            jacobian=self.jacobian[left],
            noise=self.noise[np.ix_(left, left)],
            changes={name: c[left] for name, c in self.changes.items()},
            owner=owner - (owner > row),
            label=(*self.label[:row], *self.label[row + 1 :]),
            force=np.delete(self.force, row, axis=0),
        )


@dataclass(frozen=True)
class Acting:
    """The part of a calibration that acts on a recording. at : of its θ among all parameters"""

    model: Model
    theta: Array
    at: Index


def acting(calibration: Calibration, *, fixture: bool) -> Acting:
    """What corrects a reading; `fixture` : also what the bench itself is off by.

    Raises UnreadableInput where the file names effects that are not known.
    """
    skipped = () if fixture else NEVER_APPLIED
    own = [k for k, p in enumerate(calibration.parameters) if p.stage not in skipped]
    names = dict.fromkeys(calibration.parameters[k].effect for k in own)
    unknown = [name for name in names if known(name) is None]
    if unknown:
        raise UnreadableInput(
            f"the calibration uses unknown effects: {', '.join(unknown)}",
            remedy="load the file that defines them with --effects, or update imucal",
        )
    model = Model(tuple(e for name in names if (e := known(name)) is not None))
    order = [k for e in model.effects for k in own if calibration.parameters[k].effect == e.name]
    theta = np.array([calibration.parameters[k].value for k in order])
    return Acting(model, theta, np.array(order, np.intp))


def misfits_of(
    calibration: Calibration, observations: Observations, noise: CheckNoise, *, fixture: bool = True
) -> tuple[Misfits, tuple[str, ...]]:
    """Misfits of a recording, and what there is to say of how they were made.

    observations : sigma is 1 m/s² where a row has the noise of a reading, more where it is noisier
    fixture : whether known directions were set on the calibration's own bench
    Raises UnreadableInput for a covariate of which not even the calibrated range is known.
    """
    directed = observations.reference.directed
    part, notes = _fitting(acting(calibration, fixture=directed and fixture), observations.context)
    observations, more = _complete(calibration, part.model, observations)
    corrected = part.model.correct(part.theta, observations.reading, observations.context)
    eta = observations.reference.start(corrected)
    at = balance(part.model, part.theta, eta, observations)
    jacobian = np.zeros((at.unit.size, len(calibration.parameters)))
    jacobian[:, part.at] = at.jacobian * at.unit[:, None]
    changes = _changes(part, eta, observations, at)
    carried = jacobian @ calibration.covariance @ jacobian.T
    noisy, dof = _noise_covariance(at, noise, changes, carried)
    return Misfits(
        value=at.residual * at.unit,
        covariance=noisy + carried,
        jacobian=jacobian,
        parameters=calibration.covariance,
        noise=noisy,
        session={name: noise.session[name].sd ** 2 for name in noise.session if name in changes},
        changes=changes,
        owner=at.owner,
        dof=dof,
        label=observations.label,
        force=corrected[:, 0],
        directed=directed,
    ), (*notes, *more)


def _fitting(part: Acting, context: Context) -> tuple[Acting, tuple[str, ...]]:
    """Without effects of the bench whose parameters belong to the rows of the calibration."""
    size = sum(len(e.parameters(context)) for e in part.model.effects)
    if size == part.theta.size:
        return part, ()
    kept = Model(tuple(e for e in part.model.effects if e.stage != "fixture"))
    at = part.theta.size - sum(len(e.parameters(context)) for e in kept.effects)
    gone = ", ".join(e.name for e in part.model.effects if e.stage == "fixture")
    note = f"{gone}: of the bench on the calibration's day, not expected now"
    return Acting(kept, part.theta[at:], part.at[at:]), (note,)


def _complete(
    calibration: Calibration, model: Model, observations: Observations
) -> tuple[Observations, tuple[str, ...]]:
    """With covariates that were not recorded in the middle of what was calibrated; times are the
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
        middle = 0.5 * sum(calibration.valid[name])
        found[name] = np.full(context.n, middle)
        notes.append(f"{name} is taken as in the middle of the calibration, {middle:.3g}")
    return replace(observations, context=replace(context, covariates=found)), tuple(notes)


def _noise_covariance(
    at: Balanced, noise: CheckNoise, changes: Mapping[str, Array], carried: Array
) -> tuple[Array, float]:
    """(N, N), what rests or positions scatter by, and the degrees of freedom of the whole scale.

    changes : per family (N, 3), m/s² per unit; carried : (N, N) of the calibration, which was
    estimated with the noise of its readings. Each part counts by its share of the misfits' variance:
    ν = 1 / Σ share² / ν_part (Satterthwaite 1946, Biometrics Bulletin 2, 110-114).
    """
    parts = [(np.diag((noise.reading.sd * at.unit) ** 2), noise.reading.dof)]
    for name, matrix in zip(at.component, at.settings, strict=True):
        scatter = noise.setting.get(name)
        if scatter is not None:
            scaled = scatter.sd * matrix * at.unit[:, None]
            parts.append((scaled @ scaled.T, scatter.dof))
    for name, scatter in noise.session.items():
        if name in changes and scatter.sd > 0.0:
            columns = scatter.sd * changes[name]
            parts.append((columns @ columns.T, scatter.dof))
    noisy = np.sum([part for part, _ in parts], axis=0)
    inverse = np.linalg.inv(noisy + carried)
    share = np.array([np.sum(inverse * part) for part, _ in parts])
    share[0] += np.sum(inverse * carried)
    dof = 1.0 / np.sum((share / share.sum()) ** 2 / np.array([d for _, d in parts]))
    return np.asarray(noisy), float(dof)


def _changes(
    part: Acting, eta: Array, observations: Observations, at: Balanced
) -> dict[str, Array]:
    """Columns of every kind of change that these readings could show."""
    context = observations.context
    truth = observations.reference.truth(eta)
    force = part.model.predict(part.theta, truth, context).force
    found = {}
    for name in FAMILIES:
        if name == "mounting" and not observations.reference.directed:
            continue
        effect = named(name)
        start = np.zeros(len(effect.parameters(context)))
        slope = effect.act(start, Truth(force), context).d_theta * _PER_UNIT[name]
        found[name] = at.columns(slope) * at.unit[:, None]
    return found
