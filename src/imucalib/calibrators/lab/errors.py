"""Errors of a lab calibration on data that it did not fit, as a drilling engineer reads them; the
noise of readings, settings and sessions, and the floor that it sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.outcome import ErrorSummary, HeldOutError
from imucalib.calibrators.sessions import (
    BetweenSessions,
    NextPowerUpFacts,
    ScatterFacts,
    estimate_scatter,
)
from imucalib.core.angle_conventions import Conventions
from imucalib.core.balance import whitener
from imucalib.core.fit import Fit
from imucalib.core.observations import BIAS, MOUNTING, Observations, session_of
from imucalib.core.references import angles_of
from imucalib.errors import NotConverged
from imucalib.estimators.corrected import OBJECTIVES, fit_corrected
from imucalib.estimators.power_ups import Parts
from imucalib.estimators.variance import INSTEAD
from imucalib.posterior.held_out import (
    Fold,
    Predictions,
    errors,
    leave_groups_out,
    predict_fitted,
    raw_errors,
)
from imucalib.units import DEG, MG

#: Below this cosine of the inclination (about 3 degrees from vertical) tool-face has no meaning.
_LEAST_COSINE = 0.05
#: Pairs of rows in one attitude from which on they say what the noise is; 1 / the MAD of a normal.
_REPEATS, _MAD = 6, 1.4826
#: Share of what neighbours share below which a noise is where its estimate ended.
_VANISHED = 1.05 / INSTEAD
#: What sessions change: the effect whose parameters carry it, and the unit that people read.
_CARRIED = {BIAS: ("bias", "mg", MG), MOUNTING: ("mounting", "deg", DEG)}


@dataclass(frozen=True)
class AttitudeErrors:
    """Corrected against expected, for each position.

    inclination, tool_face : (n,) deg in the table's sense, tool_face NaN near the vertical
    norm : (n,) mg
    """

    inclination: Array
    tool_face: Array
    norm: Array

    def take(self, rows: Index) -> AttitudeErrors:
        return AttitudeErrors(self.inclination[rows], self.tool_face[rows], self.norm[rows])


def attitude_errors(held: Predictions, conventions: Conventions) -> AttitudeErrors:
    """Angles are compared on vectors, unfolded, so that 91 degrees is not read as 89; sizes with
    what is expected, which is not gravity where a swing of the bench is known."""
    corrected, expected = held.corrected[:, 0], held.expected[:, 0]
    i, t = angles_of(corrected)
    i0, t0 = angles_of(expected)
    turn = np.mod(t - t0 + np.pi, 2.0 * np.pi) - np.pi
    folded = (np.abs(turn) > np.pi / 2.0) & (np.abs(np.sin(i0)) > 0.7)
    i = np.where(folded, np.sign(i) * np.pi - i, i)
    turn = np.where(folded, np.mod(turn, 2.0 * np.pi) - np.pi, turn)
    tool_face = np.where(np.abs(np.cos(i0)) > _LEAST_COSINE, turn / DEG, np.nan)
    norm = (np.linalg.norm(corrected, axis=1) - np.linalg.norm(expected, axis=1)) / MG
    senses = conventions.senses
    return AttitudeErrors(senses[0] * (i - i0) / DEG, senses[1] * tool_face, norm)


def worst(values: Array) -> float:
    """Largest absolute value, NaN left out; 0 for nothing."""
    return float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))


def rms(values: Array) -> float:
    """Root mean square, NaN left out; 0 for nothing."""
    used = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(used**2))) if used.size else 0.0


@dataclass(frozen=True)
class Split:
    """A held-out part: its name, its rows of the whole table, and the errors there."""

    name: str
    rows: Index
    base: Predictions
    final: Predictions


def leave_each_out(
    base: Fit,
    final: Fit,
    whole: Observations,
    used: Index,
    objective: str,
    chosen_anew: Mapping[str, tuple[Predictions, Predictions]],
) -> tuple[Split, ...]:
    """Each fitted row in turn; those splits for which everything was chosen anew; and the rows that
    were kept apart when there are any."""
    if objective not in OBJECTIVES:
        pairs = {"leave one out": (leave_groups_out(base), leave_groups_out(final)), **chosen_anew}
    else:
        alone = _leave_out_by_refits(final, objective)
        pairs = {"leave one out": (alone, alone)} if alone else {}
    found = [Split(name, used, *pair) for name, pair in pairs.items()]
    rest = np.setdiff1d(np.arange(whole.n), used)
    if rest.size:
        test = whole.take(rest)
        tested = [errors(f, f.theta, test) for f in (base, final)]
        found.append(Split("test set", rest, *tested))
    return tuple(found)


def session_folds(fit: Fit) -> tuple[Fold, ...]:
    """Each session left out by itself."""
    session = session_of(fit.observations)
    if session is None:
        return ()
    each = (session == k for k in np.unique(session))
    return tuple(Fold(np.flatnonzero(own), np.flatnonzero(~own)) for own in each)


def _leave_out_by_refits(fit: Fit, objective: str) -> Predictions | None:
    """Leave one out by complete refits, for objectives that are not a likelihood.

    None when a position is indispensable: without it the objective has no minimum.
    """
    data, parts = fit.observations, []
    for row in np.arange(data.n)[:, None]:
        try:
            theta = fit_corrected(fit.model, data.without(row), objective, fit.theta).theta
        except NotConverged:
            return None
        parts.append(errors(fit, theta, data.take(row)))
    return Predictions(
        np.concatenate([part.corrected for part in parts]),
        np.concatenate([part.expected for part in parts]),
        np.concatenate([part.error for part in parts]),
    )


def error_summary(
    base: Fit, final: Fit, data: Observations, splits: tuple[Split, ...], sigma: float | None
) -> ErrorSummary:
    """The one metric of the loop: length of the vector error, or error of the norm, rms in mg.

    Held out are the rows of the test set when there is one, else folds that took no part in the
    choice, else each row in turn; NaN where none exists.

    sigma : declared noise of a reading, m/s², or None
    """
    apart = [np.nan] * 2
    if splits:
        apart = [held.rms() / MG for held in (splits[-1].base, splits[-1].final)]
    raw = raw_errors(replace(base, observations=data)).rms() / MG
    return ErrorSummary(
        metric="vector error, rms" if data.reference.directed else "error of |a|, rms",
        unit="mg",
        raw=raw,
        base=predict_fitted(base).rms() / MG,
        final=predict_fitted(final).rms() / MG,
        floor=noise_floor(data, sigma) / MG,
        held_out=HeldOutError(raw, *apart),
    )


def noise_floor(data: Observations, sigma: float | None) -> float:
    """rms of the metric that noise alone would leave, m/s²: as declared, else as rows that repeat
    an attitude within a session differ; NaN where nothing measures it. A fit's own residual holds
    what it lacks, and rows of two sessions what changes between these.

    Of repeats by the median of their differences, which a wrong row does not move.
    """
    numbers = 3 if data.reference.directed else 1
    if sigma is not None:
        return float(np.sqrt(numbers)) * sigma
    if not data.reference.directed:
        return float("nan")
    meant = data.reference.truth(np.zeros(data.reference.eta_size))[:, 0]
    session = session_of(data)
    same = meant if session is None else np.column_stack([meant, session])
    _, place = np.unique(np.round(same, 6), axis=0, return_inverse=True)
    order = np.argsort(place, kind="stable")
    again = np.diff(place[order]) == 0
    apart = np.diff(data.reading[order, 0], axis=0)[again]
    if len(apart) < _REPEATS:
        return float("nan")
    each = _MAD * np.median(np.abs(apart), axis=0) / np.sqrt(2.0)
    return float(np.linalg.norm(each))


def setting_noise(fit: Fit) -> dict[str, float]:
    """Standard deviations (rad) of the settings by component name."""
    return dict(zip(fit.noise.component[: fit.at.free], fit.noise.sd, strict=False))


@dataclass(frozen=True)
class ReadingNoise:
    """Of a reading, m/s²: own, shared : by itself, and with its neighbours, 0 where there is none;
    own_sd, shared_sd : of these; memory : observations after which neighbours forget"""

    own: float
    own_sd: float
    shared: float = 0.0
    shared_sd: float = 0.0
    memory: float = 0.0

    @property
    def whole(self) -> float:
        return float(np.hypot(self.own, self.shared))


def reading_noise(fit: Fit) -> ReadingNoise:
    """What neighbours share can take it whole: then it has vanished, and its size is where the
    estimate ended."""
    own, sizes = fit.noise.factor * float(np.median(fit.at.sigma)), fit.noise_sd
    walk = fit.observations.walk
    if walk is None:
        return ReadingNoise(own, own * float(sizes[0]))
    shared = fit.noise.sd[-1]
    own = 0.0 if own < _VANISHED * shared else own
    size = shared * float(sizes[-1])
    return ReadingNoise(own, own * float(sizes[0]), shared, size, walk.memory)


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
