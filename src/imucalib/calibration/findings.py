"""What a search found, and what it could not have found, being absorbed by what is fitted or too
weak: as reports, JSON and tables take it, the same for every calibrator."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

from imucalib.calibration.calibration import stored_parameters
from imucalib.core.fit import Fit, StoredParameter
from imucalib.data import Data
from imucalib.effects import known
from imucalib.effects.forms import in_words
from imucalib.posterior.closed_loop.found import FitLoop, Loop, Score, Step, Unexplained
from imucalib.posterior.held_out import Difference
from imucalib.posterior.record_errors import RecordError
from imucalib.significant_digits import plus_minus
from imucalib.units import MG

#: λ that gives an 80 % chance of detection.
_SEEN = 4.7
#: m/s²; effects that do less to a reading are nobody's concern.
_LEAST = 0.1 * MG
#: What a loop says in the words of every calibrator.
_OF_LOOP = ("verdict", "records", "rejected", "refuted", "unexplained", "scores", "missing")


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
    steps: tuple[Step, ...] = ()
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
    loop: Loop[Any], parameters: Callable[[Step], Iterable[StoredParameter]], **stated: Any
) -> Findings:
    """What a loop found. parameters : of a step; stated : what the loop itself does not say"""
    steps = tuple(
        replace(
            step,
            parameters=tuple(parameters(step)),
            certain=step.certain and not loop.suspected,
        )
        for step in loop.steps
    )
    own = {name: getattr(loop, name) for name in _OF_LOOP}
    return Findings(**{**own, "steps": steps, "complete": loop.complete, **stated})


def findings_of_fit(
    loop: FitLoop,
    *,
    declared: Sequence[str] = (),
    only: tuple[str, ...] = (),
    without: tuple[str, ...] = (),
) -> Findings:
    """What the loop of a fit found, with its parameters."""
    facts, walk = [], loop.drift  # the walk that the noise holds
    if walk is not None and (walk.counts or walk.followed):
        what = "which the calibration follows" if walk.followed else "which nothing follows"
        facts.append(("noise", f"{walk.words}, {what}"))
    stored = stored_parameters(loop.final)
    return findings_of(
        loop,
        lambda step: (p for p in stored if p.effect == step.effect),
        gain=_gain_of(loop.difference),
        facts=tuple(facts),
        declared=tuple((name, _size(loop.final, name)) for name in declared),
        only=only,
        without=without,
        not_testable=tuple(
            Untestable(h.name, "a typical size", h.size / MG, "mg rms")
            for h in find_hidden(loop.scores, loop.final.model.names)
            if h.absorbed
        ),
    )


def _size(fit: Fit, name: str) -> str:
    own = [p for p in stored_parameters(fit) if p.effect == name]
    return ", ".join(plus_minus(p.value, p.sd, p.unit) for p in own[:3])


@dataclass(frozen=True)
class Hidden:
    """An effect that may be there unseen. size : m/s², rms on a reading, of what it may do: at its
    typical size where it is absorbed, else where it would be found in four of five recordings."""

    name: str
    size: float
    absorbed: bool
    identify: str


def find_hidden(scores: Sequence[Score], present: Sequence[str] = ()) -> tuple[Hidden, ...]:
    """Effects of the sensor that may hide, largest first, absorbed ones before the others.

    present : those in the model
    """
    found = []
    for one in scores:
        effect = known(one.name)
        if effect is None or effect.stage == "fixture" or one.name in present:
            continue
        size = one.size_m_per_s2
        if not one.absorbed:
            size *= _SEEN / max(one.lambda_at_typical_size, 1e-12)
        if size >= _LEAST and "@" not in one.name:
            found.append(Hidden(one.name, size, one.absorbed, effect.identify))
    return tuple(sorted(found, key=lambda h: (not h.absorbed, -h.size)))


def advice_of(found: Sequence[Hidden]) -> tuple[str, ...]:
    """What to record, where something cannot be seen at all."""
    absorbed = [h for h in found if h.absorbed]
    if not absorbed:
        return ()
    first = absorbed[0]
    names = ", ".join(in_words(h.name) for h in absorbed)
    return (
        f"These data cannot show {names}, whatever the size ({first.size / MG:.2g} mg rms at a "
        f"typical one). {first.identify}",
    )
