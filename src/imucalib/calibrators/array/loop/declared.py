"""Effects that the user declares, or leaves out of the array's search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.calibrators.array.loop.ages import found_ages, kept_ages
from imucalib.calibrators.array.loop.catalogue import array_catalogue
from imucalib.calibrators.array.loop.state import ArrayState, settled
from imucalib.calibrators.array.loop.terms import Term, columns_of, determined, typical_of
from imucalib.calibrators.array.moving import Moving
from imucalib.core.effect import Response
from imucalib.errors import Undetermined, UsageError
from imucalib.estimators.array.gram import Columns, gram, reduced

Array = NDArray[np.float64]


def named_effect(name: str, imus: Sequence[str]) -> tuple[Response, int | None]:
    """The effect and the one IMU that a name such as "gyro_scale@imu3" means.

    Raises UsageError for an unknown effect or IMU.
    """
    family, at, imu = name.partition("@")
    catalogue = array_catalogue()
    if family not in catalogue:
        raise UsageError(
            f"no array effect is called '{family}'", remedy="`imucal effects` lists them"
        )
    effect = catalogue[family]
    if not at:
        return effect, None
    if effect.shared or imu not in imus:
        reason = "acts on all IMUs alike" if effect.shared else f"has no IMU '{imu}' to act on"
        raise UsageError(f"'{name}': {family} {reason}", remedy=f"IMUs: {', '.join(imus)}")
    return effect, list(imus).index(imu)


@dataclass(frozen=True)
class Asked:
    """Names of effects, of one IMU with "@imu3". declare : in the model from the start; only : the
    search tries no others; without : it does not try these; search : whether there is one"""

    declare: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    search: bool = True

    def skipped(self, imus: Sequence[str]) -> frozenset[str]:
        """All effects that the search shall not try. Raises UsageError for an unknown name."""
        for name in (*self.only, *self.without):
            named_effect(name, imus)
        every = {
            name
            for effect in array_catalogue().values()
            for name in (effect.name, *(f"{effect.name}@{imu}" for imu in imus))
        }
        if not self.search:
            return frozenset(every)

        def meant(name: str, chosen: Sequence[str]) -> bool:
            return name in chosen or name.partition("@")[0] in chosen

        return frozenset(
            n for n in every if meant(n, self.without) or (self.only and not meant(n, self.only))
        )


NOTHING_ASKED = Asked()


def with_declared(state: ArrayState, names: Sequence[str], moving: Moving) -> ArrayState:
    """The joint fit with the named effects in the model.

    Raises UsageError for unknown names, Undetermined where the motion cannot carry one.
    """
    for name in names:
        effect, _ = named_effect(name, state.setup.imus)
        if "sample_age" in effect.needs and state.motion.age is None:
            ages = found_ages(state, moving, all_rows=True)
            state = state if ages is None else kept_ages(state, ages, voting=False)
        reason = effect.missing(state.motion.context)
        term = None if reason else declared_term(state, name)
        if term is None or len(term.value) == 0:
            raise Undetermined(
                f"{name} was declared, and this motion does not show it"
                + (f": {reason}" if reason else ""),
                remedy=effect.identify,
            )
        state = replace(state, terms=(*state.terms, term))
    return settled(state) if names else state


def declared_term(state: ArrayState, name: str) -> Term:
    """An effect as a new term of a fitted state: what these data can determine of it, at zero."""
    effect, only = named_effect(name, state.setup.imus)
    return determined(name, effect, only, beside_the_fit(state, effect, only))


def beside_the_fit(state: ArrayState, effect: Response, only: int | None = None) -> Array:
    """(p, p) Gram matrix, in units of the noise, of an effect's columns in typical sizes, with
    motion, positions and terms taken out."""
    columns = columns_of(effect, state.motion, only)
    typical = typical_of(effect, columns.basis.shape[3])
    columns = Columns(columns.basis * typical, columns.gyro, columns.shared)
    found = state.base.free(gram(state.sampled, [*state.base.blocks, columns], state.setup.inner))
    rests = state.base.rests
    base, others = np.arange(len(rests)), np.arange(len(rests), len(found.along))
    return reduced(found, base, rests, 0.0 * rests, others).matrix
