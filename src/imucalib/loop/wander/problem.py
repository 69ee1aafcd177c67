"""A fitted base model and everything that could be missing beside it, as columns of one bank."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import Effect, Family
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.effects import known
from imucalib.loop.candidates import effect_candidates
from imucalib.loop.design import Fold
from imucalib.loop.evidence import Candidate
from imucalib.loop.wander.bank import Bank, Split, bank_of, splits_of
from imucalib.loop.wander.choice import Taken
from imucalib.loop.wander.forms import driver_of, form_columns
from imucalib.loop.wander.likelihood import Terms
from imucalib.loop.wander.noise import Noise, natural
from imucalib.loop.wander.scores import Entry, kind_of
from imucalib.units import MG

#: Values of a scan that are tried at first; the neighbours of the best one are tried after.
_OF_A_SCAN = 24
#: Prior sd of the base model's parameters, in typical sizes.
_WIDE = 10.0


@dataclass(frozen=True)
class Problem:
    """bank : columns in units of the scatter at typical size: base, candidates, data; terms : the
    base model; effects : by name, all that entries name; missing : why others cannot be tested
    small : the fit at the rows of the bank; families : scans by name; made : forms by driver"""

    fit: Fit
    noise: Noise
    bank: Bank
    terms: Terms
    entries: tuple[Entry, ...]
    splits: tuple[Split, ...]
    effects: Mapping[str, Effect]
    missing: Mapping[str, str]
    small: Fit
    families: Mapping[str, Family]
    made: dict[str, list[tuple[str, Array]]] = field(default_factory=dict, repr=False)

    @property
    def time(self) -> Array:
        """(n,) s of all rows."""
        return self.fit.observations.context["time"]

    def finer(self, entry: Entry) -> list[tuple[str, Array]]:
        """Values of a scan near one of its values, with their columns."""
        family = self.families.get(entry.family)
        if family is None:
            return []
        context = self.small.observations.context
        near = family.nearby(context, entry.name.partition("@")[2])
        return self.columns_of([family.member(value) for value in near])

    def columns_of(self, effects: Sequence[Effect]) -> list[tuple[str, Array]]:
        """Names of effects that can be tried, with their columns (n, c)."""
        found, _ = effect_candidates(self.small, effects)
        unit = self.small.at.sigma[:, :1] / MG / self.noise.scatter
        return [(c.name, c.columns * unit) for c in found]

    def forms(self, entry: Entry) -> list[tuple[str, Array]]:
        """Forms that the driver of a name may have, with their columns."""
        driver = driver_of(entry)
        if driver and driver not in self.made:
            unit = self.small.at.sigma[:, :1] / MG / self.noise.scatter
            found = form_columns(self.small, driver)
            self.made[driver] = [(name, columns * unit) for name, columns in found]
        return self.made.get(driver, [])

    def effect(self, name: str) -> Effect:
        found = self.effects.get(name) or known(name)
        assert found is not None, name
        return found

    def drivers(self, name: str) -> str:
        """What drives an effect, in words."""
        return " and ".join(self.effect(name).needs)

    def model(self, taken: Sequence[Taken]) -> Model:
        return Model((*self.fit.model.effects, *(self.effect(t.found.entry.name) for t in taken)))

    def theta(self, values: Array, taken: Sequence[Taken]) -> Array:
        """θ of the model from parameters in typical sizes, base first and in order of taking."""
        context = self.fit.observations.context
        model = self.model(taken)
        slices, out = model.slices(context), model.start(context)
        names = (*self.fit.model.names, *(t.found.entry.name for t in taken))
        at = 0
        for name in names:
            part = slices[name]
            out[part] = values[at : at + part.stop - part.start]
            at += part.stop - part.start
        return np.asarray(out * np.array([p.typical for p in model.parameters(context)]))

    def precision(self, taken: Sequence[Taken]) -> Array:
        """(p,) prior precisions in the model's own order, in typical sizes."""
        context = self.fit.observations.context
        model = self.model(taken)
        slices, out = model.slices(context), np.ones(len(model.parameters(context)))
        own = self.fit.model.slices(context)
        for name, values in own.items():
            out[slices[name]] = self.terms.precision[values]
        for t in taken:
            out[slices[t.found.entry.name]] = t.size**-2.0
        return out


def base_precision(fit: Fit) -> Array:
    """(p,) of the base model's priors in typical sizes: wide, the recording decides."""
    return np.full(fit.theta.size, _WIDE**-2.0)


def problem_of(
    fit: Fit,
    noise: Noise,
    effects: Mapping[str, Effect],
    families: Sequence[Family],
    folds: Sequence[Fold],
    most: int,
) -> Problem:
    """At most `most` rows, spread evenly in time, stand for all."""
    small = thinned(fit, most)
    context = fit.observations.context
    tried, family_of = dict(effects), dict[str, str]()
    for family in families:
        values = family.values(context)
        some = np.unique(np.linspace(0, len(values) - 1, min(len(values), _OF_A_SCAN)).astype(int))
        for effect in (family.member(values[k]) for k in some if len(values)):
            tried[effect.name], family_of[effect.name] = effect, family.name
    candidates, missing = effect_candidates(small, tried.values(), parts=True)
    misfit, base, seen = natural(small)
    unit = small.at.sigma[:, :1] / MG
    p = base.shape[1]
    entries, blocks = _entries(candidates, tried, family_of, p)
    typical = np.array([q.typical for q in fit.parameters])
    whole = misfit + base @ (fit.theta / typical)
    columns = np.column_stack([base, *(b * unit for b in blocks), whole]) / noise.scatter
    rows = _rows(fit, small)
    cut = [Fold(_where(rows, f.rows), _where(rows, f.rest)) for f in folds]
    part = np.unique(noise.course.part[rows], return_inverse=True)[1].astype(np.intp)
    course = replace(
        noise.course, time=noise.course.time[rows], seen=seen,
        variance=noise.course.variance[rows], part=part,
    )  # fmt: skip
    bank = bank_of(course, noise.walks, columns)
    terms = Terms(np.arange(p), base_precision(fit), p)
    of = {family.name: family for family in families}
    splits = splits_of(cut, part)
    return Problem(
        fit=fit, noise=noise, bank=bank, terms=terms, entries=entries, splits=splits,
        effects=tried, missing=missing, small=small, families=of,
    )  # fmt: skip


def _entries(
    candidates: Sequence[Candidate],
    effects: Mapping[str, Effect],
    family_of: Mapping[str, str],
    start: int,
) -> tuple[tuple[Entry, ...], list[Array]]:
    """Candidates as columns of the bank. A converter's curve of all axes is those of each."""
    entries, blocks, at = list[Entry](), list[Array](), start
    own = dict[str, Index]()
    for candidate in candidates:
        effect, family = effects[candidate.name], family_of.get(candidate.name, "")
        axes = candidate.name.partition("@")[2] if family == "converter" else ""
        if len(axes) > 1 and all(a in own for a in axes):
            columns = np.concatenate([own[a] for a in axes])
        else:
            columns = np.arange(at, at + candidate.columns.shape[1])
            blocks.append(candidate.columns)
            at += columns.size
            own[axes] = columns
        entries.append(Entry(candidate.name, family, kind_of(effect), columns))
    return tuple(entries), blocks


def _rows(fit: Fit, small: Fit) -> Index:
    every = fit.observations.context["record"]
    return np.searchsorted(every, small.observations.context["record"]).astype(np.intp)


def _where(rows: Index, wanted: Index) -> Index:
    return np.flatnonzero(np.isin(rows, wanted)).astype(np.intp)


def thinned(fit: Fit, most: int) -> Fit:
    """The same fit seen through at most so many observations, spread evenly in their order.

    Scores need no more, and their memory is that of the observations times the candidates. Only
    where every observation has its own free direction; fits always use all of them.
    """
    n = fit.observations.n
    if n <= most or fit.at.settings:
        return fit
    rows = np.linspace(0, n - 1, most).astype(np.intp)
    at = fit.at
    numbers = np.flatnonzero(np.isin(at.owner, rows))
    part = replace(
        at,
        residual=at.residual[numbers],
        jacobian=at.jacobian[numbers],
        keep=at.keep[rows],
        owner=np.searchsorted(rows, at.owner[numbers]),
        sigma=at.sigma[rows],
    )
    eta = fit.eta.reshape(n, -1)[rows].ravel()
    return replace(fit, at=part, observations=fit.observations.take(rows), eta=eta)
