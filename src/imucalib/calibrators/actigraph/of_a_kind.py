"""A worn sensor beside its fleet: where its postures leave open what devices of its kind tell."""

from __future__ import annotations

from dataclasses import dataclass

from imucalib.calibrators.actigraph.observations import with_temperature
from imucalib.calibrators.actigraph.weak import beside, known_worse
from imucalib.calibrators.population import STRANGE, Population
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.estimators.in_a_population import strangeness
from imucalib.rests.runs import PostureRuns


@dataclass(frozen=True)
class OfAKind:
    """What a fleet said of a device. alone : the fit without it
    strange : chance that one of the kind is as far off, NaN where the fleet was not needed
    taken : whether the calibration stands on it"""

    kind: Population
    alone: Fit
    strange: float
    taken: bool

    @property
    def contradicted(self) -> bool:
        return self.strange < STRANGE


def fit_of_a_kind(kind: Population, alone: Fit, runs: PostureRuns) -> tuple[OfAKind, Fit, int]:
    """The fit that stands, and how many of its runs count less.

    alone : of the base model by the recording itself. The fleet is asked where the postures know a
    combination of parameters worse than a third of what it knows, and it is not believed where the
    device contradicts it.
    """
    own = kind.prior(alone.model, alone.observations, ())
    if not known_worse(alone, own.root):
        return OfAKind(kind, alone, float("nan"), False), alone, 0
    data = with_temperature(alone.observations, runs)
    every = {e.name: e for e in (*alone.model.effects, *kind.driven(data.context))}
    model = Model(tuple(every.values()))
    prior = kind.prior(model, data, ())
    found, light = beside(prior, model, data, runs)
    strange = strangeness(found)
    if strange < STRANGE:
        return OfAKind(kind, alone, strange, False), alone, 0
    return OfAKind(kind, alone, strange, True), found, light
