"""After a jump of the bench, which part of the sheet stands as it was set.

A tool that slipped in its clamp and one that was seated wrongly before give the same readings: what
is constant over the sheet is the mounting's. With C the columns of the jump and C' those of the
same jump where the other part is trusted, C' = C + B M says that the base model's columns B take
the difference over, and y = B b + C u = B (b - M u) + C' u. Where no such M exists the readings
decide by themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.effects.scans import TRUSTED, trust_records
from imucalib.posterior.candidates import effect_slopes, predict_by_fit
from imucalib.posterior.odds import ABSORBED


@dataclass(frozen=True)
class JumpParts:
    """The two parts of a sheet beside a jump, either of which may stand as it was set.

    after : (n,) whether an observation comes after the jump: those whose readings it moves where
        the part before it stands
    taken_over : (p, w) M, what the base model's p parameters take over of each of the jump's w, in
        the parameters' units: b - M u is b once the part after the jump is the one that stands
    """

    after: Flags
    taken_over: Array


def split_at_jump(fit: Fit, base: Model, effect: Effect) -> JumpParts | None:
    """The parts beside a jump of the bench; None where the readings or the user say which stands as
    it was set, or where nothing jumps.

    fit : at whose balance columns C, C' and B are compared; the user says so by the covariates
        `TRUSTED` of its context
    base : the model of the p parameters that may take over, all in the fit's
    effect : that may be a jump, and is not in the base: an effect of the fixture whose columns are
        others once the last record is the one that is trusted

    M is the least-squares solution of C' - C = B M, columns of B at unit length. It is there when
    what it leaves is within `ABSORBED` of C' - C, as sums of squares.
    """
    data, context = fit.observations, fit.observations.context
    if effect.stage != "fixture" or "record" not in context or TRUSTED[0] in context:
        return None
    last, prediction = float(context["record"].max()), predict_by_fit(fit)
    other = replace(fit, observations=replace(data, context=trust_records(context, last, last)))
    own = effect_slopes(fit, effect, prediction)
    moved = effect_slopes(other, effect, prediction) - own
    if not moved.any():
        return None
    slices = fit.model.slices(context)
    columns = np.hstack([fit.at.jacobian[:, slices[name]] for name in base.names])
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    taken_over = np.linalg.lstsq(columns / size, moved, rcond=1e-10)[0] / size[:, None]
    if np.sum((moved - columns @ taken_over) ** 2) > ABSORBED * np.sum(moved**2):
        return None
    return JumpParts(np.any(own.reshape(data.n, -1), axis=1), taken_over)
