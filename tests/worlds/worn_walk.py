"""Posture runs of worn sensors whose bias wanders, in plain numpy: clean, and with an effect each.

The equations are written anew here. λ is the length of the effect's columns in units of the true
noise, walk included, beside the nine parameters. The oracle is told the effect.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.actigraph.calibrate import ActigraphResult, calibrate
from imucalib.calibrators.actigraph.observations import covariates_of
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.rests.runs import PostureRuns, Scan
from worlds.week import scan_of

G = 9.80665
MG = 1e-3 * G
HOUR = 3600.0
SPAN = 6 * 24 * HOUR
RUNS, HABITS, SCATTER, WINDOW = 400, 26, 0.7, 0.7
NOISES = {
    "white": 0.0,
    "walk 10 min": 600.0,
    "walk 2 h": 2 * HOUR,
    "walk 12 h": 12 * HOUR,
    "t3": 0.0,
}
#: mg on each axis at x (n, 3) in g, temperature excess T, time u from -1/2 to 1/2, per size c (3,)
EFFECTS: dict[str, Callable[[Array, Array, Array, Array], Array]] = {
    "temperature_bias": lambda x, t, u, c: c * t[:, None],
    "temperature_scale": lambda x, t, u, c: c * x * t[:, None],
    "bias_drift": lambda x, t, u, c: c * u[:, None],
    "bias_step": lambda x, t, u, c: c * (u[:, None] > 0.07),
    "cubic": lambda x, t, u, c: c * x**3,
    "converter": lambda x, t, u, c: c * np.sin(2 * np.pi * x / 0.45 + 1.0),
}


def habits_of(rng: np.random.Generator) -> Array:
    habit = rng.standard_normal((HABITS, 3))
    return np.asarray(habit / np.linalg.norm(habit, axis=1, keepdims=True))


def world(rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """time (n,), direction (n, 3), temperature (n,), windows (n,)"""
    time = np.sort(rng.uniform(0.0, SPAN, RUNS))
    habit = habits_of(rng)
    direction = habit[rng.integers(0, HABITS, RUNS)] + 0.15 * rng.standard_normal((RUNS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    warm = 30.0 + 2.0 * np.sin(2 * np.pi * time / (24 * HOUR) + rng.uniform(0, 6))
    warm += 2.0 * np.repeat(rng.standard_normal(RUNS // 8), 8)
    return time, direction, warm, 1 + rng.geometric(0.12, RUNS)


def gain_and_bias(rng: np.random.Generator) -> tuple[Array, Array]:
    gain = np.diag(1.0 + 0.03 * rng.standard_normal(3))
    gain[np.tril_indices(3, -1)] = 0.02 * rng.standard_normal(3)
    return gain, 30.0 * rng.standard_normal(3)


def walk(time: Array, tau: float, rng: np.random.Generator) -> Array:
    """(n, 3) mg, an Ornstein-Uhlenbeck walk of 1 mg an axis."""
    out = rng.standard_normal((time.size, 3))
    for k in range(1, time.size):
        keep = np.exp(-(time[k] - time[k - 1]) / tau)
        out[k] = keep * out[k - 1] + np.sqrt(1.0 - keep**2) * out[k]
    return out


def strength(
    effect: Array, direction: Array, gain: Array, time: Array, tau: float, windows: Array
) -> float:
    """λ of an effect (n, 3) mg."""
    normal = np.linalg.solve(gain.T, direction.T).T
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    variance = np.diag(SCATTER**2 + WINDOW**2 / windows)
    if tau:
        lag = np.exp(-np.abs(time[:, None] - time) / tau)
        variance = variance + lag * (normal @ normal.T)
    d = direction
    base = [normal[:, i] for i in range(3)] + [normal[:, i] * d[:, i] for i in range(3)]
    base += [normal[:, i] * d[:, j] for i, j in ((1, 0), (2, 0), (2, 1))]
    low = np.linalg.cholesky(variance)
    white = np.linalg.solve(low, np.column_stack([*base, np.sum(normal * effect, axis=1)]))
    q = np.linalg.qr(white[:, :-1])[0]
    left = white[:, -1] - q @ (q.T @ white[:, -1])
    return float(np.linalg.norm(left))


def recording(time: Array, reading: Array, warm: Array, windows: Array) -> tuple[PostureRuns, Scan]:
    grid = np.arange(0.0, SPAN, 600.0)
    scan = scan_of(grid, np.interp(grid, time, warm), rate=100.0, seconds=SPAN)
    total = int(windows.sum())
    runs = PostureRuns(
        mean=reading,
        windows=windows.astype(np.intp),
        time=time,
        temperature=warm,
        window_noise=WINDOW * MG,
        still=total,
        total=2 * total,
        noise=np.full(3, 4.0 * MG),
    )
    return runs, scan


class Case:
    """One recording with its truth."""

    def __init__(self, noise: str, effect: str, aim: float, seed: int) -> None:
        rng = np.random.default_rng(seed)
        tau = NOISES[noise]
        time, direction, warm, windows = world(rng)
        self.gain, self.bias = gain_and_bias(rng)
        self.effect, self.size = effect, np.zeros(3)
        u = time / SPAN - 0.5
        if effect:
            self.size = rng.standard_normal(3)
            one = self.added(direction, warm - 25.0, u)
            self.size *= aim / strength(one, direction, self.gain, time, tau, windows)
        scatter = (
            rng.standard_t(3, (RUNS, 3)) / 3**0.5
            if noise == "t3"
            else rng.standard_normal((RUNS, 3))
        )
        off = (
            SCATTER * scatter + WINDOW * rng.standard_normal((RUNS, 3)) / np.sqrt(windows)[:, None]
        )
        self.walk = walk(time, tau, rng) if tau else np.zeros((RUNS, 3))
        off += self.walk
        self.time, self.warm = time, warm
        sensed = self.sensed(direction, warm, u)
        self.runs, self.scan = recording(time, sensed + MG * off, warm, windows)

    def sensed(self, x: Array, warm: Array, u: Array) -> Array:
        out = G * x @ self.gain.T + MG * self.bias
        if self.effect:
            out = out + MG * self.added(x, warm - 25.0, u)
        return out

    def added(self, x: Array, excess: Array, u: Array) -> Array:
        """(n, 3) mg, the effect."""
        return EFFECTS[self.effect](x, excess, u, self.size)

    def solved(self, request: ActigraphRequest) -> ActigraphResult:
        return calibrate(self.runs, self.scan, request)

    def error(self, fit: Fit) -> float:
        """mg, mean | |a| - g | over the sphere at conditions of the recording, walk included."""
        rng = np.random.default_rng(1)
        x = rng.standard_normal((600, 3))
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        rows = rng.integers(0, RUNS, 600)
        reading = self.sensed(x, self.warm[rows], self.time[rows] / SPAN - 0.5)
        reading = reading + MG * self.walk[rows]
        whole = Context(RUNS, covariates_of(self.runs, self.scan))
        got = fit.model.correct(fit.theta, reading[:, None], whole.take(rows))[:, 0]
        return float(np.mean(np.abs(np.linalg.norm(got, axis=1) - G))) / MG

    def oracle_name(self) -> str:
        at = 0.57 * SPAN
        return f"bias_step@{at:.10g}s" if self.effect == "bias_step" else self.effect
