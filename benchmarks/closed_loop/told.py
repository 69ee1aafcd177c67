"""All that the benchmark reads of what the program writes: report.json, and the calibration at
readings that were never recorded. When the report's keys change, this file does."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Parts of names of steps that are a function or noise without a cause: neither right nor wrong.
NAMELESS = re.compile(
    r"^(curve|shape|follows|third_degree|converter|cycle|scale_cycle|session|posture|wandering|"
    r"unlisted)|_root_of_|_over_"
)
#: Effects of a calibration that undo a course of time.
_COURSE = re.compile(r"^(follows|wandering)|^(curve|shape)@.*:(time|order|record):")
_UNIT = 9.80665e-3  # m/s2, a mg
#: Verdicts that say that something is missing, whether or not a name is given.
MISSING = ("unexplained", "explained", "explained in part")


@dataclass(frozen=True)
class Step:
    """One thing that is said to be missing. names : itself and all that could stand in its place;
    probability : of the first name, where it is stated"""

    names: tuple[str, ...]
    certain: bool
    probability: float | None

    @property
    def named(self) -> bool:
        """Whether it has a cause."""
        return NAMELESS.search(self.names[0]) is None


@dataclass(frozen=True)
class Told:
    """verdict : of the search; lines : what the user has to decide; exit_code : of the report
    nothing : stated probability that nothing is missing, None where it is not stated"""

    verdict: str
    steps: tuple[Step, ...]
    lines: tuple[str, ...]
    exit_code: int
    nothing: float | None = None

    @property
    def claims(self) -> bool:
        """Something is said to be missing from the model."""
        return bool(self.steps) or self.verdict in MISSING

    @property
    def names(self) -> bool:
        """A cause is told, as certain or not."""
        return any(s.named for s in self.steps)


def read_report(folder: Path) -> Told:
    """What report.json says. Raises FileNotFoundError where the command wrote none."""
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    loop = report.get("loop") or {}
    steps = tuple(
        Step(
            names=tuple(dict.fromkeys(_plain(n) for n in (s["effect"], *s.get("aliases", ())))),
            certain=bool(s.get("certain")),
            probability=s.get("probability"),
        )
        for s in loop.get("steps", ())
    )
    lines = tuple(str(line) for line in report.get("undecided") or ())
    nothing = loop.get("p_nothing_missing")
    return Told(str(loop.get("verdict", "")), steps, lines, int(report["exit_code"]), nothing)


def _plain(name: str) -> str:
    """A member of a scan by the scan's name."""
    return name.partition("@")[0]


def follows(folder: Path) -> bool:
    """Whether the calibration undoes a course of time, be it drawn or a walk."""
    import imucalib

    effects = {p.effect for p in imucalib.load(folder / "calibration.yaml").parameters}
    return any(_COURSE.search(name) for name in effects)


def corrected(folder: Path, reading: Array, known: dict[str, Array]) -> tuple[Array, Array]:
    """(n, 3) mg, readings (n, 3) mg corrected under what is known beside them, by name and in SI;
    and (n, 3, 3) mg2, their covariance by that of the parameters. What is not known stands where
    the program puts it. Infinite and without a spread where the correction has no inverse."""
    import imucalib
    from imucalib.core.effect import Context
    from imucalib.errors import NotConverged

    calibration = imucalib.load(folder / "calibration.yaml")
    names = set(calibration.valid)
    rest = calibration.context(len(reading)).covariates
    context = Context(len(reading), {**rest, **{n: v for n, v in known.items() if n in names}})

    def at(values: Array) -> Array:
        moved = tuple(
            replace(p, value=float(v)) for p, v in zip(calibration.parameters, values, strict=True)
        )
        done = replace(calibration, parameters=moved).apply(_UNIT * reading, context, unit="m/s2")
        return np.asarray(done) / _UNIT

    value = np.array([p.value for p in calibration.parameters])
    sd = np.sqrt(np.maximum(np.diag(calibration.covariance), 0.0))
    slope = np.zeros((*reading.shape, value.size))
    try:
        for k in np.flatnonzero(sd > 0.0):
            step = 0.1 * sd[k] * np.eye(value.size)[k]
            slope[..., k] = (at(value + step) - at(value - step)) / (0.2 * sd[k])
        best = at(value)
    except NotConverged:
        return np.full(reading.shape, np.inf), np.zeros((*reading.shape, 3))
    return best, np.einsum("nik,kl,njl->nij", slope, calibration.covariance, slope)


def read_corrected(path: Path) -> Array:
    """(n, 3) mg of a recording that `imucal apply` wrote as CSV."""
    rows = [line for line in path.read_text(encoding="utf-8").splitlines() if line[:1] != "#"]
    at = [k for k, name in enumerate(rows[0].split(",")) if "acceleration/" in name]
    values = np.loadtxt(rows[1:], delimiter=",", usecols=at)
    return np.asarray(values / _UNIT)
