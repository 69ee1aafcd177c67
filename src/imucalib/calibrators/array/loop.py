"""The array's closed loop: residual -> evidence -> add the effect -> joint refit -> held out.

Everything that could be missing stands in one contest with one false-alarm rate. What wins must
realise its gain in the joint fit of positions, effects and motion, and both held-out halves of the
motion must agree. A curve without a name that explains much more than the best effect has to be
matched by at most three effects together; otherwise they are put back and the curve is reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.calibrators.array.ages import Ages, ages_again, found_ages, kept_ages
from imucalib.calibrators.array.declared import NOTHING_ASKED, Asked, with_declared
from imucalib.calibrators.array.found import CURVE, ArrayLoop, ArrayStep
from imucalib.calibrators.array.held_out import Residuals, held_out_residuals
from imucalib.calibrators.array.moving import Moving
from imucalib.calibrators.array.noise_tests import shared_by_neighbours
from imucalib.calibrators.array.search import Search, absorbed, discounted, search
from imucalib.calibrators.array.setup import Setup
from imucalib.calibrators.array.state import ArrayState, settled, start_state, transferred
from imucalib.calibrators.array.terms import Term
from imucalib.calibrators.array.worth import size_in_words, worth
from imucalib.loop.evidence import Score
from imucalib.loop.found import LoopSettings, Unexplained

__all__ = ["ARRAY_RULES", "ArrayLoop", "ArrayStep", "close_array_loop"]
ARRAY_RULES = LoopSettings(draws=499, most_effects=8)
#: Nats on held-out halves below which they contradict an effect: half of the data may be too few to
#: confirm what all of them show.
_ONE_HALF, _BOTH_HALVES = -3.0, -1.0
_CURVES = 3  # corrections without a name, at most
_PATH = 3  # effects that together may take the place of a curve without a name
_KEEP = 1.0  # nats that an earlier effect must still be worth at the end


@dataclass(frozen=True)
class _Path:
    """Where the search stands. debt : nats that effects still have to explain because a curve
    explained them, since `safe`; taken : how many effects tried to; skipped : what the user
    keeps out of the search; matched : curves that effects took the place of, and the path before;
    corrected : structure without a name that a curve takes out"""

    state: ArrayState
    residuals: Residuals
    steps: tuple[ArrayStep, ...] = ()
    rejected: tuple[tuple[str, str], ...] = ()
    debt: float = 0.0
    taken: int = 0
    safe: _Path | None = None
    skipped: frozenset[str] = frozenset()
    matched: tuple[tuple[str, _Path], ...] = ()
    corrected: tuple[Unexplained, ...] = ()

    @property
    def left_out(self) -> frozenset[str]:
        return self.skipped.union(name for name, _ in self.rejected)


def close_array_loop(
    setup: Setup, terms: tuple[Term, ...], moving: Moving, rng: np.random.Generator,
    rules: LoopSettings = ARRAY_RULES, whole: Setup | None = None, asked: Asked = NOTHING_ASKED,
) -> ArrayLoop:  # fmt: skip
    """Search, accept, refit, until nothing passes.

    whole : more samples, for the final fit alone; asked : effects that the user declares, or keeps
    out of the search
    """
    base = with_declared(start_state(setup, terms), asked.declare, moving)
    ages = found_ages(base, moving)
    before = held_out_residuals(base)
    started = base if ages is None else kept_ages(base, ages, voting=True)
    path = _Path(started, before, skipped=asked.skipped(setup.imus))
    first = found = search(path.state, path.left_out, rng, rules.draws)
    once = True
    while True:
        chosen = _chosen(path, found, rules)
        if chosen is None:
            again = ages_again(path.state, moving, ages) if once else None
            once = False
            if again is not None:
                ages, path = again, replace(path, state=kept_ages(path.state, again, voting=True))
                found = search(path.state, path.left_out, rng, rules.draws)
                continue
            back = path.safe or _matched_in_vain(path, found, rules.alpha)
            if back is None:
                break
            path = replace(back, debt=-1.0)
            found = search(path.state, path.left_out, rng, rules.draws)
            break
        before_it = path.state
        path = _tried(path, found, chosen, rules, ages)
        if path.state is not before_it:
            found = search(path.state, path.left_out, rng, rules.draws)
    path, found = _with_curves(path, found, rules, rng) if rules.curves else (path, found)
    path = _eliminated(path)
    final, ages = _on_all(path, ages, moving, whole)
    left = tuple(
        _without_a_name(s)
        for s in found.scores
        if asked.search and s.candidate.kind != "effect" and s.p <= rules.alpha
    )
    moved = bool(path.steps or asked.declare)
    return ArrayLoop(
        base, final, ages, before, held_out_residuals(final) if moved else before, path.steps,
        path.rejected, (*path.corrected, *left[:3]), found.scores, first.scores,
        absorbed((first, found)), shared_by_neighbours(final, gyro=False), found.missing, asked,
    )  # fmt: skip


def _matched_in_vain(path: _Path, found: Search, alpha: float) -> _Path | None:
    """Where the path stood before effects took the place of a curve that still stands out."""
    passing = {s.name for s in found.scores if s.p <= alpha}
    return next((before for curve, before in path.matched if curve in passing), None)


def _chosen(path: _Path, found: Search, rules: LoopSettings) -> Score | None:
    """The best effect; where a curve leads by more than the margin, still the best effect."""
    if len(path.steps) >= rules.most_effects or path.taken >= _PATH:
        return None
    passing = (
        s for s in found.scores
        if s.candidate.kind == "effect" and s.p <= rules.alpha and s.name not in path.left_out
    )  # fmt: skip
    return next(passing, None)


def _tried(
    path: _Path, found: Search, chosen: Score, rules: LoopSettings, ages: Ages | None
) -> _Path:
    """The path with the effect, or with the reason why not."""
    term = found.term(chosen.name)
    trial = settled(replace(path.state, terms=(*path.state.terms, term)))
    gains = found.held_out(chosen.name)
    reason = _why_not(path.state, trial, gains)
    if not reason:
        factor = shared_by_neighbours(trial, gyro=term.effect.channel == "angular_rate")
        late = discounted(chosen, factor, found.null)
        if late.p > rules.alpha:
            reason = f"noise that neighbours share explains it as well (p {late.p:.2g})"
    if reason:
        return replace(path, rejected=(*path.rejected, (chosen.name, reason)))
    step = _step(path, trial, found, chosen, gains)
    leader = next(
        s for s in found.scores
        if s.candidate.kind != "noise" and s.name not in path.left_out
    )  # fmt: skip
    gained = trial.density - path.state.density
    grown = replace(path, state=trial, residuals=step.after, steps=(*path.steps, step))
    if path.safe is None:
        if leader.candidate.kind == "effect":
            return grown
        grown = replace(grown, matched=(*path.matched, (leader.name, path)))
        if leader.evidence <= chosen.evidence + rules.margin:
            return grown
        grown = replace(grown, safe=path, debt=leader.evidence - rules.margin)
    debt = grown.debt - gained
    if debt <= 0.0:
        return replace(grown, safe=None, debt=0.0, taken=0)
    return replace(grown, debt=debt, taken=grown.taken + 1)


def _with_curves(
    path: _Path, found: Search, rules: LoopSettings, rng: np.random.Generator
) -> tuple[_Path, Search]:
    """The path with structure that has no name corrected by curves, where both halves gain."""
    for _ in range(_CURVES):
        probes = (s for s in found.scores if s.p <= rules.alpha and found.correctable(s.name))
        chosen = next(probes, None)
        if chosen is None:
            break
        gains = found.held_out(chosen.name)
        term = found.term(chosen.name)
        term = replace(term, name=CURVE + term.name)
        trial = settled(replace(path.state, terms=(*path.state.terms, term)))
        if min(gains) <= 0.0 or _why_not(path.state, trial, gains):
            break
        named = replace(chosen, candidate=replace(chosen.candidate, name=term.name))
        step = replace(_step(path, trial, found, named, gains), aliases=())
        path = replace(
            path, state=trial, residuals=step.after, steps=(*path.steps, step),
            corrected=(*path.corrected, _without_a_name(chosen)),
        )  # fmt: skip
        found = search(path.state, path.left_out, rng, rules.draws)
    return path, found


def _without_a_name(s: Score) -> Unexplained:
    return Unexplained(s.name, s.candidate.driver, s.candidate.kind, s.p, s.evidence, s.share)


def _why_not(before: ArrayState, after: ArrayState, gains: tuple[float, float]) -> str:
    if len(after.terms[-1].value) == 0:
        return "these data determine none of its parameters"
    if not after.converged:
        return "its refit did not converge"
    term = after.terms[-1]
    implausible = [
        f"{p.name} = {v:.3g} {p.unit}"
        for p, v in zip(term.parameters(after.setup.imus), term.theta, strict=True)
        if abs(v) > p.plausible
    ]
    if implausible:
        return f"implausible size ({', '.join(implausible)})"
    if after.density <= before.density:
        return "the joint fit is not better with it"
    if min(gains) < _ONE_HALF or sum(gains) < _BOTH_HALVES:
        return f"it does not hold out: {gains[0]:+.1f} and {gains[1]:+.1f} nats on the other half"
    return ""


def _step(
    path: _Path, after: ArrayState, found: Search, chosen: Score, gains: tuple[float, float]
) -> ArrayStep:
    near = max(chosen.evidence - 3.0, chosen.evidence / 2.0)
    aliases = tuple(
        s.name for s in found.scores
        if s.candidate.kind == "effect" and s.name != chosen.name and s.evidence >= near
    )  # fmt: skip
    return ArrayStep(
        chosen.name, size_in_words(after, after.terms[-1]), chosen.p, chosen.draws,
        chosen.evidence, gains, path.residuals, held_out_residuals(after), aliases,
    )  # fmt: skip


def _eliminated(path: _Path) -> _Path:
    """Without earlier effects that later ones have made unnecessary."""
    for step in path.steps[:-1]:
        term = next(t for t in path.state.terms if t.name == step.effect)
        if worth(path.state, term) >= _KEEP:
            continue
        left = tuple(t for t in path.state.terms if t.name != step.effect)
        state = settled(replace(path.state, terms=left))
        steps = tuple(s for s in path.steps if s.effect != step.effect)
        reason = "made unnecessary by later effects"
        path = replace(
            path, state=state, steps=steps, rejected=(*path.rejected, (step.effect, reason))
        )
    return path


def _on_all(
    path: _Path, ages: Ages | None, moving: Moving, whole: Setup | None
) -> tuple[ArrayState, Ages | None]:
    """The final fit on all samples; accepted clocks with their phases from all of the motion."""
    state = path.state
    aged = any(term.aged for term in state.terms)
    if whole is None and not aged:
        return state, None
    moved = state if whole is None else transferred(state, whole)
    if not aged:
        return settled(moved), None
    again = found_ages(moved, moving, all_rows=True)
    if again is None:
        return state, ages
    return settled(kept_ages(moved, again, voting=False)), again
