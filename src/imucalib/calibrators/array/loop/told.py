"""What a search over a motion says: steps, what is left without a name, and every component."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.cross_fit import Gained
from imucalib.calibrators.array.loop.products import MotionProblem
from imucalib.calibrators.array.loop.search import Explored
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.terms import OPEN, Term
from imucalib.loop.found import Score, Step, Unexplained
from imucalib.loop.posterior.odds import ABSORBED, CERTAIN
from imucalib.loop.posterior.space import Posterior
from imucalib.loop.posterior.words import Place, name_of, of_each
from imucalib.significant_digits import plus_minus


def size_in_words(state: ArrayState, term: Term) -> str:
    """The one value with its deviation, or the rms of many."""
    parameters = term.parameters(state.setup.imus)
    sd = state.sd_of(term)
    units = {p.unit for p in parameters}
    if len(parameters) == 1:
        return plus_minus(float(term.theta[0]), float(sd[0]), parameters[0].unit)
    if len(parameters) <= 3:
        values = ", ".join(f"{v:.3g}" for v in term.theta)
        return f"{values} {parameters[0].unit}"
    rms = float(np.sqrt(np.mean(term.theta**2)))
    return f"{rms:.2g} {units.pop()} rms, {term.live.shape[1]} of {len(parameters)} determined"


def steps_of(found: Explored, final: ArrayState, gained: Gained | None) -> tuple[Step, ...]:
    """What is told and corrected, likeliest first; a place that twins share is theirs together.

    final : the fit with what is corrected
    """
    steps = []
    for place in found.said.places:
        name = _member(found, place.component)
        twins = next((s for s in found.apart.shares.values() if name in dict(s)), ((name, 1.0),))
        term = next((t for t in final.found if t.name == twins[0][0]), None)
        if term is None:
            continue
        rivals = [
            (own, share * part)
            for c, share in place.rivals
            for own, part in (twins if c == place.component else ((_member(found, c), 1.0),))
        ]
        likely = tuple(r for r in rivals if r[1] > 1.0 - CERTAIN or r[0] == term.name)
        named = found.problem.named(name)
        steps.append(
            Step(
                effect=term.name,
                evidence=place.log_odds,
                checked=() if gained is None else gained.checked,
                aliases=tuple(n for n, _ in likely if n != term.name),
                value=size_in_words(final, term),
                curve=not named,
                probability=place.probability,
                rivals=tuple(sorted(likely, key=lambda r: -r[1])),
                certain=place.certain and twins[0][1] > CERTAIN,
            )
        )
    return tuple(steps)


def left_over(found: Explored, final: ArrayState) -> dict[Unexplained, Array]:
    """What is told and stays without a name, be it corrected or not: laws, and effects of which the
    data determine no size; with the (d,) m by which each moves the positions, where it is not
    corrected.

    final : the fit with what is corrected
    """
    left, own = {}, {term.name for term in final.found}
    for place in found.said.places:
        name = _member(found, place.component)
        if found.problem.named(name) and name in own:
            continue
        moved = found.problem.moved(found.grams, found.said.hypothesis, place.component)
        left[_without_a_name(found, place, name)] = 0.0 * moved if name in own else moved
    return left


def _without_a_name(found: Explored, place: Place, name: str) -> Unexplained:
    return Unexplained(
        name=name,
        driver=found.problem.components[place.component].driver,
        kind="probe",
        probability=place.probability,
        evidence=0.0,
        rivals=tuple(_member(found, c) for c, _ in place.rivals),
    )


def _member(found: Explored, component: int) -> str:
    return name_of(found.problem, found.posterior, found.said, component)


def scores_of(problem: MotionProblem, posterior: Posterior) -> tuple[Score, ...]:
    """Every component, likeliest first, by its first member at typical size: its evidence beside
    the base model alone, and the probability that it is not there in `p`."""
    evidence, inside = of_each(posterior, len(problem.components))
    found = []
    for c, component in enumerate(problem.components):
        left, strength, _ = problem.shown(c)
        score = Score(
            name=component.name,
            kind="effect" if component.named else "probe",
            driver=component.driver,
            evidence=float(evidence[c]),
            probability=float(inside[c]),
            left=left if strength > OPEN else 0.0,
            strength=strength,
        )
        found.append(score)
    return tuple(sorted(found, key=lambda s: -s.probability))


def absorbed(problem: MotionProblem) -> dict[str, float]:
    """What no motion shows, and by how many m rms its typical size moves the positions."""
    found = {}
    for c, component in enumerate(problem.components):
        left, strength, moves = problem.shown(c)
        if component.named and (strength <= OPEN or left < ABSORBED):
            found[component.name] = moves
    return found
