"""One trial: what was planted, what the loop said, and what came of the calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.calibration.uncertainty import correcting
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.core.balance import whitener
from imucalib.core.context import Context
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.loop.found import FitLoop
from imucalib.units import MG

Array = NDArray[np.float64]

BASE = ("bias", "scale")  # effects whose intervals are counted


@dataclass(frozen=True)
class Job:
    """What to simulate. effects : (name, size in typical sizes); outside : the same for effects
    that no catalogue holds; noise : kind; fault : of a record or a label; layout : of a bench;
    junk : effects that are declared and are not there"""

    calibrator: str
    scenario: str
    seed: int
    effects: tuple[tuple[str, float], ...] = ()
    outside: tuple[str, float] | None = None
    noise: str = "gaussian"
    fault: str = ""
    layout: str = ""
    junk: tuple[str, ...] = ()


@dataclass(frozen=True)
class Trial:
    """What came of a job.

    strength : λ of each planted effect; apart : λ times the sine of its angle to its nearest alias
    sets : of each accepted effect, itself and its aliases; certain : those that are stated so;
        unexplained : (kind, driver)
    before, after, oracle : true error of the base calibration, of the final one and of one that
        knows the planted effects; covered : of `intervals` 95 % intervals
    refused : the error that the command stopped with, if it did
    names : of every step, itself and its aliases, in full
    alike : what is told to do as well as noise that neighbours share, or to be refused
    told : change of the error that is reported as held out; new : the same on data made anew
    """

    job: Job
    verdict: str = ""
    sets: tuple[tuple[str, ...], ...] = ()
    certain: tuple[str, ...] = ()
    records: tuple[str, ...] = ()
    unexplained: tuple[tuple[str, str], ...] = ()
    strength: tuple[float, ...] = ()
    absorbed: tuple[str, ...] = ()
    before: float = 0.0
    after: float = 0.0
    oracle: float = 0.0
    covered: int = 0
    intervals: int = 0
    seconds: float = 0.0
    refused: str = ""
    names: tuple[str, ...] = ()
    told: float = 0.0
    new: float = 0.0
    alike: tuple[str, ...] = ()

    @property
    def alarm(self) -> bool:
        """Anything at all was said to be missing or wrong."""
        return bool(self.sets or self.records or self.unexplained or self.refused)

    @property
    def named(self) -> bool:
        """A single effect was stated as certain, and the residual as explained."""
        return self.verdict == "explained" and bool(self.certain)

    @property
    def first(self) -> bool:
        """Every planted effect is the first of a set."""
        chosen = {s[0] for s in self.sets}
        return all(name in chosen for name, _ in self.job.effects)

    @property
    def within(self) -> bool:
        """Every planted effect is in a set."""
        every = {name for s in self.sets for name in s}
        return all(name in every for name, _ in self.job.effects)

    @property
    def wrong(self) -> bool:
        """An effect that was not planted is stated as certain."""
        planted = {name for name, _ in self.job.effects}
        return self.verdict == "explained" and bool(set(self.certain) - planted)


def said(trial: Trial, loop: FitLoop | MotionLoop) -> Trial:
    """The trial with what the loop said; members of scans by the scan's name."""

    def plain(name: str) -> str:
        return name.partition("@")[0]

    sets = tuple(tuple(dict.fromkeys(plain(n) for n in (s.effect, *s.aliases))) for s in loop.steps)
    return replace(
        trial,
        verdict=loop.verdict,
        sets=sets,
        certain=tuple(plain(s.effect) for s in loop.steps if s.certain),
        records=tuple(f"{r.row}:{r.channel}" for r in getattr(loop, "records", ())),
        unexplained=(
            *((u.kind, u.driver) for u in loop.unexplained),
            *(("curve", _against(s.effect)) for s in getattr(loop, "curves", ())),
        ),
        absorbed=tuple(plain(s.name) for s in loop.first_scores if s.absorbed),
        alike=tuple(dict.fromkeys(plain(n) for u in loop.unexplained for n in u.alike)),
    )


def _against(curve: str) -> str:
    """The driver of "curve@bias:tool_face:..." or "curve of ... against |a|" as probes call it."""
    if not curve.startswith("curve@"):
        return curve.rpartition(" against ")[2]
    return curve.split(":")[1].replace("_", "-")


def strengths(oracle: Fit, planted: dict[str, Array]) -> tuple[float, ...]:
    """λ of each planted effect: its columns times its true size, beside all else that is fitted,
    in units of the noise."""
    white = whitener(oracle.at.settings, oracle.noise.ratio)
    slices = oracle.model.slices(oracle.observations.context)
    mine = [k for name in planted for k in range(slices[name].start, slices[name].stop)]
    others = np.setdiff1d(np.arange(oracle.theta.size), mine)
    basis = np.linalg.qr(white(oracle.at.jacobian[:, others]))[0]
    found = []
    for name, theta in planted.items():
        column = white((oracle.at.jacobian[:, slices[name]] @ theta)[:, None])[:, 0]
        rest = column - basis @ (basis.T @ column)
        found.append(float(np.linalg.norm(rest)) / oracle.noise.factor)
    return tuple(found)


def coverage(fit: Fit, truth: dict[str, Array]) -> tuple[int, int]:
    """95 % intervals of the base model's parameters that hold the truth, of how many."""
    slices, hits, count = fit.model.slices(fit.observations.context), 0, 0
    for name in BASE:
        for k, value in zip(range(slices[name].start, slices[name].stop), truth[name], strict=True):
            half = fit.half_width(np.eye(fit.theta.size)[k])
            hits += bool(abs(fit.theta[k] - value) <= half)
            count += 1
    return hits, count


def corrected(fit: Fit, reading: Array, context: Context) -> Array:
    """Readings (n, 3) that were never recorded, corrected by a fit, in m/s²."""
    model: Model = correcting(fit.model)
    slices = fit.model.slices(fit.observations.context)
    parts = [fit.theta[slices[name]] for name in model.names]
    theta = np.concatenate(parts) if parts else np.zeros(0)
    return model.correct(theta, reading[:, None], context)[:, 0]


def vector_error(fit: Fit, reading: Array, force: Array, context: Context) -> float:
    """mg rms, of the vector."""
    away = corrected(fit, reading, context) - force
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1)))) / MG


def norm_error(fit: Fit, reading: Array, force: Array, context: Context) -> float:
    """mg rms, of the norm: all that gravity alone can determine."""
    size = np.linalg.norm(corrected(fit, reading, context), axis=1)
    return float(np.sqrt(np.mean((size - np.linalg.norm(force, axis=1)) ** 2))) / MG


def noise(kind: str, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Unit-variance noise along the first axis: gaussian, t4, ar (ρ = 0.5)."""
    white = rng.standard_normal(shape)
    if kind == "t4":
        return np.asarray(rng.standard_t(4, shape) / np.sqrt(2.0))
    if kind == "ar":
        from scipy.signal import lfilter

        start = 0.5 * rng.standard_normal((1, *shape[1:]))
        return np.asarray(lfilter([np.sqrt(0.75)], [1.0, -0.5], white, axis=0, zi=start)[0])
    return white
