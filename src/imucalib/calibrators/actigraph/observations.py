"""From posture runs to observations: noise, covariates, held-out blocks of time.

Weak coverage: what the postures do not determine stays at its nominal value, and is said so.

Data sheets and practice know each parameter to its typical size. That is the prior of a fit whose
data leave something open: what gravity has shown moves, the rest keeps the prior's uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.population import UNLIKELY, Population
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.prior import Prior, independent
from imucalib.core.references import KnownNorm
from imucalib.effects.table import covariates_before
from imucalib.effects.thermal import RATE
from imucalib.errors import NotConverged
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.estimators.variance import kind_chance
from imucalib.rests.runs import PostureRuns, Scan
from imucalib.rests.thermal import REMEMBERED, ThermalHistory, remember
from imucalib.units import MG

NINE = ("bias", "scale", "non_orthogonality")
#: A combination that is known worse than this share of its typical size is weakly determined: what
#: data sheets say of it then counts for more than a tenth of what is known.
_WEAK = 1.0 / 3.0
#: m/s², runs at rest scatter by no more: what is beyond is something that the model lacks.
_SCATTER = 5.0 * MG
#: With fewer postures a parameter than this, their scatter has a prior too: 1 mg.
_ENOUGH = 3
_DAY = 86400.0
_LEAST_WARMTH = 1.0  # °C: less variation than this cannot show what temperature does
_HEAVY = 4.0  # standard deviations beyond which a run counts less
_LARGEST = 1.0 / 3.0  # share of the runs that a held-out block of time has at most
_MEDIAN_SQUARE = 0.4549  # of a standard normal number


def base_fit(model: Model, data: Observations, runs: PostureRuns) -> tuple[Fit, int]:
    """Least squares where many postures determine everything, else the maximum a posteriori.

    Returns the fit and how many runs count less.
    """
    parameters = model.parameters(data.context)
    if data.n > _ENOUGH * len(parameters):
        try:
            found, fewer = robust_fit(model, data, runs)
            if found.converged and not is_weak(found):
                return found, fewer
        except (NotConverged, np.linalg.LinAlgError):
            pass  # open directions ran away; the prior holds them
    typical = np.array([p.typical for p in parameters])
    prior = independent(model.start(data.context), typical)
    return robust_fit(model, data, runs, prior)


def robust_fit(
    model: Model, data: Observations, runs: PostureRuns, prior: Prior | None = None
) -> tuple[Fit, int]:
    """Fit with the scatter between runs and the weight of unlike ones as the data show them, and
    how many runs count less; the maximum a posteriori with a prior, which says the scatter of few
    runs."""
    many = prior is None or data.n > _ENOUGH * len(prior.mean)
    if prior is not None and many:
        prior = replace(prior, noise=None)
    start = None if prior is None else prior.mean
    found, fewer = fit_model(model, data, start=start, prior=prior), 0
    for _ in range(2 * many):
        if prior is None and found.null_directions:
            break
        data, fewer = weigh_runs(found, runs)
        found = fit_model(model, data, start=found.theta, prior=prior)
    return found, fewer


def is_weak(fit: Fit) -> bool:
    """Whether some combination of the nine parameters is not well known from the postures."""
    if fit.prior is None and fit.null_directions:
        return True
    slices = fit.model.slices(fit.observations.context)
    own = np.concatenate([np.arange(slices[n].start, slices[n].stop) for n in NINE])
    some = np.zeros((own.size, len(fit.theta)))
    some[np.arange(own.size), own] = [1.0 / fit.parameters[k].typical for k in own]
    if fit.prior is None and fit.observations.n > _ENOUGH * len(fit.theta):
        # Of the scatter of many runs only so much may be noise: postures are not few because
        # something else is missing, which only a search can tell.
        some *= min(1.0, _SCATTER / float(np.median(fit.at.sigma)))
    return is_known_worse(fit, some)


def is_known_worse(fit: Fit, root: Array) -> bool:
    """Whether some combination is known worse than a third of what is known beforehand.

    root : (q, p), rootᵀ root the precision of that
    """
    return bool(np.linalg.eigvalsh(root @ fit.covariance @ root.T)[-1] > _WEAK**2)


def from_data(fit: Fit) -> Array:
    """(p,) share of what is known of a parameter that the data have shown: 1 - (sd / sd before)².

    0: as uncertain as before the recording, by the prior or by its typical size; 1: known from the
    recording alone.
    """
    before = np.array([p.typical for p in fit.parameters])
    if fit.prior is not None:
        before = np.sqrt(np.diag(fit.prior.covariance))
    return np.asarray(np.clip(1.0 - (fit.sd / before) ** 2, 0.0, 1.0))


def open_words(fit: Fit) -> str:
    """The parameters of which the data have shown less than nine tenths, with that share."""
    share = from_data(fit)
    order = [k for k in np.argsort(share) if share[k] < 0.9]
    if not order:
        return "some combinations of parameters"
    return ", ".join(f"{fit.parameters[k].name} ({100.0 * share[k]:.0f} %)" for k in order)


@dataclass(frozen=True)
class OfAKind:
    """What a fleet said of a device. alone : the fit without it
    chance : that one of the kind is as far off, NaN where the fleet was not needed
    used : whether the calibration rests on it"""

    kind: Population
    alone: Fit
    chance: float
    used: bool


def fit_of_a_kind(kind: Population, alone: Fit, runs: PostureRuns) -> tuple[OfAKind, Fit, int]:
    """The fit beside a fleet, and how many of its runs count less.

    alone : of the base model by the recording itself. The fleet counts where the postures know a
    combination of parameters worse than a third of what it knows, and not where the device
    contradicts it.
    """
    own = kind.prior(alone.model, alone.observations, ())
    if not is_known_worse(alone, own.root):
        return OfAKind(kind, alone, float("nan"), False), alone, 0
    data = _add_temperature(alone.observations, runs)
    effects = (*alone.model.effects, *kind.select_shared(data.context))
    model = Model(tuple({e.name: e for e in effects}.values()))
    found, fewer = robust_fit(model, data, runs, kind.prior(model, data, ()))
    chance = kind_chance(found)
    return OfAKind(kind, alone, chance, used=chance >= UNLIKELY), found, fewer


def observations_of(
    runs: PostureRuns, scanned: Scan, gravity: float, blocks: int = 12
) -> Observations:
    """One observation a run, in order of time; sigma as if runs differed by 1 mg beside noise.

    gravity : m/s²; blocks : contiguous stretches of time; each run's is its held-out group
    """
    return Observations(
        runs.mean[:, None],
        _sigma(MG, runs),
        KnownNorm(runs.n, gravity),
        Context(runs.n, covariates_of(runs, scanned)),
        _blocks(runs.time, blocks),
        tuple(f"run at {hours(t)}" for t in runs.time),
    )


def _blocks(time: Array, blocks: int) -> Index:
    """(n,) the stretch of each run, of equal time; of equally many runs where one would hold a
    third of all: two hours on the wrist before days in a drawer would be held out together, and
    nothing be left to predict them from."""
    edges = np.linspace(time[0], time[-1], blocks + 1)[1:-1]
    group = np.searchsorted(edges, time, side="right").astype(np.intp)
    if time.size >= 2 * blocks and np.bincount(group).max() > _LARGEST * time.size:
        group = (np.arange(time.size) * blocks // time.size).astype(np.intp)
    return group


def hours(time: float) -> str:
    """Seconds as days, hours and minutes: "2 d 03:07"."""
    minutes = round(time / 60.0)
    return f"{minutes // 1440} d {minutes // 60 % 24:02d}:{minutes % 60:02d}"


def covariates_of(runs: PostureRuns, scanned: Scan) -> dict[str, Array]:
    """What the effects may depend on. Temperature only where it varies."""
    span = max(scanned.stop, 1.0)
    found = {
        "record": np.arange(runs.n, dtype=float),
        "time": runs.time,
        "order": runs.time / span,
        **covariates_before(runs.mean),
    }
    if span > 1.5 * _DAY:
        start = (scanned.start_ns or 0) / 1e9 % _DAY
        found["time_of_day"] = 2.0 * np.pi * ((runs.time + start) / _DAY % 1.0)
    warm = scanned.temperature
    if warm is not None and np.ptp(runs.temperature) >= _LEAST_WARMTH:  # False for NaN
        found["temperature"] = runs.temperature
        past = {name: remember(warm, name, runs.time) for name in REMEMBERED}
        found |= {n: v for n, v in past.items() if _is_shown(n, v, runs.temperature, warm)}
    return found


def _is_shown(name: str, past: Array, now: Array, warm: ThermalHistory) -> bool:
    """Whether a thermometer shows a past temperature beside the present one: rounded to some °C it
    does not, and what a lag smooths is then its steps. A rate (°C/h) is shown by them too."""
    return name.startswith(RATE.prefix) or warm.shows(past, now)


def _add_temperature(data: Observations, runs: PostureRuns) -> Observations:
    """With the runs' temperature, also where it varies too little to show what it does."""
    if not np.isfinite(runs.temperature).all():
        return data
    known = {**data.context.covariates, "temperature": runs.temperature}
    return replace(data, context=replace(data.context, covariates=known))


def quantisation(runs: PostureRuns) -> float:
    """m/s², what the resolution adds to a posture's error where the noise does not average it out.

    Noise of half a step and more moves every sample to either side. Below that all samples of a
    posture share one rounding error, which is uniform over a step: step / √12.
    """
    step = np.where(runs.noise < 0.5 * runs.resolution, runs.resolution, 0.0)
    return float(np.sqrt(np.mean(step**2) / 12.0))


def average_noise(runs: PostureRuns) -> Array:
    """(n,) (m/s²)², variance of a posture's norm but for what postures scatter by."""
    return np.asarray(quantisation(runs) ** 2 + runs.window_noise**2 / runs.windows)


def _sigma(between: float, runs: PostureRuns) -> Array:
    size = np.sqrt(between**2 + average_noise(runs))
    return np.asarray(np.broadcast_to(size[:, None, None], (runs.n, 1, 3)).copy())


def weigh_runs(fit: Fit, runs: PostureRuns) -> tuple[Observations, int]:
    """The same observations with the scatter between runs as the fit's residual shows it.

    A run's variance is between² + quantisation² + window noise² / windows; `between` makes the
    median square of the residual what it should be. A run beyond 4 standard deviations counts as
    one at 4 (Huber's weight). Returns the observations and how many runs count less.
    """
    misfit = fit.at.residual * fit.at.sigma[:, 0]
    noise = average_noise(runs)

    def ratio(between: float) -> float:
        return float(np.median(misfit**2 / (between**2 + noise))) / _MEDIAN_SQUARE

    low, high = 1e-3 * MG, 1e3 * MG
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if ratio(middle) > 1.0 else (low, middle)
    sigma = _sigma(high, runs)
    far = np.abs(misfit) / sigma[:, 0, 0] / np.sqrt(max(ratio(high), 1e-12)) / _HEAVY
    sigma *= np.maximum(far, 1.0)[:, None, None]
    return replace(fit.observations, sigma=sigma), int((far > 1.0).sum())
