"""The array's closed loop: residual -> evidence -> add the effect -> joint refit -> held out.

Everything that could be missing stands in one contest with one false-alarm rate. What wins must
realise its gain in the joint fit of positions, effects and motion, and both held-out halves of the
motion must agree. A curve without a name that explains much more than the best effect has to be
matched by at most three effects together; otherwise they are put back and the curve is reported.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.calibrators.array_ages import Ages, found_ages, kept_ages
from imucalib.calibrators.array_declared import NOTHING_ASKED, Asked, with_declared
from imucalib.calibrators.array_held_out import Residuals, held_out_residuals
from imucalib.calibrators.array_moving import Moving
from imucalib.calibrators.array_noise_tests import shared_by_neighbours
from imucalib.calibrators.array_search import Search, absorbed, discounted, search
from imucalib.calibrators.array_setup import Setup
from imucalib.calibrators.array_state import ArrayState, settled, start_state, transferred
from imucalib.calibrators.array_terms import Term
from imucalib.calibrators.array_worth import size_in_words, worth
from imucalib.evidence import Score
from imucalib.loop import LoopSettings, Unexplained

Array = NDArray[np.float64]
ARRAY_RULES = LoopSettings(draws=499, most_effects=8)
#: Nats on held-out halves below which they contradict an effect: half of the data may be too few to
#: confirm what all of them show.
_ONE_HALF, _BOTH_HALVES = -3.0, -1.0
_PATH = 3  # effects that together may take the place of a curve without a name
_CERTAIN = 0.01  # family-wise p from which on an effect without aliases is called certain
_KEEP = 1.0  # nats that an earlier effect must still be worth at the end


@dataclass(frozen=True)
class ArrayStep:
    """One accepted effect. value : its size in words; held_out : nats that the two halves gain;
    before, after : held-out residuals"""

    effect: str
    value: str
    p: float
    draws: int
    evidence: float
    held_out: tuple[float, float]
    before: Residuals
    after: Residuals
    aliases: tuple[str, ...]

    @property
    def certain(self) -> bool:
        """Nothing else would do as well, and chance would not do it in a hundred searches."""
        return not self.aliases and self.p <= _CERTAIN


@dataclass(frozen=True)
class ArrayLoop:
    """The whole search.

    base, final : fitted states before and after; ages : clocks of the gyros, or None
    before, after : held-out residuals; scores : of the last search; absorbed : what cannot be seen,
    with the m rms by which its typical size moves the positions; dispersion : how many times fewer
    accelerometer samples the noise that neighbours share leaves; asked : what the user declared
    """

    base: ArrayState
    final: ArrayState
    ages: Ages | None
    before: Residuals
    after: Residuals
    steps: tuple[ArrayStep, ...]
    rejected: tuple[tuple[str, str], ...]
    unexplained: tuple[Unexplained, ...]
    scores: tuple[Score, ...]
    first_scores: tuple[Score, ...]
    absorbed: dict[str, float]
    dispersion: float
    missing: dict[str, str] = field(default_factory=dict)
    asked: Asked = NOTHING_ASKED

    @property
    def verdict(self) -> str:
        if self.steps:
            return "explained in part" if self.unexplained else "explained"
        return "unexplained" if self.unexplained else "nothing missing"


@dataclass(frozen=True)
class _Path:
    """Where the search stands. debt : nats that effects still have to explain because a curve
    explained them, since `safe`; taken : how many effects tried to; skipped : what the user
    keeps out of the search"""

    state: ArrayState
    residuals: Residuals
    steps: tuple[ArrayStep, ...] = ()
    rejected: tuple[tuple[str, str], ...] = ()
    debt: float = 0.0
    taken: int = 0
    safe: _Path | None = None
    skipped: frozenset[str] = frozenset()

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
    while True:
        chosen = _chosen(path, found, rules)
        if chosen is None:
            if path.safe is None:
                break
            path = replace(path.safe, debt=-1.0)
            found = search(path.state, path.left_out, rng, rules.draws)
            break
        before_it = path.state
        path = _tried(path, found, chosen, rules, ages)
        if path.state is not before_it:
            found = search(path.state, path.left_out, rng, rules.draws)
    path = _eliminated(path)
    final, ages = _on_all(path, ages, moving, whole)
    left = tuple(
        Unexplained(s.name, s.candidate.driver, s.candidate.kind, s.p, s.evidence, s.share)
        for s in found.scores
        if asked.search and s.candidate.kind != "effect" and s.p <= rules.alpha
    )
    moved = bool(path.steps or asked.declare)
    return ArrayLoop(
        base, final, ages, before, held_out_residuals(final) if moved else before, path.steps,
        path.rejected, left[:3], found.scores, first.scores,
        absorbed((first, found)), shared_by_neighbours(final, gyro=False), found.missing, asked,
    )  # fmt: skip


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
        factor = shared_by_neighbours(trial, gyro=term.effect.sensor == "gyroscope")
        late = discounted(chosen, factor, found.null)
        if late.p > rules.alpha:
            reason = f"noise that neighbours share explains it as well (p {late.p:.2g})"
    if reason:
        return replace(path, rejected=(*path.rejected, (chosen.name, reason)))
    step = _step(path, trial, found, chosen, gains)
    leader = next(s for s in found.scores if s.candidate.kind != "noise")
    gained = trial.density - path.state.density
    grown = replace(path, state=trial, residuals=step.after, steps=(*path.steps, step))
    if path.safe is None:
        if leader.candidate.kind == "effect" or leader.evidence <= chosen.evidence + rules.margin:
            return grown
        grown = replace(grown, safe=path, debt=leader.evidence - rules.margin)
    debt = grown.debt - gained
    if debt <= 0.0:
        return replace(grown, safe=None, debt=0.0, taken=0)
    return replace(grown, debt=debt, taken=grown.taken + 1)


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
    aged = any(term.effect.needs_age for term in state.terms)
    if whole is None and not aged:
        return state, None
    moved = state if whole is None else transferred(state, whole)
    if not aged:
        return settled(moved), None
    again = found_ages(moved, moving, all_rows=True)
    if again is None:
        return state, ages
    return settled(kept_ages(moved, again, voting=False)), again
