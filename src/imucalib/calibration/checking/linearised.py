"""A later recording against its calibration: what acts on it, and its misfits.

Directions that are not known (the attitude of a rest) are projected out as in `core.balance`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.calibration import NEVER_APPLIED, Calibration, taken_at
from imucalib.calibration.checking.misfit import Misfits, Part
from imucalib.calibration.checking.noise import FAMILIES, CheckNoise
from imucalib.core.balance import Balanced, balance
from imucalib.core.context import Context
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.truth import Truth
from imucalib.effects import known, named
from imucalib.errors import UnreadableInput
from imucalib.units import MG

#: Of an effect's parameter in the unit of its kind of change.
_PER_UNIT = {"bias": 1.0, "scale": 1e-3, "mounting": 1.0}


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
    names = dict.fromkeys(p.effect for p in calibration.parameters if p.stage not in skipped)
    unknown = [name for name in names if known(name) is None]
    if unknown:
        raise UnreadableInput(
            f"the calibration uses unknown effects: {', '.join(unknown)}",
            remedy="load the file that defines them with --effects, or update imucal",
        )
    model = Model(tuple(e for name in names if (e := known(name)) is not None))
    at = calibration.places(model)
    theta = np.array([calibration.parameters[k].value for k in at])
    return Acting(model, theta, at)


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
    return Misfits(
        value=at.residual * at.unit,
        reading=Part(_readings(at, noise, changes["bias"]), noise.reading.dof),
        setting=_settings(at, noise),
        session=noise.session,
        jacobian=jacobian,
        parameters=calibration.covariance,
        changes=changes,
        owner=at.owner,
        label=observations.label,
        force=corrected[:, 0],
        directed=directed,
    ), (*notes, *more)


def _readings(at: Balanced, noise: CheckNoise, bias: Array) -> Array:
    """(N, N) of the readings' noise, rows in their order. bias : (N, 3) m/s² per mg"""
    square = noise.reading.sd**2
    alone = np.diag(square * at.unit**2)
    if noise.shared is None:
        return np.asarray(alone)
    apart = np.abs(np.subtract.outer(at.owner, at.owner))
    together = (bias @ bias.T) * np.exp(-apart / noise.shared.memory) / MG**2
    share = noise.shared.share
    return np.asarray((1.0 - share) * alone + share * square * together)


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
        value = calibration.unrecorded(name)
        found[name] = np.full(context.n, value)
        notes.append(f"{name} is taken as {taken_at(name)} of the calibration, {value:.3g}")
    return replace(observations, context=replace(context, covariates=found)), tuple(notes)


def _settings(at: Balanced, noise: CheckNoise) -> dict[str, Part]:
    """What the errors of settings do, component by component."""
    found = {}
    for name, matrix in zip(at.component, at.settings, strict=True):
        scatter = noise.setting.get(name)
        if scatter is not None and scatter.sd > 0.0:
            scaled = scatter.sd * matrix * at.unit[:, None]
            found[name] = Part(scaled @ scaled.T, scatter.dof)
    return found


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
