"""What a bench's sessions share, as the products of a fit have it."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.sessions import (
    BetweenSessions,
    NextPowerUpFacts,
    ScatterFacts,
    estimate_scatter,
)
from imucalib.core.balance import whitener
from imucalib.core.fit import Fit
from imucalib.core.observations import BIAS, MOUNTING, session_of
from imucalib.estimators.power_ups import Parts
from imucalib.posterior.held_out import Fold
from imucalib.units import DEG, MG

#: What sessions change: the effect whose parameters carry it, and the unit that people read.
_CARRIED = {BIAS: ("bias", "mg", MG), MOUNTING: ("mounting", "deg", DEG)}


def sessions_of(fit: Fit, names: tuple[str, ...]) -> BetweenSessions | None:
    """The sessions of a fit, or None where it has only one. names : by number"""
    session = session_of(fit.observations)
    if session is None:
        return None
    used = np.unique(session)
    scatter, parameters = list[ScatterFacts](), list[NextPowerUpFacts]()
    slices, sd = fit.model.slices(fit.observations.context), np.sqrt(np.diag(fit.covariance))
    for k, noise in enumerate(fit.observations.of_sessions, start=fit.at.free):
        effect, unit, si = _CARRIED[noise.name]
        own = range(fit.theta.size)[slices.get(effect, slice(0))]
        one, after = estimate_scatter(
            noise.name,
            unit,
            _parts(fit, k, used.size).in_unit(np.eye(3) / si),
            fit.noise.sd[k] / si,
            [(fit.parameters[at].name, float(fit.theta[at]), float(sd[at])) for at in own],
        )
        scatter.append(one)
        parameters += after
    return BetweenSessions(tuple(names[k] for k in used), tuple(scatter), tuple(parameters))


def session_folds(fit: Fit) -> tuple[Fold, ...]:
    """Each session left out by itself."""
    session = session_of(fit.observations)
    if session is None:
        return ()
    each = (session == k for k in np.unique(session))
    return tuple(Fold(np.flatnonzero(own), np.flatnonzero(~own)) for own in each)


def _parts(fit: Fit, k: int, sessions: int) -> Parts:
    """Of a component, with θ integrated out: Nᵀ P N and Nᵀ P r without it in V (Henderson 1975)."""
    at, noise = fit.at, fit.noise
    ratio = (*noise.ratio[:k], 0.0, *noise.ratio[k + 1 :])
    columns = at.settings[k]
    columns = columns[:, np.any(columns, axis=0)].reshape(len(columns), 3 * sessions)
    white = whitener(at.settings, ratio)(np.column_stack([at.jacobian, columns, at.residual]))
    p = at.jacobian.shape[1]
    basis = np.linalg.qr(white[:, :p])[0]
    rest = (white[:, p:] - basis @ (basis.T @ white[:, p:])) / noise.factor
    return Parts(rest[:, :-1].T @ rest[:, :-1], rest[:, :-1].T @ rest[:, -1])
