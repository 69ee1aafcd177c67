"""Several estimates of the same numbers, each with its covariance: the pooled one, whether they
agree, and what a new one will be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.run import ArrayRun
from imucalib.core.eigen import eigen
from imucalib.units import DEG

_ALPHA = 0.01  # p of the agreement from which on numbers are said to repeat
_LARGE = 3.0  # between logs over stated, above which they do not, whatever p says


@dataclass(frozen=True)
class Repeat:
    """Numbers of one kind in all logs. name, unit; each : names of the p numbers
    values, sds : (n, p) of every log; found : pooled, the numbers taken as independent"""

    name: str
    unit: str
    each: tuple[str, ...]
    values: Array
    sds: Array
    found: Pooled

    @property
    def between(self) -> float:
        """Rms over the numbers of the sd between logs."""
        return float(np.sqrt(np.mean(self.found.between**2)))

    @property
    def stated(self) -> float:
        return float(np.sqrt(np.mean(self.sds**2)))

    @property
    def holds(self) -> bool:
        """Whether the logs agree on them within what they state, or nearly."""
        return self.found.p >= _ALPHA or self.found.tau < self.stated * (_LARGE - 1.0)


def repeats(runs: Sequence[ArrayRun]) -> tuple[Repeat, ...]:
    """Gains, offsets, and the parameters of effects that every log has found."""
    imus = runs[0].board.imus
    in_board = [run.rests.in_board_axes() for run in runs]
    gain = np.array([g.ravel() for g, _, _ in in_board])
    own = np.array([np.sqrt(np.diagonal(c, axis1=1, axis2=2)) for _, _, c in in_board])
    nine = tuple(f"{imu}.{a}{b}" for imu in imus for a in "xyz" for b in "xyz")
    three = tuple(f"{imu}.{a}" for imu in imus for a in "xyz")
    n = len(runs)
    rows = [
        _repeat("accelerometer gains", "1", nine, gain, own[:, :, :9].reshape(n, -1)),
        _repeat(
            "accelerometer biases",
            "m/s²",
            three,
            np.array([b.ravel() for _, b, _ in in_board]),
            own[:, :, 9:].reshape(n, -1),
        ),
        _repeat(
            "gyro biases",
            "deg/s",
            three,
            np.array([run.rests.gyro_bias[0].ravel() / DEG for run in runs]),
            np.array([run.rests.gyro_bias_sd.ravel() / DEG for run in runs]),
        ),
    ]
    return (*rows, *_effects(runs))


def _effects(runs: Sequence[ArrayRun]) -> list[Repeat]:
    terms = [run.loop.final.found if run.loop else () for run in runs]
    shared = [t.name for t in terms[0] if all(any(u.name == t.name for u in x) for x in terms)]
    found = []
    for name in shared:
        values, sds = [], []
        for run, own in zip(runs, terms, strict=True):
            assert run.loop is not None
            term = next(t for t in own if t.name == name)
            values.append(term.theta)
            sds.append(run.loop.final.sd_of(term))
        parameters = term.parameters(run.board.imus)
        each = tuple(p.name for p in parameters)
        if len({len(v) for v in values}) == 1:
            found.append(_repeat(name, parameters[0].unit, each, np.array(values), np.array(sds)))
    return found


def _repeat(name: str, unit: str, each: tuple[str, ...], values: Array, sds: Array) -> Repeat:
    # What no log determines is held at zero in all of them: it says nothing of their agreement.
    told = np.maximum(sds, 1e-6 * max(float(sds.max()), 1e-300))
    found = pooled(values, np.array([np.diag(s**2) for s in told]))
    return Repeat(name, unit, each, values, sds, found)


_SMALLEST, _LARGEST = 1e-3, 1e2  # of what differs from log to log, in median stated deviations
_GRID = 41


@dataclass(frozen=True)
class Pooled:
    """n estimates (n, d) put together.

    mean : (d,); covariance : (d, d) of it; tau : sd of what differs from one to the next beyond
    what each states, one number for all coordinates; between : (d,) sd over the estimates
    chi2, freedom, p : their agreement within what they state, tau zero
    left_out : (n,) rms of each estimate's deviation from the others' pooled one, whitened by all
    of its covariance, tau estimated without it; missed : (n, d) those deviations
    """

    mean: Array
    covariance: Array
    tau: float
    between: Array
    chi2: float
    freedom: int
    p: float
    left_out: Array
    missed: Array

    def new(self, own: Array) -> Array:
        """(d, d) of the deviation of a new estimate, with its own covariance, from this one."""
        return np.asarray(own + self.tau**2 * np.eye(len(self.mean)) + self.covariance)


def pooled(values: Array, covariances: Array) -> Pooled:
    """values : (n, d) of n >= 2 logs; covariances : (n, d, d)."""
    from scipy.special import gammaincc

    n, d = values.shape
    plain, _ = _mean(values, covariances, 0.0)
    away = values - plain
    chi2 = float(sum(e @ np.linalg.solve(v, e) for e, v in zip(away, covariances, strict=True)))
    tau = between_logs(values, covariances)
    mean, covariance = _mean(values, covariances, tau)
    left_out, missed = np.zeros(n), np.zeros((n, d))
    for k in range(n):
        others = np.arange(n) != k
        own = between_logs(values[others], covariances[others]) if n > 2 else 0.0
        center, spread = _mean(values[others], covariances[others], own)
        missed[k] = values[k] - center
        whole = covariances[k] + own**2 * np.eye(d) + spread
        left_out[k] = np.sqrt(missed[k] @ np.linalg.solve(whole, missed[k]) / d)
    freedom = d * (n - 1)
    return Pooled(
        mean=mean,
        covariance=covariance,
        tau=tau,
        between=values.std(axis=0, ddof=1),
        chi2=chi2,
        freedom=freedom,
        p=float(gammaincc(0.5 * freedom, 0.5 * chi2)),
        left_out=left_out,
        missed=missed,
    )


def between_logs(values: Array, covariances: Array) -> float:
    """tau of covariances V_i + tau² I by restricted maximum likelihood: the maximum of
    -1/2 [Σ log|V_i + tau² I| + log|Σ W_i| + Σ eᵀ W_i e], W_i the inverses, e about the pooled mean
    (Harville 1977, JASA 72)."""
    unit = float(np.sqrt(np.median([np.median(np.diag(v)) for v in covariances])))
    if unit == 0.0:
        unit = max(float(np.median(values.std(axis=0, ddof=1))), 1e-300)
    # Each V_i once in its own axes: a try of tau then costs no factorisation but the pooled one's.
    turns = [tuple(eigen(v)) for v in covariances]
    grid = unit * np.concatenate([[0.0], np.geomspace(_SMALLEST, _LARGEST, _GRID)])
    level = [_restricted(values, turns, tau) for tau in grid]
    best = int(np.argmax(level))
    if best == 0:
        return 0.0
    from scipy.optimize import minimize_scalar

    low, high = np.log(grid[max(best - 1, 1)]), np.log(grid[min(best + 1, _GRID)])
    found = minimize_scalar(
        lambda x: -_restricted(values, turns, float(np.exp(x))),
        bounds=(low, high),
        method="bounded",
    )
    return float(np.exp(found.x)) if -found.fun > level[0] else 0.0


def _restricted(values: Array, turns: Sequence[tuple[Array, ...]], tau: float) -> float:
    spread = [np.maximum(size + tau**2, 1e-300) for size, _ in turns]
    weights = [(axes / s) @ axes.T for s, (_, axes) in zip(spread, turns, strict=True)]
    whole = np.sum(weights, axis=0)
    mean = np.linalg.solve(whole, sum(w @ v for w, v in zip(weights, values, strict=True)))
    power = sum(float((v - mean) @ w @ (v - mean)) for w, v in zip(weights, values, strict=True))
    logs = sum(float(np.log(s).sum()) for s in spread) + float(np.linalg.slogdet(whole)[1])
    return -0.5 * (logs + power)


def _mean(values: Array, covariances: Array, tau: float) -> tuple[Array, Array]:
    """The pooled mean and its covariance for a given tau."""
    weights = np.linalg.inv(covariances + tau**2 * np.eye(values.shape[1]))
    covariance = np.linalg.inv(weights.sum(axis=0))
    return covariance @ np.einsum("nij,nj->i", weights, values), covariance
