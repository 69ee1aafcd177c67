"""What the posterior says, in names and probabilities.

Something is claimed where being silent would cost more. Concluded is the simplest set that the best
does not beat by more than chance (Occam's window); in each of its places is everything that could
be there, with its share. A name is certain where it is in nearly all of the posterior, and no free
function or unnamed law is likelier than not to replace it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.posterior.closed_loop.found import (
    CheckedError,
    Rival,
    Score,
    Share,
    Step,
    Unexplained,
)
from imucalib.posterior.odds import ABSORBED, CERTAIN, FALSE_CLAIM, LEAST, OCCAM, WEIGHED
from imucalib.posterior.search.catalogue import Member
from imucalib.posterior.search.gram import marginalize
from imucalib.posterior.search.problem import Contest, Problem
from imucalib.posterior.search.solution import solve
from imucalib.posterior.search.space import Hypothesis, Posterior
from imucalib.posterior.search.trust import split_at_jump

P = TypeVar("P", bound=Contest)


def rivals_of(problem: Problem, posterior: Posterior) -> tuple[Rival, ...]:
    """The likeliest sets, each as a fit, and where the readings do not say which part of a sheet
    stands as it was set, as one with either part."""
    likely = [(h, p) for h, p in posterior.weighed if p > LEAST][:WEIGHED]
    total = sum(p for _, p in likely)
    context, found = problem.fit.observations.context, []
    for hypothesis, p in likely:
        one = solve(problem, posterior.grams, hypothesis)
        fit = replace(
            problem.fit,
            model=one.model,
            parameters=one.model.parameters(context),
            theta=one.theta,
            covariance=one.covariance,
            slope=np.zeros((0, one.theta.size, one.theta.size)),
            noise_covariance=np.zeros((0, 0)),
        )
        names = tuple(problem.components[c].name for c in hypothesis.components)
        either = [fit, *_other_parts(problem, fit)]
        found += [Rival(names, p / total / len(either), one) for one in either]
    return tuple(found)


def _other_parts(problem: Problem, fit: Fit) -> Iterator[Fit]:
    """A set's fit with what comes after each of its jumps standing as it was set."""
    base, slices = problem.model, fit.model.slices(fit.observations.context)
    into = np.concatenate([np.arange(fit.theta.size)[slices[name]] for name in base.names])
    for effect in fit.model.effects:
        added = effect.name not in base.names
        parts = split_at_jump(problem.fit, base, effect) if added else None
        if parts is not None:
            turn = np.eye(fit.theta.size)
            turn[into, slices[effect.name]] -= parts.taken_over
            covariance = turn @ fit.covariance @ turn.T
            yield replace(fit, theta=turn @ fit.theta, covariance=covariance)


def scores_of(
    problem: Contest, posterior: Posterior, shown: Sequence[tuple[float, float, float]]
) -> tuple[Score, ...]:
    """Every component, likeliest first: its evidence beside the base model alone, and the
    probability that it is there.

    shown : of each at its typical size the share that the base model leaves of its columns, their
        length then in units of the noise, and what it does to a reading, m/s² rms
    """
    evidence, inside = of_each(posterior, len(problem.components))
    found = [
        Score(
            name=one.name,
            kind="effect" if one.named else "probe",
            driver=one.follows,
            evidence_nats=float(nats),
            probability=float(share),
            left=left,
            lambda_at_typical_size=strength,
            size_m_per_s2=size,
        )
        for one, nats, share, (left, strength, size) in zip(
            problem.components, evidence, inside, shown, strict=True
        )
    ]
    return tuple(sorted(found, key=lambda s: -s.probability))


def measure_shown(problem: Problem, posterior: Posterior) -> list[tuple[float, float, float]]:
    """Of each component's first member what `scores_of` tells, at the likeliest noise."""
    base, dof = marginalize(posterior.grams, problem.flat), posterior.dof
    logs = base.log_weight + base.log_noise(base.power, dof)
    one, n = base.of(np.array([int(np.argmax(logs))])), len(problem.fit.at.owner)
    basis = np.linalg.qr(problem.columns[:n, : problem.base])[0]
    first = {c.component: c.at for c in reversed(problem.choices)}
    found = []
    for k in range(len(problem.components)):
        columns = problem.columns[:n, first[k]]
        rest = columns - basis @ (basis.T @ columns)
        left = float(np.sum(rest**2) / np.sum(columns**2))
        # What the base absorbs has the length of rounding, another in every process.
        power = float(np.trace(one.blocks(first[k][None])[0, 0])) if left > ABSORBED else 0.0
        sized = columns * problem.fit.at.unit[:, None]
        length = float(np.sqrt(power * dof / one.power[0]))
        size = float(np.linalg.norm(sized) / problem.fit.observations.n**0.5)
        found.append((left, length, size))
    return found


def of_each(posterior: Posterior, count: int) -> tuple[Array, Array]:
    """(C,) nats of each component by itself beside the base model, and (C,) the probability that it
    is there; count : how many there are"""
    evidence, inside = np.zeros(count), np.zeros(count)
    for hypothesis, p in posterior.weighed:
        inside[list(hypothesis.components)] += p
        if len(hypothesis.components) == 1:
            evidence[hypothesis.components[0]] = hypothesis.evidence - posterior.base.evidence
    return evidence, np.minimum(inside, 1.0)


@dataclass(frozen=True)
class Slot:
    """One thing that is missing.

    component : that is concluded; probability : that it is there, in its place or beside others
    rivals : (component, share of this place) of all that could stand there, likeliest first, until
        they are 95 %; certain : whether it is a cause beyond doubt
    """

    component: int
    probability: float
    rivals: tuple[tuple[int, float], ...]
    certain: bool

    @property
    def log_odds(self) -> float:
        """Nats in favour of its being there."""
        odds = self.probability / max(1.0 - self.probability, 1e-12)
        return float(np.log(max(odds, 1e-12)))


@dataclass(frozen=True)
class SelectedModel(Generic[P]):
    """What a posterior over a problem's sets tells.

    complete : probability that nothing is missing; hypothesis : the set that is concluded and
    corrected; places : its components, likeliest first
    """

    problem: P
    posterior: Posterior
    complete: float
    hypothesis: Hypothesis
    places: tuple[Slot, ...]

    def member(self, component: int) -> Member:
        """How a component acts in what is concluded, or in its likeliest set."""
        sets = (self.hypothesis, *self.posterior.hypotheses)
        own = next(h for h in sets if component in h.components)
        picked = (self.problem.choices[p.choice] for p in own.picks)
        return next(choice.member for choice in picked if choice.component == component)

    def name(self, component: int) -> str:
        """The effect of a component there."""
        return self.member(component).name

    def step(
        self,
        slot: Slot,
        checks: tuple[CheckedError, ...],
        rivals: Sequence[tuple[str, float]],
        size: str = "",
    ) -> Step:
        """A slot as a step. rivals : (effect, share) of all that may stand there"""
        component = self.problem.components[slot.component]
        effect = self.member(slot.component).effects[0][0]
        law = f"{effect.sentence.rstrip('.')}, {effect.equation}"
        return Step(
            effect=effect.name,
            size=size,
            probability=slot.probability,
            in_its_place=tuple(Share(*one) for one in rivals),
            evidence_nats=slot.log_odds,
            checks=checks,
            aliases=tuple(dict.fromkeys(n for n, _ in rivals if n != effect.name)),
            certain=slot.certain,
            curve=_describe_curve(effect.name) if component.kind == "free" else "",
            formula=law if component.kind == "law" else "",
        )

    def leave_unexplained(
        self, slot: Slot, name: Callable[[int], str] | None = None
    ) -> Unexplained:
        """A slot as structure that stays. name : of a component; that of its effect by default"""
        name = name or self.name
        return Unexplained(
            name=name(slot.component),
            driver=self.problem.components[slot.component].follows,
            kind="probe",
            probability=slot.probability,
            evidence_nats=0.0,
            rivals=tuple(name(c) for c, _ in slot.rivals),
        )


def _describe_curve(name: str) -> str:
    """What a curve bends, and against what: a scan's own name where it bends no driver."""
    family, _, value = name.partition("@")
    what, *against = value.split(":")
    return f"{what} against {against[0]}".replace("_", "-") if against else f"a {family}'s offset"


def select_model(problem: P, posterior: Posterior) -> SelectedModel[P]:
    """The simplest set that explains the data, and what else could be in each of its places: of few
    components, and of few free functions, which hold what a name or a law says and more. On two
    temperatures a line and a curve are one function."""

    def free(hypothesis: Hypothesis) -> int:
        return sum(problem.components[c].kind == "free" for c in hypothesis.components)

    def nameless(hypothesis: Hypothesis) -> int:
        return sum(not problem.components[c].named for c in hypothesis.components)

    complete = sum(p for h, p in posterior.weighed if not h.components)
    if FALSE_CLAIM * complete >= 1.0 - complete:  # claiming costs more than being silent
        return SelectedModel(problem, posterior, complete, posterior.base, ())
    bar = np.exp(-OCCAM) * posterior.probability[0]
    said, _ = min(
        ((h, p) for h, p in posterior.weighed if p > bar and h.components),
        key=lambda one: (len(one[0].components), free(one[0]), -one[1]),
    )
    inside = of_each(posterior, len(problem.components))[1]
    without_name = sum(p for h, p in posterior.weighed if nameless(h))
    places = []
    for component in said.components:
        rivals, likely = _rivals(posterior, said, component), float(inside[component])
        alone = len(rivals) == 1 and likely > CERTAIN and without_name < 0.5
        certain = alone and problem.components[component].named
        places.append(Slot(component, likely, rivals, certain))
    ranked = tuple(sorted(places, key=lambda p: -p.probability))
    return SelectedModel(problem, posterior, complete, said, ranked)


def _rivals(
    posterior: Posterior, said: Hypothesis, component: int
) -> tuple[tuple[int, float], ...]:
    """What stands in a component's place in sets that have all the others."""
    rest = set(said.components) - {component}
    weight: dict[int, float] = {}
    for hypothesis, p in posterior.weighed:
        own = set(hypothesis.components)
        if len(own) == len(said.components) and rest <= own:
            other = (own - rest).pop()
            weight[other] = weight.get(other, 0.0) + p
    ranked = sorted(weight, key=lambda c: -weight[c])
    share = np.array([weight[c] for c in ranked]) / sum(weight.values())
    count = int(np.searchsorted(np.cumsum(share), CERTAIN, side="right")) + 1
    return tuple(zip(ranked[:count], share[:count].tolist(), strict=True))
