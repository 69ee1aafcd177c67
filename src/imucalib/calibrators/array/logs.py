"""Several logs of one board: one estimate, one calibration, and how far the logs agree."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.outcome import ErrorSummary, HeldOutError, Limit, Outcome, Run
from imucalib.calibration.triads import Triad, effect_covariance, triangle
from imucalib.calibrators.array.board.turns import BoardTurns, GyroScale, gyro_scale
from imucalib.calibrators.array.findings import effect_blocks
from imucalib.calibrators.array.motion.total import Total, size_block, total_of
from imucalib.calibrators.array.run import (
    ArrayRun,
    array_calibration,
    instrument_block,
    position_rows,
)
from imucalib.core.eigen import eigen
from imucalib.errors import UsageError
from imucalib.units import DEG

_SMALLEST, _LARGEST, _GRID = 1e-3, 1e2, 41  # of what differs, in median stated deviations
_ALPHA = 0.01  # p of the agreement from which on numbers are said to repeat
_LARGE = 3.0  # between logs over stated, above which they do not, whatever p says
_DIFFER = 1e-3  # p of the agreement below which logs are said to differ by more than they state


@dataclass(frozen=True)
class PooledLogs:
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


def pool_logs(values: Array, covariances: Array) -> PooledLogs:
    """values : (n, d) of n >= 2 logs; covariances : (n, d, d)."""
    from scipy.special import gammaincc

    n, d = values.shape
    away = values - _mean(values, covariances, 0.0)[0]
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
    return PooledLogs(
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
    from scipy.optimize import minimize_scalar

    unit = float(np.sqrt(np.median([np.median(np.diag(v)) for v in covariances])))
    unit = unit or max(float(np.median(values.std(axis=0, ddof=1))), 1e-300)
    # Each V_i once in its own axes: a try of tau then costs no factorisation but the pooled one's.
    own = [eigen(v) for v in covariances]

    def likelihood(tau: float) -> float:
        spread = [np.maximum(size + tau**2, 1e-300) for size, _ in own]
        weights = [(axes / s) @ axes.T for s, (_, axes) in zip(spread, own, strict=True)]
        whole = np.sum(weights, axis=0)
        mean = np.linalg.solve(whole, sum(w @ v for w, v in zip(weights, values, strict=True)))
        off = zip(weights, values - mean, strict=True)
        power = sum(float(e @ w @ e) for w, e in off)
        logs = sum(float(np.log(s).sum()) for s in spread) + float(np.linalg.slogdet(whole)[1])
        return -0.5 * (logs + power)

    grid = unit * np.concatenate([[0.0], np.geomspace(_SMALLEST, _LARGEST, _GRID)])
    level = [likelihood(tau) for tau in grid]
    best = int(np.argmax(level))
    if best == 0:
        return 0.0
    ends = np.log(grid[max(best - 1, 1)]), np.log(grid[min(best + 1, _GRID)])
    found = minimize_scalar(lambda x: -likelihood(float(np.exp(x))), bounds=ends, method="bounded")
    return float(np.exp(found.x)) if -found.fun > level[0] else 0.0


def _mean(values: Array, covariances: Array, tau: float) -> tuple[Array, Array]:
    """The pooled mean and its covariance for a given tau."""
    weights = np.linalg.inv(covariances + tau**2 * np.eye(values.shape[1]))
    covariance = np.linalg.inv(weights.sum(axis=0))
    return covariance @ np.einsum("nij,nj->i", weights, values), covariance


@dataclass(frozen=True)
class Repeat:
    """Numbers of one kind in all logs. name, unit; each : names of the p numbers
    values, sds : (n, p) of every log; found : pooled, the numbers taken as independent"""

    name: str
    unit: str
    each: tuple[str, ...]
    values: Array
    sds: Array
    found: PooledLogs

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

    def as_dict(self) -> dict[str, Any]:
        """Numbers that repeat come pooled, others with every log's own."""
        found = self.found
        if self.holds:
            sd = np.sqrt(np.diag(found.covariance))
            numbers = {"pooled": found.mean.tolist(), "sd": sd.tolist()}
        else:
            numbers = {"of_each_log": self.values.tolist()}
        return {
            "what": self.name,
            "unit": self.unit,
            "between_logs_rms": self.between,
            "stated_rms": self.stated,
            "tau": found.tau,
            "p": found.p,
            "repeats": self.holds,
            "names": list(self.each),
            **numbers,
        }


def _repeat(name: str, unit: str, each: tuple[str, ...], values: Any, sds: Any) -> Repeat:
    """values, sds : of each of the n logs, p numbers."""
    values, sds = (np.array([np.ravel(one) for one in both]) for both in (values, sds))
    # What no log determines is held at zero in all of them: it says nothing of their agreement.
    known = np.maximum(sds, 1e-6 * max(float(sds.max()), 1e-300))
    found = pool_logs(values, np.array([np.diag(s**2) for s in known]))
    return Repeat(name, unit, each, values, sds, found)


def _repeats(runs: Sequence[ArrayRun]) -> Iterator[Repeat]:
    """Gains, offsets, and the parameters of effects that every log has found."""
    gains, biases, covariances = zip(*(run.rests.in_board_axes() for run in runs), strict=True)
    own = [np.sqrt(np.diagonal(c, axis1=1, axis2=2)) for c in covariances]
    slow = [(r.rests.gyro_bias[0] / DEG, r.rests.gyro_bias_sd / DEG) for r in runs]
    imus = runs[0].board.imus
    nine = tuple(f"{imu}.{a}{b}" for imu in imus for a in "xyz" for b in "xyz")
    three = tuple(f"{imu}.{a}" for imu in imus for a in "xyz")
    yield _repeat("accelerometer gains", "1", nine, gains, [sd[:, :9] for sd in own])
    yield _repeat("accelerometer biases", "m/s²", three, biases, [sd[:, 9:] for sd in own])
    yield _repeat("gyro biases", "deg/s", three, *zip(*slow, strict=True))
    loops = [run.loop for run in runs if run.loop is not None]
    if len(loops) < len(runs):
        return
    terms = [{term.name: term for term in loop.final.found} for loop in loops]
    for name, term in terms[0].items():
        same = [other.get(name) for other in terms]
        found = [t for t in same if t is not None and len(t.theta) == len(term.theta)]
        if len(found) == len(runs):
            sds = [loop.final.sd_of(t) for loop, t in zip(loops, found, strict=True)]
            parameters = term.parameters(imus)
            each = tuple(p.name for p in parameters)
            yield _repeat(name, parameters[0].unit, each, [t.theta for t in found], sds)


@dataclass(frozen=True, kw_only=True)
class BoardRun(Run):
    """Several logs put together: motion's positions pooled, total with size and frame; repeats :
    which other numbers hold from log to log"""

    runs: tuple[ArrayRun, ...]
    pooled: PooledLogs
    total: Total
    gyros: GyroScale
    repeats: tuple[Repeat, ...]


def board_run(runs: tuple[ArrayRun, ...]) -> BoardRun:
    """Raises UsageError unless these are two or more logs of one board."""
    if len(runs) < 2 or len({run.board.imus for run in runs}) > 1:
        raise UsageError("a joint estimate needs two or more logs of one board")
    found = pool_logs(
        np.array([run.total.by_motion[1:].ravel() for run in runs]),
        np.array([run.total.motion for run in runs]),
    )
    request, gyros = runs[0].request, _common_scale(runs)
    total = total_of(
        np.concatenate([np.zeros((1, 3)), found.mean.reshape(-1, 3)]),
        found.covariance,
        gyros=gyros,
        gravity_sd=request.gravity_sd,
        frame_sd=float(np.sqrt(np.mean([run.rests.frame_sd**2 for run in runs]))),
        distances=request.distances,
    )
    repeats = tuple(_repeats(runs))
    outcome = _outcome(runs, found, total)
    details = _details(runs, found, total, gyros, repeats)
    calibration = array_calibration(
        outcome,
        total,
        runs[0].board.imus,
        gravity=runs[0].rests.gravity,
        facts=details,
        triads=tuple(_triad(runs, k, gyros) for k in range(runs[0].board.count)),
    )
    return BoardRun(
        outcome=outcome,
        calibration=calibration,
        details=details,
        runs=runs,
        pooled=found,
        total=total,
        gyros=gyros,
        repeats=repeats,
    )


def _common_scale(runs: Sequence[ArrayRun]) -> GyroScale:
    """Every log's turns together; data sheets say the same in all logs and count once."""
    turns = [run.gyros.turns for run in runs if run.gyros.turns is not None]
    if not turns:
        return runs[0].gyros
    weight = np.array([t.sd**-2.0 for t in turns])
    scale = float(weight @ [t.scale for t in turns] / weight.sum())
    chi2 = float(weight @ [(t.scale - scale) ** 2 for t in turns])
    wide = max(1.0, chi2 / max(len(turns) - 1, 1))
    whole = BoardTurns(
        scale,
        float(np.sqrt(wide / weight.sum())),
        sum(t.count for t in turns),
        float(np.sqrt(np.mean([t.misfit**2 for t in turns]))),
    )
    return gyro_scale(runs[0].gyros.tolerance, whole)


def _details(
    runs: Sequence[ArrayRun],
    found: PooledLogs,
    total: Total,
    gyros: GyroScale,
    repeats: Sequence[Repeat],
) -> dict[str, Any]:
    """Agreement, pooled positions, what repeats, and what every log has by itself."""
    board = runs[0].board
    new = np.sqrt(np.diag(found.new(np.mean([r.total.motion for r in runs], axis=0))))
    between = 1e3 * np.concatenate([np.zeros(3), found.between]).reshape(-1, 3)
    return {
        "board": board.name,
        "reference": board.imus[0],
        "logs": [_log(run, float(z)) for run, z in zip(runs, found.left_out, strict=True)],
        "agreement": {
            "chi2": found.chi2,
            "degrees_of_freedom": found.freedom,
            "p": found.p,
            "tau_mm": 1e3 * found.tau,
            "left_out_z_rms": float(np.sqrt(np.mean(found.left_out**2))),
            "new_log_sd_mm": float(1e3 * np.sqrt(np.mean(new**2))),
        },
        "positions_mm": position_rows(board, total, between_logs=between),
        **size_block(total, gyros, board),
        **instrument_block(board, runs[0].moving.interval),
        "effects": list(_effects(runs[0], repeats)),
        "repeats": [one.as_dict() for one in repeats],
    }


def _log(run: ArrayRun, z: float) -> dict[str, Any]:
    """What belongs to one power-up."""
    made, triads = run.outcome.provenance, run.calibration.triads
    effects = effect_blocks(run.loop) if run.loop is not None else []
    return {
        "input": made.input,
        "sha256": made.sha256,
        "z_rms_of_positions_by_the_others": z,
        "accelerometer_bias_m_per_s2": {t.name: t.bias.tolist() for t in triads},
        "gyro_bias_deg_per_s": {t.name: np.rad2deg(t.gyro_bias).tolist() for t in triads},
        "beats": [b for e in effects for b in e.get("beats", ()) if b is not None],
    }


def _effects(run: ArrayRun, repeats: Sequence[Repeat]) -> Iterator[dict[str, Any]]:
    """Effects that every log has found, with their pooled values; beats are of each log."""
    known = {one.name: one.found for one in repeats}
    for block in effect_blocks(run.loop) if run.loop is not None else []:
        if (one := known.get(block["effect"])) is None:
            continue
        sd = np.sqrt(np.diag(one.covariance) + one.tau**2)
        # Numbers are pooled one by one; how they go together is the first log's word.
        first = effect_covariance(block)
        share = sd / np.sqrt(np.maximum(np.diag(first), 1e-300))
        own = zip(block["parameters"], one.mean, sd, strict=True)
        parameters = [{**p, "value": float(v), "sd": float(s)} for p, v, s in own]
        together = first * np.outer(share, share)
        together[np.diag_indices_from(together)] = sd**2
        kept = {k: v for k, v in block.items() if k != "beats"}
        yield {**kept, "parameters": parameters, "covariance": triangle(together)}


def _outcome(runs: Sequence[ArrayRun], found: PooledLogs, total: Total) -> Outcome:
    nan, stated = float("nan"), np.array([np.diag(run.total.motion) for run in runs])
    error = ErrorSummary(
        metric="positions of a log by the others, rms",
        unit="mm",
        raw=nan,
        base=nan,
        final=nan,
        floor=float(1e3 * np.sqrt(np.mean(stated))),
        held_out=HeldOutError(nan, nan, float(1e3 * np.sqrt(np.mean(found.missed**2)))),
    )
    made = [run.outcome.provenance for run in runs]
    logs = [{"input": one.input, "sha256": one.sha256} for one in made]
    reasons: tuple[str, ...] = ()
    if found.p < _DIFFER:
        reasons = (
            f"the logs differ by more than they state: χ² {found.chi2:.0f} of {found.freedom} "
            f"(p {found.p:.1g}); {1e3 * found.tau:.2g} mm that differ from log to log are in what "
            "is stated",
        )
    return Outcome(
        calibrator="array",
        errors=(error,),
        provenance=replace(made[0], settings={**made[0].settings, "logs": logs}),
        reasons=reasons,
        limits=tuple(
            Limit(name, 1e3 * float(total.sd.max()), limit, "mm")
            for name, limit in runs[0].request.limits.items()
            if name == "max-position-sd"
        ),
        sensor=runs[0].outcome.sensor,
    )


def _triad(runs: Sequence[ArrayRun], k: int, gyros: GyroScale) -> Triad:
    """One IMU: gains pooled; biases, which are anew at every power-up, as the logs' mean with what
    they differ by."""
    own = [run.calibration.triads[k] for run in runs]
    covariance, means = np.zeros((12, 12)), []
    for at, values in (
        (slice(0, 9), np.array([t.gain.ravel() for t in own])),
        (slice(9, 12), np.array([t.bias for t in own])),
    ):
        size = np.eye(values.shape[1])
        found = pool_logs(values, np.array([t.covariance[at, at] + 1e-18 * size for t in own]))
        covariance[at, at] = found.covariance + (found.tau**2 * size if at.start else 0.0)
        means.append(found.mean)
    scale = [(1.0 + gyros.value) / (1.0 + run.gyros.value) for run in runs]
    return replace(
        own[0],
        gain=means[0].reshape(3, 3),
        bias=means[1],
        gyro_gain=np.mean([s * t.gyro_gain for s, t in zip(scale, own, strict=True)], axis=0),
        gyro_bias=np.mean([t.gyro_bias for t in own], axis=0),
        covariance=covariance,
        noise=float(np.sqrt(np.mean([t.noise**2 for t in own]))),
        gyro_noise=float(np.sqrt(np.mean([t.gyro_noise**2 for t in own]))),
    )
