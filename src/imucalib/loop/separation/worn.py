"""What a worn sensor's search leaves ambiguous, as products under its walk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucalib.core.context import Context
from imucalib.effects import known
from imucalib.loop.found import Step
from imucalib.loop.separation.ambiguities import NEAR
from imucalib.loop.separation.products import Ambiguity, Products
from imucalib.loop.wander.choice import Search, Taken
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.scores import Entry


def ambiguities(problem: Problem, found: Search, steps: Sequence[Step]) -> tuple[Ambiguity, ...]:
    """Of every step that has rivals in the catalogue; steps as `words.steps_of` tells them."""
    made = [
        _of_step(problem, found, taken, step)
        for taken, step in zip(found.taken, steps, strict=False)
        if not step.curve and step.aliases
    ]
    return tuple(one for one in made if one is not None)


def _of_step(problem: Problem, found: Search, taken: Taken, step: Step) -> Ambiguity | None:
    entries = {s.entry.name: s.entry for s in taken.rivals}
    named = [entries[n] for n in step.aliases if n in entries and known(n) is not None]
    own = taken.found.entry
    if not named or known(own.name) is None:
        return None
    nats = {s.entry.name: s.evidence for s in taken.rivals} | {own.name: taken.found.evidence}
    families = {e.family or e.name for e in (own, *named)}
    near = [
        s.entry
        for s in taken.rivals
        if s.evidence >= NEAR * taken.found.evidence
        and s.entry.kind != "curve"
        and (s.entry.family or s.entry.name) not in families
        and known(s.entry.name) is not None
    ]
    others = [t.found.entry for t in found.taken if t is not taken]
    every = [own, *named, *(e for e in near if e.name not in {o.name for o in others})]
    base = [*problem.terms.columns, *(c for e in others for c in e.columns)]
    ends = np.cumsum([len(base), *(e.columns.size for e in every)])
    return Ambiguity(
        effect=own.name,
        base=(*problem.fit.model.names, *(e.name for e in others)),
        columns=(
            *(p.name for p in problem.fit.parameters),
            *(name for e in (*others, *every) for name in _parameters(problem, e)),
        ),
        rivals=(own.name, *(e.name for e in named)),
        blocks={e.name: np.arange(a, b) for e, a, b in zip(every, ends, ends[1:], strict=False)},
        nats={e.name: float(nats[e.name]) for e in every},
        products=_products(problem, found, [*base, *(c for e in every for c in e.columns)]),
        dof=float(found.level.freedom),
    )


def _parameters(problem: Problem, entry: Entry) -> list[str]:
    context: Context = problem.fit.observations.context
    return [p.name for p in problem.effect(entry.name).parameters(context)]


def _products(problem: Problem, found: Search, columns: Sequence[int]) -> Products:
    """Of the rows that were searched, counted for all that there are."""
    bank, level = found.bank, found.level
    picked = bank.white(level.walk, np.array([*columns, bank.data]))
    often = problem.fit.observations.n / len(picked) / level.variance
    gram = picked.T @ picked * often
    numbers = float(problem.fit.observations.n)
    return Products(gram[:-1, :-1], gram[:-1, -1], float(gram[-1, -1]), numbers)
