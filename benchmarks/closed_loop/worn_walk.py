"""Worn sensors whose bias wanders, in plain numpy: clean ones, and one planted effect each.

    python benchmarks/closed_loop/worn_walk.py clean 40        # per noise
    python benchmarks/closed_loop/worn_walk.py planted 6       # per effect, noise and strength
    python benchmarks/closed_loop/worn_walk.py outside 4       # what no name says, per noise
    python benchmarks/closed_loop/worn_walk.py junk 60         # effects declared that are not there

The equations are written anew here. λ is the length of the effect's columns in units of the true
noise, walk included, beside the nine parameters. The oracle is told the effect.
"""

from __future__ import annotations

import sys
import time as clock
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from imucalib.calibrators.actigraph.calibrate import ActigraphResult, calibrate
from imucalib.calibrators.actigraph.observations import covariates_of
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.simulation import scan_of
from imucalib.core.context import Context
from imucalib.core.fit import Fit
from imucalib.rests.runs import PostureRuns, Scan

Array = NDArray[np.float64]
G = 9.80665
MG = 1e-3 * G
HOUR = 3600.0
SPAN = 6 * 24 * HOUR
RUNS, HABITS, SCATTER, WINDOW = 400, 26, 0.7, 0.7
NOISES = {"white": 0.0, "walk 10 min": 600.0, "walk 2 h": 2 * HOUR, "walk 12 h": 12 * HOUR,
          "t3": 0.0}  # fmt: skip
#: mg on each axis at x (n, 3) in g, temperature excess T, time u from -1/2 to 1/2, per size c (3,)
EFFECTS: dict[str, Callable[[Array, Array, Array, Array], Array]] = {
    "temperature_bias": lambda x, t, u, c: c * t[:, None],
    "temperature_scale": lambda x, t, u, c: c * x * t[:, None],
    "bias_drift": lambda x, t, u, c: c * u[:, None],
    "bias_step": lambda x, t, u, c: c * (u[:, None] > 0.07),
    "quadratic": lambda x, t, u, c: c * x**2,
    "cubic": lambda x, t, u, c: c * x**3,
    "converter": lambda x, t, u, c: c * np.sin(2 * np.pi * x / 0.45 + 1.0),
    "dead_band": lambda x, t, u, c: c * np.clip(x / 0.05, -1.0, 1.0),
}
#: What no name of the catalogue says; hours from -72 to 72.
OUTSIDE: dict[str, Callable[[Array, Array, Array, Array], Array]] = {
    "harmonic": lambda x, t, u, c: c * np.sin(6.0 * np.pi * x),
    "local_sine": lambda x, t, u, c: (
        c * np.sin(2 * np.pi * x / 0.15) * np.exp(-0.5 * ((x - 0.4) / 0.25) ** 2)
    ),
    "soft_saturation": lambda x, t, u, c: c * np.sign(x) * np.maximum(np.abs(x) - 0.7, 0.0) ** 2,
    "scale_swing": lambda x, t, u, c: c * x * np.sin(2 * np.pi * 144.0 * u / 7.0)[:, None],
    "bias_swing": lambda x, t, u, c: c * np.sin(2 * np.pi * 144.0 * u / 7.0)[:, None],
    "scale_jump": lambda x, t, u, c: c * x * (u[:, None] > 0.12),
    "slow_walk": lambda x, t, u, c: c * _slow(u),
    "scale_walk": lambda x, t, u, c: c * x * _slow(u),
    "shock": lambda x, t, u, c: (
        c * ((u > 0.1) * np.exp(-np.clip(144.0 * (u - 0.1) / 12.0, 0.0, 50.0)))[:, None]
    ),
}


def _slow(u: Array) -> Array:
    """(n, 3) of a random walk, always the same."""
    steps = np.random.default_rng(99).standard_normal((2001, 3)) / 2001**0.5
    course, grid = np.cumsum(steps, axis=0), np.linspace(-0.5, 0.5, 2001)
    return np.column_stack([np.interp(u, grid, one) for one in course.T])


def habits_of(rng: np.random.Generator) -> Array:
    habit = rng.standard_normal((HABITS, 3))
    return np.asarray(habit / np.linalg.norm(habit, axis=1, keepdims=True))


def world(
    rng: np.random.Generator, known: Array | None = None
) -> tuple[Array, Array, Array, Array]:
    """time (n,), direction (n, 3), temperature (n,), windows (n,). known : habits of the wrist"""
    time = np.sort(rng.uniform(0.0, SPAN, RUNS))
    habit = habits_of(rng) if known is None else known
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
        again = np.random.default_rng(seed)
        again.uniform(0.0, SPAN, RUNS)  # what `world` drew before the habits
        self.habits = habits_of(again)
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
        if tau:
            off += walk(time, tau, rng)
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
        return {**EFFECTS, **OUTSIDE}[self.effect](x, excess, u, self.size)

    def solved(self, request: ActigraphRequest) -> ActigraphResult:
        return calibrate(self.runs, self.scan, request, np.random.default_rng(0))

    def error(self, fit: Fit) -> float:
        """mg, mean | |a| - g | over the sphere at conditions of the recording, no noise."""
        rng = np.random.default_rng(1)
        x = rng.standard_normal((600, 3))
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        rows = rng.integers(0, RUNS, 600)
        reading = self.sensed(x, self.warm[rows], self.time[rows] / SPAN - 0.5)
        whole = Context(RUNS, covariates_of(self.runs, self.scan))
        got = fit.model.correct(fit.theta, reading[:, None], whole.take(rows))[:, 0]
        return float(np.mean(np.abs(np.linalg.norm(got, axis=1) - G))) / MG

    def anew(self, fit: Fit, k: int, *, same: bool) -> float:
        """mg, mean | |a| - g | on another recording of the same clean sensor, with its noise.

        same : with the habits and the temperatures of the first
        """
        rng = np.random.default_rng((k, 7))
        time, direction, warm, windows = world(rng, self.habits if same else None)
        warm = np.interp(time, self.time, self.warm) if same else warm
        off = SCATTER * rng.standard_normal((RUNS, 3))
        off += WINDOW * rng.standard_normal((RUNS, 3)) / np.sqrt(windows)[:, None]
        reading = self.sensed(direction, warm, time / SPAN - 0.5) + MG * off
        runs, scan = recording(time, reading, warm, windows)
        got = fit.model.correct(
            fit.theta, reading[:, None], Context(RUNS, covariates_of(runs, scan))
        )
        return float(np.mean(np.abs(np.linalg.norm(got[:, 0], axis=1) - G))) / MG

    def oracle_name(self) -> str:
        at = 0.57 * SPAN
        curved = {"converter": "converter@xyz", "dead_band": "converter@xyz"}
        return {"bias_step": f"bias_step@{at:.10g}s", **curved}.get(self.effect, self.effect)


def clean(count: int) -> None:
    total = claimed = wrong = followed = 0
    for noise in NOISES:
        names = []
        for seed in range(count):
            result = Case(noise, "", 0.0, 1000 + seed).solved(ActigraphRequest())
            loop = result.loop
            assert loop is not None
            followed += bool(loop.curves)
            if loop.named:
                gain = loop.difference.gain if loop.difference else np.nan
                names.append(f"{loop.named[0].effect} {loop.verdict} {gain:+.3f}")
                wrong += loop.verdict.startswith("explained")
        claimed, total = claimed + len(names), total + count
        print(f"{noise:12s} {len(names)} of {count}: {', '.join(names)}", flush=True)
    print(f"an effect claimed in {claimed} of {total}; explained {wrong}; "
          f"corrected without a name {followed}")  # fmt: skip


def planted(count: int, aims: tuple[float, ...] = (10.0, 15.0)) -> None:
    ratios, first, total, wrong = [], 0, 0, 0
    for effect in EFFECTS:
        for aim in aims:
            line, named, other = [], 0, []
            for noise in ("walk 10 min", "walk 2 h", "walk 12 h"):
                for seed in range(count):
                    case = Case(noise, effect, aim, 2000 + seed)
                    result = case.solved(ActigraphRequest())
                    told = case.solved(
                        ActigraphRequest(declare=(case.oracle_name(),), only=("scale_drift",))
                    )
                    assert result.loop is not None
                    assert told.loop is not None
                    step = result.loop.steps[:1]
                    names = [n.partition("@")[0] for s in step for n in (s.effect, *s.aliases)]
                    hit = case.oracle_name().partition("@")[0] in names
                    named += hit
                    other += [] if hit else [(names or ["-"])[0]]
                    before, after = case.error(result.base), case.error(result.final)
                    wrong += result.loop.verdict == "explained" and after > before
                    line.append((before, after, case.error(told.loop.base), len(result.loop.steps)))
            table = np.array(line)
            ratio = table[:, 1] / table[:, 2]
            ratios += list(ratio)
            first, total = first + named, total + len(line)
            print(f"{effect:18s} λ {aim:4.0f}: {named} of {len(line)} {other}; "
                  f"{table[:, 0].mean():.2f} -> {table[:, 1].mean():.2f} (oracle "
                  f"{table[:, 2].mean():.2f}), "
                  f"ratio {np.median(ratio):.2f}, 90 % {np.quantile(ratio, 0.9):.2f}, "
                  f"two {int((table[:, 3] > 1).sum())}", flush=True)  # fmt: skip
    print(f"first {first} of {total}; after / oracle {np.median(ratios):.2f}, 90 % "
          f"{np.quantile(ratios, 0.9):.2f}; explained and worse {wrong}")  # fmt: skip


def outside(count: int, aims: tuple[float, ...] = (30.0, 60.0)) -> None:
    """What a correction without a cause is worth: true error after over before."""
    for effect in OUTSIDE:
        for aim in aims:
            ratios, sure = list[float](), 0
            for noise in ("white", "walk 2 h"):
                for seed in range(count):
                    case = Case(noise, effect, aim, 7000 + seed)
                    result = case.solved(ActigraphRequest())
                    assert result.loop is not None
                    ratios.append(case.error(result.final) / case.error(result.base))
                    sure += any(s.certain and "@" not in s.effect for s in result.loop.steps)
            print(f"{effect:16s} λ {aim:4.0f}: after / before {np.median(ratios):.2f}, largest "
                  f"{max(ratios):.2f}; a name as certain {sure} of {len(ratios)}",
                  flush=True)  # fmt: skip


def junk(count: int) -> None:
    """What the held-out error says of three effects that are not there, and new recordings say."""
    told, new = np.zeros(count), np.zeros((count, 2))
    names = ("temperature_bias", "temperature_scale", "bias_drift", "scale_drift", "warm_up",
             "quadratic", "cubic", "asymmetry", "cross_axis")  # fmt: skip
    for n in range(count):
        case, rng = Case("white", "", 0.0, 4000 + n), np.random.default_rng((n, 3))
        some = tuple(str(name) for name in rng.choice(names, 3, replace=False))
        plain, full = (case.solved(ActigraphRequest(loop=False, declare=d)) for d in ((), some))
        told[n] = np.mean(full.base_held.size) / MG - np.mean(plain.base_held.size) / MG
        for j, same in enumerate((True, False)):
            pairs = [[case.anew(r.base, k, same=same) for r in (full, plain)] for k in range(10)]
            new[n, j] = float(np.mean([a - b for a, b in pairs]))
    draws = np.random.default_rng(0).integers(0, count, (2000, count))
    for j, habits in enumerate(("the same habits", "other habits")):
        low, high = np.quantile(told[draws].mean(1) / new[draws, j].mean(1), (0.025, 0.975))
        print(f"junk: held out {told.mean():+.4f} mg, on new recordings with {habits} "
              f"{new[:, j].mean():+.4f} mg; ratio {told.mean() / new[:, j].mean():.2f} "
              f"({low:.2f} to {high:.2f})")  # fmt: skip


if __name__ == "__main__":
    started = clock.process_time()
    {"clean": clean, "planted": planted, "outside": outside, "junk": junk}[sys.argv[1]](
        int(sys.argv[2])
    )
    print(f"{clock.process_time() - started:.0f} CPU s")
