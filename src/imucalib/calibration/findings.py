"""What a search found, as reports, JSON and tables take it: the same for every calibrator."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

from imucalib.calibration.calibration import StoredParameter, stored_parameters
from imucalib.calibration.power import hidden
from imucalib.core.fit import Fit
from imucalib.data import Data
from imucalib.effects import known
from imucalib.posterior.closed_loop.found import FitLoop, Score, Step, Unexplained
from imucalib.posterior.held_out import Difference
from imucalib.posterior.record_errors import RecordError
from imucalib.significant_digits import plus_minus
from imucalib.units import MG


@dataclass(frozen=True)
class CheckedError:
    """An error before and after a step; digits : how many decimals it is worth."""

    metric: str
    unit: str
    before: float
    after: float
    digits: int = 2


@dataclass(frozen=True)
class FoundStep:
    """One accepted effect.

    size : in words where there are many parameters; checks : errors that the choice has seen or
    not, as their metric says; held_out : nats that data gain which did not estimate it; curve :
    what a correction without a name corrects, in words, or empty; formula : of a form that has no
    cause, in words, or empty; certain : nothing else would do, and held-out data prove it
    probability : that it is there; rivals : (effect, share) of all that may stand in its place
    """

    effect: str
    evidence: float
    checks: tuple[CheckedError, ...]
    aliases: tuple[str, ...]
    parameters: tuple[StoredParameter, ...] = ()
    size: str = ""
    held_out: tuple[float, ...] = ()
    curve: str = ""
    formula: str = ""
    certain: bool = False
    probability: float = math.nan
    rivals: tuple[tuple[str, float], ...] = ()


class Untestable(Data):
    """An effect that these data cannot show."""

    effect: str
    typical: Annotated[str, "Its typical size."]
    shift: Annotated[float, "What that does to the answer."]
    unit: str


class Gain(Data):
    """What data that took no part in any choice say."""

    before: float
    after: float
    low: Annotated[float, "Of the 95 % interval of what was gained."]
    high: float
    proved: Annotated[bool, "Whether the gain is beyond chance."]
    unit: str
    nats: Annotated[float, "Gain of their log density; null where it was not judged."] = math.nan
    nats_low: Annotated[float, "Its lower 95 % edge."] = math.nan

    @property
    def dense(self) -> str:
        """How much likelier held-out data are after, to end a sentence, where it was judged."""
        if math.isnan(self.nats):
            return ""
        whole, least = (f"{math.exp(min(n, 20.0)):.2g}" for n in (self.nats, self.nats_low))
        more = "more than " if self.nats > 20.0 else ""
        return f"; likelier by a factor of {more}{whole}, at least {least}"


def _gain_of(found: Difference | None) -> Gain | None:
    """A difference in m/s² as one in mg."""
    if found is None:
        return None
    sizes = {n: getattr(found, n) / MG for n in ("before", "after", "low", "high")}
    dense = {"nats": found.nats, "nats_low": found.nats_low}
    return Gain(**sizes, **dense, proved=found.proved, unit="mg")


@dataclass(frozen=True)
class Findings:
    """A finished search.

    verdict : "nothing missing", "explained", "explained in part", "suspected", "unexplained", or
        "not run"; gain : what held-out data say of the steps, or of those that they refused
    declared : effects of the base model beyond the usual ones, with their size in words
    only, without : how the user limited the search; missing : why effects were not tested
    facts : name and words of what else it estimated
    complete : probability that nothing is missing; NaN where nothing was searched for
    """

    verdict: str
    steps: tuple[FoundStep, ...] = ()
    records: tuple[RecordError, ...] = ()
    rejected: tuple[tuple[str, str], ...] = ()
    refuted: tuple[str, ...] = ()
    unexplained: tuple[Unexplained, ...] = ()
    scores: tuple[Score, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)
    not_testable: tuple[Untestable, ...] = ()
    declared: tuple[tuple[str, str], ...] = ()
    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()
    gain: Gain | None = None
    complete: float = math.nan

    @property
    def open(self) -> bool:
        """Whether structure without a proved name was found, corrected or not."""
        curved = any(step.curve for step in self.steps)
        return bool(self.unexplained) or curved or self.verdict == "suspected"


def findings_of(
    loop: FitLoop,
    *,
    declared: Sequence[str] = (),
    only: tuple[str, ...] = (),
    without: tuple[str, ...] = (),
) -> Findings:
    """The shared loop's search."""
    facts, walk = [], loop.drift  # the walk that the noise holds
    if walk is not None and (walk.counts or walk.followed):
        what = "which the calibration follows" if walk.followed else "which nothing follows"
        facts.append(("noise", f"{walk.words}, {what}"))
    return Findings(
        verdict=loop.verdict,
        steps=tuple(_step(step, loop) for step in loop.steps),
        records=loop.records,
        rejected=loop.rejected,
        refuted=loop.refuted,
        unexplained=loop.unexplained,
        scores=loop.scores,
        missing=loop.missing,
        gain=_gain_of(loop.difference),
        complete=loop.complete,
        facts=tuple(facts),
        declared=tuple((name, _size(loop.final, name)) for name in declared),
        only=only,
        without=without,
        not_testable=tuple(
            Untestable(h.name, "a typical size", h.size / MG, "mg rms")
            for h in hidden(loop.scores, loop.final.model.names)
            if h.absorbed
        ),
    )


def bent(curve: str) -> str:
    """What a curve bends, and against what: a scan's own name where it bends no driver.

    curve : name of the effect
    """
    family, _, value = curve.partition("@")
    what, *against = value.split(":")
    return f"{what} against {against[0]}".replace("_", "-") if against else f"a {family}'s offset"


def _step(step: Step, loop: FitLoop) -> FoundStep:
    before, after = step.checked[0].before, step.checked[0].after
    form = known(step.effect) if step.formed else None
    return FoundStep(
        effect=step.effect,
        evidence=step.evidence,
        checks=(CheckedError("held-out error, rms", "mg", before / MG, after / MG),),
        aliases=step.aliases,
        parameters=tuple(p for p in stored_parameters(loop.final) if p.effect == step.effect),
        curve=bent(step.effect) if step.curve else "",
        formula=f"{form.sentence.rstrip('.')}, {form.equation}" if form else "",
        certain=step.certain and not loop.suspected,
        probability=step.probability,
        rivals=step.rivals,
    )


def _size(fit: Fit, name: str) -> str:
    own = [p for p in stored_parameters(fit) if p.effect == name]
    return ", ".join(plus_minus(p.value, p.sd, p.unit) for p in own[:3])
