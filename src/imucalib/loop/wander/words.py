"""A search of this room in the words of the one loop: scores, steps, what stays unexplained."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.effects import catalogue
from imucalib.effects.shape import in_words, is_form
from imucalib.loop.evidence import Candidate, Score
from imucalib.loop.found import Checked, Step, Unexplained, Wander
from imucalib.loop.thresholds import STRONG
from imucalib.loop.wander.bank import Bank
from imucalib.loop.wander.choice import Refused, Search, Taken, same
from imucalib.loop.wander.likelihood import Terms
from imucalib.loop.wander.noise import usable_walks
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.scores import Entry, Scored, scored
from imucalib.units import MG

#: λ sin(angle) below which two effects are not told apart, and nats that are no difference.
_APART, _ALIKE = 2.0, 3.0
#: Kinds of structure that is told with a driver, and is no noise.
_STRUCTURE = ("swing", "course", "jump", "stretch")
#: What follows the past of the temperature, of whatever value.
PAST = ("thermal_lag", "thermal_hysteresis", "temperature_rate")
#: What follows its present. A past of it is one of thirteen that were tried, and a day samples them
#: seldom: it leads the present by as much as a form of the temperature has to.
_CLOCK = "time_of_day"
_NOW = "temperature_bias"
#: What stands beside a name of a size that no data sheet tells: another effect, of nobody's list.
UNLISTED = "unlisted_effect"
#: Kinds of response, each with the free functions that hold what it leaves.
_OF_RESPONSE = {"shape": ("curve", "posture"), "curve": ("posture", "shape"), "posture": ("curve",)}


def chance_of(found: Scored, chance: Array) -> float:
    """Family-wise p: how often the best of its half of the candidates does as well on data that
    lack nothing, times two for the halves."""
    own = chance[int(found.entry.timed)]
    return float(min(1.0, 2.0 * (1.0 + np.sum(own >= found.evidence)) / (own.size + 1.0)))


def scores_of(
    problem: Problem, found: Sequence[Scored], chance: Array, bar: Array
) -> tuple[Score, ...]:
    """Best first; of a scan over a value only the best."""
    out, seen = list[Score](), set[str]()
    bank = problem.bank
    for s in found:
        if s.entry.family and s.entry.kind != "curve":
            if s.entry.family in seen:
                continue
            seen.add(s.entry.family)
        column = np.linalg.norm(bank.columns[:, s.entry.columns]) / len(bank.columns) ** 0.5
        size = float(column) * problem.noise.scatter * MG
        candidate = Candidate(s.entry.name, "effect", np.zeros((0, 0)), family=s.entry.family)
        p, nats = chance_of(s, chance), float(bar[int(s.entry.timed)])
        out.append(
            Score(
                candidate=candidate,
                evidence=s.evidence,
                p=p,
                draws=chance.shape[1],
                left=s.left,
                strength=s.strength,
                share=s.share,
                size=size,
                bar=nats,
            )
        )
    return tuple(out)


def steps_of(problem: Problem, found: Search, chances: Sequence[Array]) -> tuple[Step, ...]:
    steps, terms = list[Step](), problem.terms
    unit = problem.noise.scatter * MG
    for taken, chance in zip(found.taken, chances, strict=False):
        checked = Checked("error", "m/s2", taken.before * unit, taken.after * unit)
        steps.append(
            Step(
                taken.found.entry.name,
                chance_of(taken.found, chance),
                chance.shape[1],
                taken.found.evidence,
                (checked,),
                (
                    *aliases(found.bank, terms, taken),
                    *([taken.form] if taken.form else ()),
                    *_beside(taken, found.taken),
                ),
                gains=tuple(float(g) for g in taken.gains),
                curve=taken.found.entry.name.startswith("curve@"),
            )
        )
        terms = terms.plus(taken.found.entry.columns, taken.size)
    return tuple(steps)


def beside_others(problem: Problem, found: Search, steps: Sequence[Step]) -> tuple[Step, ...]:
    """The steps with what would do as well in the place of each, beside all others that were taken:
    a lag that was found first is a step of the bias once the temperature is known."""
    if len(found.taken) < 2:
        return tuple(steps)
    rest = [e for e in problem.entries if not any(same(e, t.found.entry) for t in found.taken)]
    return with_rivals(problem, found, steps, rest)


def with_rivals(
    problem: Problem, found: Search, steps: Sequence[Step], entries: Sequence[Entry]
) -> tuple[Step, ...]:
    """The steps with those of the entries that would do as well in the place of each."""
    bank, out = found.bank, list[Step]()
    keep = np.ones(bank.course.parts, dtype=bool)
    walks = usable_walks(bank, found.level, same_tau=False)
    for taken, step in zip(found.taken, steps, strict=False):
        terms = problem.terms
        for other in found.taken:
            if other is not taken:
                terms = terms.plus(other.found.entry.columns, other.size)
        scores, _ = scored(bank, terms, keep, [taken.found.entry, *entries], walks, told=False)
        own = next(s for s in scores if s.entry is taken.found.entry)
        names = aliases(bank, terms, replace(taken, found=own, rivals=scores))
        out.append(replace(step, aliases=_best_of_each_scan([*step.aliases, *names])))
    return tuple(out)


def beside_left(
    found: Search, steps: Sequence[Step], left: Sequence[Unexplained]
) -> tuple[Step, ...]:
    """The steps, with an unlisted effect beside those of which structure that is told tells more:
    what its own driver still does, or what is stronger than it."""
    # Noise that is larger for a while explains no share.
    told = [one for one in left if one.kind in _STRUCTURE and one.share > 0.0]
    out = list[Step]()
    for taken, step in zip(found.taken, steps, strict=True):
        kind = taken.found.entry.kind
        if any(one.driver == kind or one.evidence >= step.evidence for one in told):
            step = replace(step, aliases=_best_of_each_scan([*step.aliases, UNLISTED]))  # noqa: PLW2901
        out.append(step)
    return tuple(out)


def _beside(taken: Taken, every: Sequence[Taken]) -> tuple[str, ...]:
    """Free functions of the response that were taken as well: what needs one beside its name has
    another form than the name's. So has what follows the past of the temperature where something
    else follows the temperature too: a play of another width, or a thermometer whose clock is late,
    leaves as much. The temperature swings once a day, and so does what a longer lag leaves."""
    own = taken.found.entry
    others = [t.found.entry for t in every if t is not taken]
    if own.name.partition("@")[0] in PAST:
        also = any(e.kind == own.kind or e.name.endswith(_CLOCK) for e in others)
        return (UNLISTED,) if also else ()
    if own.name.endswith(_CLOCK) and any(e.name.partition("@")[0] in PAST for e in others):
        return (UNLISTED,)
    return tuple(e.name for e in others if e.kind in _OF_RESPONSE.get(own.kind, ()))


def aliases(bank: Bank, terms: Terms, taken: Taken) -> tuple[str, ...]:
    """Names that would do as well: nearly the same evidence, or too small an angle between.

    A curve of an axis is no rival of a name: it contains every shape of it. What else may have any
    form is one by its evidence alone, for its angle to what it contains is none; beside another
    free function also where it does as well on blocks left out, for the evidence of both hangs on
    how rough a curve may be. What holds the effect and more has to lead it. What the size of
    gravity alone shows as a part of the effect is always one.
    """
    own = taken.found
    near = max(own.evidence - _ALIKE, own.evidence / 2.0)
    out = list[str]()
    for rival in taken.rivals:
        entry = rival.entry
        same = entry.name == own.entry.name or (entry.family and entry.family == own.entry.family)
        other = entry.kind == "curve" and own.entry.kind != "curve"
        if same or other or rival.evidence < own.evidence / 2.0:
            continue
        if entry.free:
            alike = own.entry.free and entry.name in taken.alike
        else:
            alike = _apart(bank, terms, own, rival) < _APART
        least = own.evidence if entry.wide else near
        if entry.name == _NOW and own.entry.name.partition("@")[0] in PAST:
            least = own.evidence - STRONG
        if rival.evidence >= least or alike:
            out.append(entry.name)
    return _best_of_each_scan([*out, *_of_one_whole(own.entry.name)])


def _of_one_whole(name: str) -> list[str]:
    """What the size of gravity alone shows as a part of an effect, and what that is a part of."""
    effects = catalogue()
    parts = [effect.name for effect in effects.values() if effect.part_of == name]
    own = effects[name].part_of if name in effects else ""
    return [*parts, *([own] if own else [])]


def _best_of_each_scan(names: Sequence[str]) -> tuple[str, ...]:
    first: dict[str, str] = {}
    for name in names:
        first.setdefault(name.partition("@")[0], name)
    return tuple(first.values())


def _apart(bank: Bank, terms: Terms, own: Scored, rival: Scored) -> float:
    """Length of the fitted effect, in noise units, that its rival cannot take over."""
    blocks = [terms.columns, own.entry.columns, rival.entry.columns]
    ends = np.cumsum([block.size for block in blocks])
    white = bank.white(own.walk, np.concatenate([*blocks, [bank.data]]))
    base, columns, others = np.split(white[:, :-1], ends[:-1], axis=1)
    data, q = white[:, -1], np.linalg.qr(base)[0]
    rest = columns - q @ (q.T @ columns)
    precise = rest.T @ rest + np.eye(rest.shape[1]) / own.size**2
    effect = rest @ np.linalg.solve(precise, rest.T @ data)
    both = np.linalg.qr(np.column_stack([base, others]))[0]
    return float(np.linalg.norm(effect - both @ (both.T @ effect)))


def looked_like(
    refused: Sequence[Refused], steps: Sequence[Step], chance: Array,
    driver: Callable[[str], str],
) -> tuple[Unexplained, ...]:  # fmt: skip
    """The strongest of what was not taken: too strong to be one of the accidents that a bar allows,
    it is structure without a name; what a step calls its alias is told there."""
    told = {name.partition("@")[0] for step in steps for name in step.aliases}
    new = [r for r in refused if r.name.partition("@")[0] not in told]
    strong = [r for r in new if r.found.evidence > STRONG]
    if not strong:
        return ()
    most = max(strong, key=lambda r: r.found.evidence)
    found = most.found
    like = in_words(most.name) if is_form(most.name) else most.name
    name = f"what looks like {like} and was not taken: {most.reason}"
    by, p = driver(found.entry.name), chance_of(found, chance)
    return (Unexplained(name, by, "probe", p, found.evidence, found.share),)


def unexplained(wander: Wander) -> tuple[Unexplained, ...]:
    """The walk, where nothing was found and it carries more than the scatter of a run."""
    if not wander.counts:
        return ()
    # Twice the gain of two parameters, one on its border: chi-square of two overstates p.
    p = float(np.exp(-wander.evidence))
    share = wander.size**2 / (wander.size**2 + wander.scatter**2)
    return (Unexplained(wander.words, "order", "noise", p, wander.evidence, share),)
