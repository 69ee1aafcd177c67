"""What the closed loop is asked for, and what it found."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Generic, Literal, TypeVar

from imucalib.core.fit import Fit, StoredParameter
from imucalib.data import Data
from imucalib.posterior.closed_loop.separation import Ambiguity
from imucalib.posterior.closed_loop.sums import Sums
from imucalib.posterior.held_out import Difference
from imucalib.posterior.odds import ABSORBED, CERTAIN, CLEAR
from imucalib.posterior.record_errors import RecordError
from imucalib.posterior.sheet.sheet import Fault

Kind = Literal["effect", "probe"]
S = TypeVar("S")


@dataclass(frozen=True)
class Rival:
    """One of the models that would do; weight : of all of them together, 1. The fit is that of the
    linear problem: its θ and their covariance, and the rest as in the base model's."""

    names: tuple[str, ...]
    weight: float
    fit: Fit


class Score(Data):
    """What the data say of a component."""

    name: str
    kind: Annotated[Kind, "Whether it names a cause."]
    driver: Annotated[str, "What it follows, in words, or empty."]
    evidence_nats: Annotated[float, "In favour, beside the base model alone."]
    probability: Annotated[float, "That it is there."]
    left: Annotated[float, "Share that the fitted parameters do not absorb."]
    lambda_at_typical_size: Annotated[float, "4.7 gives an 80 % chance of detection."]
    size_m_per_s2: Annotated[float, "What its typical size does to a reading, rms."] = 0.0

    @property
    def absorbed(self) -> bool:
        return self.left < ABSORBED


class CheckedError(Data):
    """An error before and after a step."""

    metric: str
    unit: str
    before: float
    after: float
    digits: Annotated[int, "Decimals that it is worth."] = 2


class Share(Data):
    """An effect that may stand in the place of another."""

    effect: str
    share: float


class Step(Data, kw_only=True):
    """An effect that was found."""

    effect: str
    size: Annotated[str, "In words, where there are many parameters."] = ""
    probability: Annotated[float, "That it is there."] = math.nan
    in_its_place: Annotated[tuple[Share, ...], "Itself among them."] = ()
    evidence_nats: float
    held_out_nats: tuple[float, ...] = ()
    checks: tuple[CheckedError, ...] = ()
    aliases: Annotated[tuple[str, ...], "Effects that the data cannot tell it from."] = ()
    certain: Annotated[bool, "Nothing else would do as well, and chance would not."] = False
    curve: Annotated[str, "What a correction without a name bends, in words, or empty."] = ""
    formula: Annotated[str, "Of a form that has no cause, in words; empty for others."] = ""
    parameters: tuple[StoredParameter, ...] = ()


class Unexplained(Data):
    """Structure that no effect carries."""

    name: str
    driver: str
    kind: str
    probability: float
    evidence_nats: float
    rivals: Annotated[tuple[str, ...], "Effects that would explain it, and were not accepted."] = ()


@dataclass(frozen=True)
class BiasWalk:
    """The walk of the bias that the noise holds beside the final model.

    size : mg, rms of what it does to |a|; hours : after which it forgets
    scatter : mg, of a run without it; evidence : nats that it gains over independent noise
    sd : mg, of the bias of one axis about its mean; followed : whether the calibration undoes it
    """

    size: float
    hours: float
    scatter: float
    evidence: float
    sd: float = 0.0
    followed: bool = False

    @property
    def counts(self) -> bool:
        """Whether it is there beyond doubt."""
        return self.evidence > CLEAR

    @property
    def words(self) -> str:
        if self.size == 0.0:
            return "the bias does not drift"
        return f"the bias drifts by {self.size:.2g} mg in {self.hours:.2g} h"


@dataclass(frozen=True)
class Loop(Generic[S]):
    """The whole search, from the fitted base to the fitted final model.

    records : that do not belong to the rest; scores, first_scores : of the last search, and of the
        last one before any step; missing : why effects could not be tested
    refuted : of what was rejected, steps that were taken and put back, since data that took no part
        in the whole search refuse them
    unexplained : structure that no effect carries, also where a curve corrects it
    difference : of the errors on data that took no part in the whole search, before and after
    drift : of the noise; complete : probability that nothing is missing
    open_size : m/s², rms, by how much what is suspected or without a name changes a reading
    """

    base: S
    final: S
    records: tuple[RecordError, ...] = ()
    steps: tuple[Step, ...] = ()
    rejected: tuple[tuple[str, str], ...] = ()
    refuted: tuple[str, ...] = ()
    unexplained: tuple[Unexplained, ...] = ()
    scores: tuple[Score, ...] = ()
    first_scores: tuple[Score, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)
    difference: Difference | None = None
    drift: BiasWalk | None = None
    complete: float = math.nan
    open_size: float = 0.0

    @property
    def alternatives(self) -> tuple[tuple[str, ...], ...]:
        """Of each step, its effect and those that the data cannot tell it from."""
        return tuple((step.effect, *step.aliases) for step in self.steps)

    @property
    def named(self) -> tuple[Step, ...]:
        """Steps that name a cause."""
        return tuple(step for step in self.steps if not step.curve)

    @property
    def curves(self) -> tuple[Step, ...]:
        """Steps that correct structure without a name."""
        return tuple(step for step in self.steps if step.curve)

    @property
    def suspected(self) -> bool:
        """Whether a cause is named that held-out data have not proved."""
        unproved = self.difference is not None and not self.difference.proved
        return bool(self.named) and unproved

    @property
    def beyond_doubt(self) -> bool:
        """Whether a cause is named, or every record that stands alone is wrong beyond doubt: the
        others predict it, so that it is held out itself."""
        return bool(self.named) or all(r.probability > CERTAIN for r in self.records)

    @property
    def verdict(self) -> str:
        """ "explained" needs held-out data that prove the gain; without, it is "suspected"."""
        open_end = bool(self.unexplained or self.curves)
        if self.suspected:
            return "suspected"
        if self.named or self.records:
            return (
                "explained in part"
                if open_end
                else "explained"
                if self.beyond_doubt
                else "suspected"
            )
        return "unexplained" if open_end else "nothing missing"


@dataclass(frozen=True, kw_only=True)
class FitLoop(Loop[Fit]):
    """The search over observations: records are free in base and final once they are set aside.

    plain, as_recorded : the base and the final model with every record taken as it stands
    ambiguous : what names left open, where the search keeps its own products
    sums : what the data say of every effect beside the base model, where the search keeps that
    slips : of hand, in the table, each with the line that mends it
    weighed : the models that would do, with their weights
    """

    plain: Fit
    as_recorded: Fit
    ambiguous: tuple[Ambiguity, ...] = ()
    sums: Sums | None = None
    slips: tuple[Fault, ...] = ()
    weighed: tuple[Rival, ...] = ()
