"""What every calibrator hands out: a finished run, from which all else is made."""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from imucalib import __version__
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.findings import Findings
from imucalib.core.fit import Fit
from imucalib.data import Data
from imucalib.errors import UNEXPLAINED_EXIT_CODE, LimitBroken, Undetermined
from imucalib.posterior.closed_loop.found import FitLoop
from imucalib.question import Question
from imucalib.recording.identity import NAMELESS, Identity
from imucalib.recording.recording import CORRECTED
from imucalib.units import MG

Status = Literal["ok", "marginal", "weak", "failed"]
#: What a run that is otherwise consistent may be made to fail on: a name that held-out data do not
#: prove, structure without a name, anything that the headline warns of.
Gate = Literal["suspected", "unexplained", "caution"]


#: The step that a run which wrote nothing is told.
KEEP = "Write the calibration to use it"
#: Why a calibration is marginal of which nothing else says why: a name that held-out data do not
#: prove, or none.
UNPROVED_NAME = "held-out data do not prove what was found"
NO_NAME = "what stays has no name yet"
_CORRECTED = (
    "the recording was corrected already: this is no calibration of the sensor's own readings"
)


class Provenance(Data, kw_only=True):
    """Where the numbers come from; enough to compute them again."""

    input: str
    sha256: str
    inputs_sha256: Annotated[tuple[str, ...] | None, "Of each file, where it is several."] = None
    samples: int
    gaps: int
    mapping: Annotated[Mapping[str, Any], "How it was read."]
    settings: Mapping[str, Any]
    command: Annotated[str, "That was typed."]
    seed: int
    versions: Mapping[str, str]
    time: str

    @property
    def footer(self) -> tuple[tuple[str, str], ...]:
        """What is at the foot of every report."""
        return (
            ("input", f"{self.input}, sha256 {self.sha256[:16]}…"),
            *((("command", self.command),) if self.command else ()),
            ("seed", str(self.seed)),
            ("versions", ", ".join(f"{k} {v}" for k, v in self.versions.items())),
            ("time", self.time),
        )


class HeldOutError(Data):
    """Errors of one metric on data that was not fitted; NaN where there is none."""

    raw: float
    base: float
    final: float


class ErrorSummary(Data):
    """One metric before and after; NaN what does not exist."""

    metric: str
    unit: str
    raw: float
    base: Annotated[float, "Of the base model, fitted."]
    final: Annotated[float, "Of the final model, fitted."]
    floor: Annotated[float, "What the noise alone would leave."]
    held_out: HeldOutError


class Limit(Data):
    """A limit that was set, and the value that is held against it."""

    name: str
    value: float
    limit: float
    unit: str
    broken: bool = field(init=False)

    def __post_init__(self) -> None:
        # A value that does not exist (NaN) passes no limit.
        object.__setattr__(self, "broken", not self.value <= self.limit)

    @property
    def sentence(self) -> str:
        """A broken limit in words."""
        if math.isnan(self.value):
            return f"{self.name}: there is no value to hold against {self.limit:g} {self.unit}"
        return f"{self.name}: {self.value:.3g} {self.unit} exceeds {self.limit:g}"


class Left(Data):
    """What is left unexplained of one thing, in the user's terms, and how much is accepted."""

    name: str
    value: float
    accepted: float
    unit: str
    beyond: bool = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "beyond", self.value > self.accepted)

    @property
    def sentence(self) -> str:
        more = "more than" if self.beyond else "within"
        return f"{self.name}: {self.value:.3g} {self.unit}, {more} the {self.accepted:.3g} accepted"


def list_open(loop: FitLoop | None, error: ErrorSummary) -> tuple[Left, ...]:
    """By how much what a search leaves open changes a corrected reading, rms, against what the
    calibration is good to: the error (mg) on held-out data, of the fit where nothing was held out.
    Nothing where all is settled."""
    if loop is None or not loop.open_size:
        return ()
    good_to = error.final if math.isnan(error.held_out.final) else error.held_out.final
    return (Left("what stays open in a reading", loop.open_size / MG, good_to, error.unit),)


@dataclass(frozen=True)
class Outcome:
    """How a calibration went: what the search found, and how far to trust the result.

    errors : the principal metric first; findings : None where nothing was searched for
    fit : by least squares, where it is one
    undecided : what only the user can decide; weak : the data leave parameters open, which stay
    near their nominal values
    left : sizes of what is not explained, and what of each is accepted
    fail_on : what more than that ends with the code of the unexplained
    sensor : whose readings they are
    """

    calibrator: str
    errors: tuple[ErrorSummary, ...]
    provenance: Provenance
    findings: Findings | None = None
    fit: Fit | None = None
    reasons: tuple[str, ...] = ()
    advice: tuple[str | Question, ...] = ()
    undecided: tuple[Question, ...] = ()
    limits: tuple[Limit, ...] = ()
    notes: tuple[str, ...] = ()
    weak: bool = False
    left: tuple[Left, ...] = ()
    fail_on: Gate | None = None
    sensor: Identity = NAMELESS

    def __post_init__(self) -> None:
        if self.corrected and _CORRECTED not in self.reasons:
            object.__setattr__(self, "reasons", (_CORRECTED, *self.reasons))

    @property
    def corrected(self) -> bool:
        """Whether the readings were corrected by a calibration before."""
        return any(CORRECTED in note for note in self.notes)

    @property
    def error(self) -> ErrorSummary:
        """The principal metric."""
        return self.errors[0]

    @property
    def unexplained(self) -> bool:
        """Whether an open question changes the numbers by more than is accepted."""
        return bool(self.undecided) or any(one.beyond for one in self.left)

    @property
    def broken(self) -> tuple[str, ...]:
        """Broken limits in words."""
        return tuple(limit.sentence for limit in self.limits if limit.broken)

    @property
    def status(self) -> Status:
        if self.broken or (self.fit is not None and not self.fit.converged):
            return "failed"
        if self.weak:
            return "weak"
        unsized = bool(self.findings and self.findings.open and not self.left)
        return "marginal" if self.unexplained or self.reasons or unsized else "ok"

    @property
    def exit_code(self) -> int:
        """0 calibrated and consistent, 1 a limit is broken, 4 the data leave parameters open, 5 an
        open question changes the numbers, or what `fail_on` names is there."""
        if self.broken:
            return LimitBroken.exit_code
        if self.weak:
            return Undetermined.exit_code
        return UNEXPLAINED_EXIT_CODE if self.unexplained or self.gate_reason else 0

    @property
    def gate_reason(self) -> str:
        """What `fail_on` names and is there, in words, or empty. Where nothing was searched for,
        nobody knows that it is not."""
        found = self.findings or Findings("not run")
        gates = {
            "suspected": (found.verdict == "suspected", "a name is not proved"),
            "unexplained": (found.open, "structure has no proved name"),
            "caution": (self.status != "ok", "the result is cautioned"),
        }
        if self.fail_on is None:
            return ""
        there, says = gates[self.fail_on]
        if found.verdict == "not run":
            says = "what the model lacks was not searched for"
        elif not there:
            return ""
        return f"--fail-on {self.fail_on}: {says}"


@dataclass(frozen=True, kw_only=True)
class Run:
    """A finished run: reports, files, exports, tables and the exit code need no more.

    calibration : made once, when the run was; details : blocks of report.json that only this
    calibrator has
    """

    outcome: Outcome
    calibration: Calibration
    details: Data | Mapping[str, Any] = field(default_factory=dict)


def provenance_of(
    *,
    path: str,
    sha256: str,
    samples: int,
    mapping: Mapping[str, object],
    settings: Mapping[str, object],
    seed: int = 0,
    gaps: int = 0,
    command: str = "",
    parts: tuple[str, ...] = (),
) -> Provenance:
    """The provenance of a run that ends now, on this machine.

    path, sha256 : of the input; parts : sha256 of each file, where it is several
    mapping : how it was read; command : the line that was typed, or empty
    """
    import scipy

    versions = {
        "imucalib": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }
    return Provenance(
        input=Path(path).name,
        sha256=sha256,
        inputs_sha256=parts or None,
        samples=samples,
        gaps=gaps,
        mapping=mapping,
        settings=settings,
        seed=seed,
        versions=versions,
        time=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        command=command,
    )
