"""Effects that the user declares, or leaves out of the array's search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.ages import found_ages, kept_ages, with_phases
from imucalib.calibrators.array.loop.asked import named_effect
from imucalib.calibrators.array.loop.components import typical_columns
from imucalib.calibrators.array.loop.state import ArrayState, settled
from imucalib.calibrators.array.loop.terms import Term, determined
from imucalib.calibrators.array.moving import Moving
from imucalib.core.effect import Response
from imucalib.errors import Undetermined
from imucalib.estimators.array.gram import gram
from imucalib.estimators.array.reduced import reduced


def with_declared(state: ArrayState, names: Sequence[str], moving: Moving) -> ArrayState:
    """The joint fit with the named effects in the model.

    Raises UsageError for unknown names, Undetermined where the motion cannot carry one.
    """
    for name in names:
        effect, _ = named_effect(name, state.setup.imus)
        if "sample_age" in effect.needs and state.motion.age is None:
            ages = found_ages(state, moving)
            state = state if ages is None else kept_ages(state, ages, voting=True)
        reason = effect.missing(state.motion.context)
        term = None if reason else declared_term(state, name)
        if term is None or len(term.value) == 0:
            raise Undetermined(
                f"{name} was declared, and this motion does not show it"
                + (f": {reason}" if reason else ""),
                remedy=effect.identify,
            )
        state = replace(state, terms=(*state.terms, term))
    return settled(with_phases(state)) if names else state


def declared_term(state: ArrayState, name: str) -> Term:
    """An effect as a new term of a fitted state: what these data can determine of it, at zero."""
    effect, only = named_effect(name, state.setup.imus)
    matrix = beside_the_fit(state, effect, only)
    return determined(name, effect, only, matrix, state.found)


def beside_the_fit(state: ArrayState, effect: Response, only: int | None = None) -> Array:
    """(p, p) Gram matrix, in units of the noise, of an effect's columns in typical sizes, with
    motion, positions and terms taken out."""
    columns = typical_columns(effect, state.motion, only)
    found = state.base.free(gram(state.sampled, [*state.base.blocks, columns], state.setup.inner))
    rests = state.base.rests
    return reduced(found, rests, 0.0 * rests).matrix
