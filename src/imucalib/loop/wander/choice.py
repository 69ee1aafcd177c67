"""Which effects are taken: above the bar, and better on blocks of time that were left out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.wander.bank import Bank, Mask, Split
from imucalib.loop.wander.beside.ahead import ahead_of
from imucalib.loop.wander.forms import leads, rival_form
from imucalib.loop.wander.held_blocks import Judged, inside, judged, judged_each
from imucalib.loop.wander.likelihood import Level, Terms, best_level
from imucalib.loop.wander.noise import usable_walks
from imucalib.loop.wander.scores import Entry, Scored, finest, middle_of_best, scored
from imucalib.loop.wander.walk import Walk

#: Standard errors by which the density must gain over the blocks; what is driven by time lies in
#: the same blocks as what it claims to explain, and has to gain more.
_GAIN, _GAIN_IN_TIME = 1.5, 2.0
#: Blocks by whose gain alone nothing is taken, and one.
_OF_NOTE = 3
#: A curve's prior is as flat in the density as it matters to the error: the smallest error among
#: these shares of its likeliest size whose density is within one standard deviation.
_SHRUNK = (1.0, 0.4, 0.2, 0.1)
#: Nats that no bar was ever below: less needs no simulated data.
_LEAST = 2.5
#: Candidates of one kind that are judged on the blocks.
_OF_A_KIND = 2
Bars = Callable[[Bank, Terms, int, Sequence[Scored]], Iterable[Array]]
Finer = Callable[[Entry], Sequence[tuple[str, Array]]]
Forms = Callable[[Entry], Sequence[tuple[str, Array]]]


@dataclass(frozen=True)
class Taken:
    """One accepted effect: its score, its prior size, the gain in nats of every block, and the
    mean held-out errors without and with it in the search's own design (units of the columns);
    rivals : all scores of that search; form : a form that would do as well as the name, or empty
    alike : names of what does as well on the blocks"""

    found: Scored
    size: float
    gains: Array
    before: float
    after: float
    rivals: tuple[Scored, ...]
    form: str = ""
    alike: tuple[str, ...] = ()


@dataclass(frozen=True)
class Refused:
    """What was above the bar and not taken: its name, or its scan's, the score, and the reason."""

    name: str
    found: Scored
    reason: str


@dataclass(frozen=True)
class Search:
    """bank : with the finer values of scans; terms, level : the model and its noise at the end;
    first, last : scores; refused : what was above the bar and did not hold out."""

    bank: Bank
    terms: Terms
    level: Level
    taken: tuple[Taken, ...]
    first: tuple[Scored, ...]
    last: tuple[Scored, ...]
    refused: tuple[Refused, ...]


@dataclass(frozen=True)
class Rules:
    """bars : (bank, terms, round, scores) -> nats that a candidate must reach, (2,) by `timed`, the
    next ones where nothing that reaches the first holds out
    most : effects; same_tau : as in `usable_walks`
    finer : (entry) -> values of its scan near it, with their columns (n, c), or nothing
    forms : (entry) -> names and columns of the forms that the driver of a name may have
    near : walks that decide something, all where none are said"""

    bars: Bars
    most: int
    finer: Finer
    forms: Forms
    same_tau: bool = False
    near: frozenset[Walk] = frozenset()

    def walks(self, bank: Bank, level: Level) -> tuple[int, ...]:
        """Those under which candidates are scored beside a model with this noise."""
        usable = usable_walks(bank, level, same_tau=self.same_tau)
        return tuple(walk for walk in usable if bank.walks[walk] in self.near) or usable


def search(
    bank: Bank,
    base: Terms,
    entries: Sequence[Entry],
    splits: Sequence[Split],
    keep: Mask,
    rules: Rules,
) -> Search:
    """Take the best effect that holds out, estimate the noise again, until none does."""
    design = inside(splits, keep)
    terms, taken = base, list[Taken]()
    first: tuple[Scored, ...] = ()
    while True:
        level = best_level(bank, terms, keep)
        open_entries = [e for e in entries if not any(same(e, t.found.entry) for t in taken)]
        walks = rules.walks(bank, level)
        scores, _ = scored(bank, terms, keep, open_entries, walks, told=not rules.same_tau)
        first = first or scores
        refused = list[Refused]()
        best = None
        wanted = len(taken) < rules.most and any(s.evidence > _LEAST for s in scores)
        for bar in rules.bars(bank, terms, len(taken), scores) if wanted else ():
            passing = [s for s in scores if s.evidence >= bar[int(s.entry.timed)]]
            refused.clear()
            bank, best = _choice(
                bank, terms, keep, passing, rules, level=level, scores=scores, design=design,
                refused=refused,
            )  # fmt: skip
            if best is not None:
                break
        if best is None:
            return Search(
                bank=bank, terms=terms, level=level, taken=tuple(taken), first=first,
                last=scores, refused=tuple(refused),
            )  # fmt: skip
        taken.append(best)
        terms = terms.plus(best.found.entry.columns, best.size)


def same(one: Entry, other: Entry) -> bool:
    """Whether only one of them may be taken: one value of a scan, but curves of several axes."""
    if one.kind == other.kind == "curve":
        return bool(np.isin(one.columns, other.columns).any())
    return one.name == other.name or bool(one.family and one.family == other.family)


def _choice(
    bank: Bank, terms: Terms, keep: Mask, passing: Sequence[Scored], rules: Rules, *, level: Level,
    scores: Sequence[Scored], design: Sequence[Split], refused: list[Refused],
) -> tuple[Bank, Taken | None]:  # fmt: skip
    kinds = dict.fromkeys(s.entry.kind for s in passing)
    tried = [s for kind in kinds for s in _first_of(passing, kind)]
    if not tried or len(design) < 3:
        return bank, None
    now = judged(bank, terms, level.walk, design)
    held = []
    for candidate in tried:
        if near := rules.finer(candidate.entry):
            bank, candidate = finest(bank, terms, keep, candidate, near)  # noqa: PLW2901
        trial = replace(_judged_with(bank, terms, candidate, now, design), rivals=tuple(scores))
        if reason := _objection(trial, candidate.entry.kind):
            name = candidate.entry.family or candidate.entry.name
            refused.append(Refused(name, candidate, reason))
        else:
            held.append(trial)
    if not held:
        return bank, None
    best, entries = _best_of(held), [s.entry for s in scores]
    names = [(t.found, t.size) for t in held]
    led = ahead_of(bank, terms, keep, best.found, named=names, entries=entries, walks=rules.walks)
    best = next((t for t in held if t.found is led), best)
    return _or_form(bank, terms, keep, best, rules, now=now, design=design)


def _or_form(
    bank: Bank, terms: Terms, keep: Mask, best: Taken, rules: Rules, *, now: Judged,
    design: Sequence[Split],
) -> tuple[Bank, Taken]:  # fmt: skip
    """The form that leads the name and holds out in its place; else the name, with what would do
    as well."""
    named = best.found
    rival = rival_form(bank, terms, keep, named, rules.forms(named.entry))
    if rival is None:
        return bank, best
    if leads(rival.score, named):
        trial = _judged_with(rival.bank, terms, rival.score, now, design)
        worse = float((best.gains - trial.gains).sum()) >= 0.0
        if named.entry.free:  # a formula goes before a curve that does as well
            worse = _lead(best.gains - trial.gains) >= 1.0
        if not _objection(trial, named.entry.kind) and not worse:
            return rival.bank, replace(trial, rivals=best.rivals, alike=best.alike)
    return bank, replace(best, form=rival.score.entry.name)


def _first_of(passing: Sequence[Scored], kind: str) -> list[Scored]:
    """The best of a kind; of a scan only its best value."""
    found = list[Scored]()
    for score in passing:
        if score.entry.kind == kind and not any(same(score.entry, f.entry) for f in found):
            found.append(_of_its_scan(score, passing))
    return found[:_OF_A_KIND]


def _of_its_scan(best: Scored, passing: Sequence[Scored]) -> Scored:
    entry = best.entry
    if not entry.family or entry.free:
        return best
    values = [s for s in passing if s.entry.family == entry.family]
    values.sort(key=lambda s: int(s.entry.columns[0]))
    return values[middle_of_best(np.array([s.evidence for s in values]))]


def _judged_with(
    bank: Bank, terms: Terms, candidate: Scored, now: Judged, design: Sequence[Split]
) -> Taken:
    shares = _SHRUNK if candidate.entry.free else (1.0,)
    sizes = [candidate.size * share for share in shares]
    columns = candidate.entry.columns
    models = [terms.plus(columns, s) for s in sizes]
    trials = judged_each(bank, models, candidate.walk, design)
    best = max(trials, key=lambda t: float(t.nats.sum()))
    near = [k for k, t in enumerate(trials) if _lead(best.nats - t.nats) < 1.0]
    k = min(near, key=lambda k: trials[k].mean_error)
    gains = trials[k].nats - now.nats
    return Taken(candidate, sizes[k], gains, now.mean_error, trials[k].mean_error, ())


def _lead(gains: Array) -> float:
    """A sum of gains in its own standard errors: sum / (√K sd)."""
    total, spread = float(gains.sum()), float(np.std(gains, ddof=1)) * gains.size**0.5
    return total / spread if spread > 0.0 else np.copysign(np.inf, total) if total else 0.0


def _even(gains: Array) -> Array:
    """The gains, none larger than the third largest: a sauna that is foretold by a hundred times
    what an ordinary hour gains is all of the spread, and alone is never two standard errors."""
    most = np.sort(gains)[-_OF_NOTE] if gains.size > _OF_NOTE else np.inf
    return np.asarray(np.minimum(gains, most))


def _objection(trial: Taken, kind: str) -> str:
    need, lead = _GAIN_IN_TIME if kind == "time" else _GAIN, _lead(trial.gains)
    if lead <= need and (kind == "time" or _lead(_even(trial.gains)) <= _GAIN_IN_TIME):
        return (
            f"it does not hold out: {trial.gains.sum():+.1f} nats over {trial.gains.size} blocks "
            f"of time, {lead:.1f} of {need:.1f} standard errors"
        )
    if trial.after >= trial.before:
        more = trial.after / trial.before - 1.0
        return f"it does not hold out: the error on blocks left out grows by {100.0 * more:.1f} %"
    return ""


def _best_of(held: Sequence[Taken]) -> Taken:
    """The largest gain; among those that do as well, a name before a curve, then the evidence."""
    best = max(held, key=lambda t: float(t.gains.sum()))
    alike = [t for t in held if _lead(best.gains - t.gains) < 1.0]
    named = [t for t in alike if not t.found.entry.free] or alike
    chosen = max(named, key=lambda t: t.found.evidence)
    others = (t.found.entry.name for t in held if _lead(chosen.gains - t.gains) < 1.0)
    return replace(chosen, alike=tuple(name for name in others if name != chosen.found.entry.name))
