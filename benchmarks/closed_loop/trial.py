"""One trial of the array: what was planted, what the loop said, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.calibrators.array.motion.closed_loop import MotionLoop

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Job:
    """What to simulate. effects : (name, size in typical sizes); outside : the same for effects
    that no catalogue holds; noise : kind"""

    calibrator: str
    scenario: str
    seed: int
    effects: tuple[tuple[str, float], ...] = ()
    outside: tuple[str, float] | None = None
    noise: str = "gaussian"


@dataclass(frozen=True)
class Trial:
    """What came of a job.

    strength : λ of each planted effect; apart : λ times the sine of its angle to its nearest alias
    sets : of each accepted effect, itself and its aliases; certain : those that are stated so;
        unexplained : (kind, driver)
    before, after, oracle : true error of the base calibration, of the final one and of one that
        knows the planted effects; covered : of `intervals` 95 % intervals
    refused : the error that the command stopped with, if it did
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


def said(trial: Trial, loop: MotionLoop) -> Trial:
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
    )


def _against(curve: str) -> str:
    """The driver of "curve@bias:tool_face:..." or "curve of ... against |a|" as probes call it."""
    if not curve.startswith("curve@"):
        return curve.rpartition(" against ")[2]
    return curve.split(":")[1].replace("_", "-")


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
