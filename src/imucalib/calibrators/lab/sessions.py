"""What changes from one power-up to the next, and how far it carries: this session and the next.

The errors that sessions share are variance components of the fit (`core/sessions`). Their sizes
are known from as many sessions as there are: a prediction for the next power-up is a mixture over
the sizes that the restricted likelihood allows, so that few sessions give wide intervals and none
of size zero. Axes of one chip scatter alike within a factor of two, not equally: the size of an
axis is log-normal about that of all, which has the prior 1 / (size + what noise alone does to a
session's mean); what the axes say of each other is in the weights of each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Noise, whitener
from imucalib.core.fit import Fit
from imucalib.core.observations import BIAS, MOUNTING, session_of
from imucalib.estimators.variance import estimate_noise
from imucalib.loop.held_out import Fold
from imucalib.units import DEG, MG

#: What sessions change: the effect whose parameters carry it, and the unit that people read.
_CARRIED = {BIAS: ("bias", "mg", MG), MOUNTING: ("mounting", "deg", DEG)}
_SIZES, _REACH = 36, (0.05, 30.0)
_LEVEL = 0.95
#: Standard deviation of the log of an axis' scatter about that of all: 60 power-ups of an MPU-9250
#: have 0.46, 0.25 and 0.63 mg.
_UNLIKE = 0.5


@dataclass(frozen=True)
class Between:
    """The scatter of one component between sessions.

    effect : whose parameters carry it; unit : that it is given in; sd : REML estimate, all axes
    interval : 95 % of what the data allow
    offsets, offsets_sd : (sessions, 3) of each session from the mean, in that unit
    """

    name: str
    effect: str
    unit: str
    sd: float
    interval: tuple[float, float]
    offsets: Array
    offsets_sd: Array


@dataclass(frozen=True)
class NextPowerUp:
    """A parameter after the next power-up: mean : sd of the mean over power-ups, sd : of the next
    one, half : half of its 95 % interval"""

    name: str
    effect: str
    unit: str
    value: float
    mean: float
    sd: float
    half: float


@dataclass(frozen=True)
class Sessions:
    """names : of the sessions, in the order of the offsets; between : what scatters between them;
    parameters : every one that changes with power-ups"""

    names: tuple[str, ...]
    between: tuple[Between, ...]
    parameters: tuple[NextPowerUp, ...]


def sessions_of(fit: Fit, names: tuple[str, ...]) -> Sessions | None:
    """The sessions of a fit, or None where it has only one. names : by number"""
    session = session_of(fit.observations)
    if session is None:
        return None
    used = np.unique(session)
    between, parameters = [], list[NextPowerUp]()
    slices = fit.model.slices(fit.observations.context)
    for k, noise in enumerate(fit.observations.of_sessions, start=fit.at.free):
        effect, unit, si = _CARRIED[noise.name]
        sizes, weights, by_axis = _allowed(fit, k)
        sd = fit.noise.sd[k] / si
        part = slices.get(effect)
        for axis, at in enumerate(range(part.start, part.stop) if part else ()):
            var = _variance(fit, at, sizes / si, sd, used.size)
            parameters.append(
                NextPowerUp(
                    name=fit.parameters[at].name,
                    effect=effect,
                    unit=unit,
                    value=float(fit.theta[at]),
                    mean=float(fit.covariance[at, at] ** 0.5),
                    sd=float(np.sqrt(by_axis[axis] @ var)),
                    half=_half(np.sqrt(var), by_axis[axis]),
                )
            )
        below = np.cumsum(weights) - 0.5 * weights
        low, high = np.interp((0.5 - _LEVEL / 2, 0.5 + _LEVEL / 2), below, sizes / si)
        offsets = (found.reshape(-1, 3)[used] / si for found in _offsets(fit, k))
        between.append(Between(noise.name, effect, unit, sd, (float(low), float(high)), *offsets))
    return Sessions(tuple(names[k] for k in used), tuple(between), tuple(parameters))


def session_folds(fit: Fit) -> tuple[Fold, ...]:
    """Each session left out by itself."""
    session = session_of(fit.observations)
    if session is None:
        return ()
    each = (session == k for k in np.unique(session))
    return tuple(Fold(np.flatnonzero(own), np.flatnonzero(~own)) for own in each)


def _allowed(fit: Fit, k: int) -> tuple[Array, Array, Array]:
    """Sizes of a component (SI), their weights for all axes and for each, the other components at
    their estimates."""
    matrix = fit.at.settings[k]
    length = float(np.sqrt(np.mean(np.sum(matrix**2, axis=0)[np.any(matrix, axis=0)])))
    noise_alone = fit.noise.factor / max(length, 1e-300)
    top = _REACH[1] * max(fit.noise.sd[k], noise_alone)
    sizes = np.geomspace(_REACH[0] * noise_alone, top, _SIZES)
    nats = np.array([[_nats(fit, k, axis, float(s)) for s in sizes] for axis in range(3)])
    likely = np.exp(nats - nats.max(axis=1, keepdims=True))
    about = np.exp(-0.5 * (np.log(sizes[:, None] / sizes) / _UNLIKE) ** 2)
    about = about / about.sum(axis=0)  # (size of an axis, size of all)
    prior = sizes / (sizes + noise_alone)  # 1 / (size + noise) on a grid even in the logarithm
    seen = likely @ about
    all_axes = prior * seen.prod(axis=0)
    each = likely * ((prior * seen.prod(axis=0) / np.maximum(seen, 1e-300)) @ about.T)
    return sizes, all_axes / all_axes.sum(), each / each.sum(axis=1, keepdims=True)


def _nats(fit: Fit, k: int, axis: int, size: float) -> float:
    """Restricted log likelihood with the scatter of one axis at a size, all else as estimated."""
    at, noise = fit.at, fit.noise
    whole = at.settings[k]
    own = np.arange(whole.shape[1]) % 3 == axis
    settings = (*at.settings[:k], whole[:, ~own], *at.settings[k + 1 :], whole[:, own])
    component = (*noise.component, noise.component[k])
    parted = Noise(noise.factor, component, (*noise.sd, size))
    balanced = replace(at, settings=settings, component=component)
    return estimate_noise(balanced, parted, fixed=True).log_likelihood


def _offsets(fit: Fit, k: int) -> tuple[Array, Array]:
    """(q,) best linear unbiased prediction of a component and its sd (Henderson 1975), with θ
    integrated out: u = s² Nᵀ P r, var(u - û) = s² - s² Nᵀ P N s²."""
    at, noise = fit.at, fit.noise
    white = whitener(at.settings, noise.ratio)
    columns = white(np.column_stack([at.jacobian, at.settings[k], at.residual])) / noise.factor
    p, q = at.jacobian.shape[1], at.settings[k].shape[1]
    basis = np.linalg.qr(columns[:, :p])[0]
    rest = columns[:, p:] - basis @ (basis.T @ columns[:, p:])
    of, data = rest[:, :q], rest[:, q]
    variance = noise.sd[k] ** 2
    spread = variance - variance**2 * np.einsum("nq,nq->q", of, of)
    return variance * of.T @ data, np.sqrt(np.maximum(spread, 0.0))


def _variance(fit: Fit, k: int, sizes: Array, sd: float, sessions: int) -> Array:
    """(q,) of a parameter after the next power-up, for each size (q,) that the scatter may have;
    the mean's holds a share of what the scatter is taken to be, `sd`."""
    own = float(fit.covariance[k, k])
    return np.asarray(np.maximum(own + (sizes**2 - sd**2) / sessions, 0.1 * own) + sizes**2)


def _half(sd: Array, weights: Array) -> float:
    """Half of the central 95 % of a mixture of normals of one centre."""
    from scipy.optimize import brentq
    from scipy.special import ndtr

    def missing(half: float) -> float:
        return float(weights @ (2.0 * ndtr(half / sd) - 1.0)) - _LEVEL

    return float(brentq(missing, 0.0, 50.0 * float(sd.max())))
