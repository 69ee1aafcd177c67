"""Columns of what the base model has, times what may drive it, as rivals of a name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.loop.found import Step
from imucalib.loop.wander.bank import Bank
from imucalib.loop.wander.choice import Search
from imucalib.loop.wander.likelihood import Terms
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.scores import Entry
from imucalib.loop.wander.words import with_rivals

#: Parts of the base model by the word for them, each with the effect and 1 mg, or 1 mg/g, in it.
PARTS = {"bias": ("bias", 1.0), "scale": ("scale", 1e-3), "axes": ("non_orthogonality", 1e-3)}


def parts_of(problem: Problem, bank: Bank) -> dict[str, Array]:
    """(n, 3) what |a| sees of each part of the base model (1 mg or 1 mg/g an axis), in units of the
    scatter of a run."""
    fit = problem.fit
    slices = fit.model.slices(fit.observations.context)
    found = dict[str, Array]()
    for word, (name, unit) in PARTS.items():
        if name in slices:
            typical = np.array([p.typical for p in fit.parameters[slices[name]]])
            found[word] = np.asarray(bank.columns[:, slices[name]] * (unit / typical))
    return found


def driven(columns: Array, drives: Array) -> Array:
    """(n, c k) columns (n, c), each times every drive (n, k)."""
    return np.asarray((columns[:, None] * drives[:, :, None]).reshape(len(columns), -1))


@dataclass
class Rivals:
    """Named blocks of columns that may share some: kept : (n, c) by key; made : keys of each name;
    wide : names of those that contain what they stand against, rivals by their evidence alone"""

    kept: dict[str, Array] = field(default_factory=dict)
    made: dict[str, tuple[str, ...]] = field(default_factory=dict)
    wide: set[str] = field(default_factory=set)

    def add(self, name: str, columns: Mapping[str, Array], *, wide: bool = False) -> None:
        """A rival of these columns by their keys."""
        if columns:
            self.kept.update(columns)
            self.made[name] = tuple(columns)
            self.wide |= {name} if wide else set()

    def entries(self, start: int) -> tuple[Array, list[Entry]]:
        """All columns (n, m), and every rival where they stand behind `start` others."""
        at, where = start, dict[str, Index]()
        for key, columns in self.kept.items():
            where[key] = np.arange(at, at + columns.shape[1])
            at += columns.shape[1]
        entries = [
            Entry(name, "", "time", np.concatenate([where[k] for k in keys]), name in self.wide)
            for name, keys in self.made.items()
        ]
        return np.concatenate(list(self.kept.values()), axis=1), entries


def narrowed(base: Terms, found: Search) -> Search:
    """The search with a bank of the base model, what it took, and the data alone."""
    bank, terms = found.bank, base
    picked, taken = [base.columns], []
    for one in found.taken:
        own = one.found.entry
        columns = terms.columns.size + np.arange(own.columns.size)
        terms = terms.plus(columns, one.size)
        picked.append(own.columns)
        entry = replace(own, columns=columns)
        taken.append(replace(one, found=replace(one.found, entry=entry)))
    every = np.concatenate([*picked, [bank.data]])
    return replace(found, bank=bank.only(every), terms=terms, taken=tuple(taken))


def held_against(
    problem: Problem, found: Search, steps: Sequence[Step], rivals: Rivals
) -> tuple[Step, ...]:
    """The steps with those of the rivals that would do as well in the place of each."""
    if not rivals.made or not steps:
        return tuple(steps)
    search = narrowed(problem.terms, found)
    columns, entries = rivals.entries(search.bank.columns.shape[1])
    search = replace(search, bank=search.bank.plus(columns))
    return with_rivals(problem, search, steps, entries)
