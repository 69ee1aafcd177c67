"""What every calibrator hands to the reports and to the exit code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from imucalib.core.fit import Fit
from imucalib.errors import UNEXPLAINED_EXIT_CODE, LimitBroken, Undetermined
from imucalib.loop.found import FitLoop

Status = Literal["ok", "marginal", "weak", "failed"]


@dataclass(frozen=True)
class HeldOutError:
    """rms errors of one metric on data that was not fitted."""

    raw: float
    base: float
    final: float


@dataclass(frozen=True)
class ErrorSummary:
    """One metric before and after: raw reading, base model, final model, and the noise floor."""

    metric: str
    unit: str
    raw: float
    base: float
    final: float
    floor: float
    held_out: HeldOutError


@dataclass(frozen=True)
class Provenance:
    """Where the numbers come from; enough to compute them again."""

    path: str
    sha256: str
    samples: int
    gaps: int
    mapping: Mapping[str, object]
    settings: Mapping[str, object]
    seed: int
    versions: Mapping[str, str]
    time: str

    @property
    def footer(self) -> tuple[tuple[str, str], ...]:
        """What stands at the foot of every report."""
        return (
            ("input", f"{self.path}, sha256 {self.sha256[:16]}…"),
            ("seed", str(self.seed)),
            ("versions", ", ".join(f"{k} {v}" for k, v in self.versions.items())),
            ("time", self.time),
        )


@dataclass(frozen=True)
class Limit:
    """A limit that the user set, and the value that is held against it."""

    name: str
    value: float
    limit: float
    unit: str

    @property
    def broken(self) -> bool:
        return not self.value <= self.limit


@dataclass(frozen=True)
class Outcome:
    """A finished calibration: what was fitted, what the loop found, and how far to trust it.

    weak : the data leave parameters open, which stay near their nominal values
    """

    calibrator: str
    fit: Fit
    loop: FitLoop | None
    error: ErrorSummary
    provenance: Provenance
    reasons: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    undecided: tuple[str, ...] = ()
    limits: tuple[Limit, ...] = ()
    notes: tuple[str, ...] = field(default_factory=tuple)
    weak: bool = False

    @property
    def unexplained(self) -> bool:
        loop = self.loop
        open_end = loop is not None and (loop.unexplained or loop.curves or loop.suspected)
        return bool(self.undecided) or bool(open_end)

    @property
    def status(self) -> Status:
        if not self.fit.converged or any(limit.broken for limit in self.limits):
            return "failed"
        if self.weak:
            return "weak"
        return "marginal" if self.unexplained or self.reasons else "ok"

    @property
    def exit_code(self) -> int:
        """0 calibrated and consistent, 1 a limit is broken, 4 the data leave parameters open, 5 the
        residual is not explained."""
        if any(limit.broken for limit in self.limits):
            return LimitBroken.exit_code
        if self.weak:
            return Undetermined.exit_code
        return UNEXPLAINED_EXIT_CODE if self.unexplained else 0
