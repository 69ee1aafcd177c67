"""One search of the array's loop: everything that could be missing, scored in one contest.

The engine is the shared one (`estimators/contest`), fed with products from which the motion of
every sample, the positions and the terms are taken out. Data that lack nothing are simulated only
where a candidate could be one of their accidents. Noise of another kind stands in the same
contest: its likelihood ratio against white noise of one size, under which its root is half a
standard normal.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.loop.candidates import Entry, candidates
from imucalib.calibrators.array.loop.curves import wander
from imucalib.calibrators.array.loop.earlier import Earlier
from imucalib.calibrators.array.loop.noise_tests import NoiseTest, best_of_noise, noise_tests
from imucalib.calibrators.array.loop.setup import looked_at
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.terms import OPEN, Term, determined, typical_of
from imucalib.calibrators.array.loop.worth import TAU, Beside, beside, shared_ahead
from imucalib.estimators.array.bordered import Each, Taking, each_beside, noise_products
from imucalib.estimators.array.gram import starts_of
from imucalib.estimators.contest import Contest, best_of_null, directions_of
from imucalib.loop.evidence import Candidate, Score
from imucalib.loop.subject import Searched

ABSORBED = 1e-5  # share of a block, beyond what the motion takes, that the rest must leave


@dataclass(frozen=True)
class Search(Searched):
    """scores : p of those that no simulated data reach, 1 for all others: `drawn` has theirs
    state : where it was; entries by name; contest : of those that can be seen; base : what was
    taken out; rejected, seed, draws : of the simulated data, earlier : those that serve as well
    impact : m rms that a candidate's typical size moves the positions
    asked : candidates by themselves, as far as they were asked for"""

    state: ArrayState
    entries: dict[str, Entry]
    contest: Contest
    base: Taking
    rejected: frozenset[str]
    seed: int
    draws: int
    earlier: Earlier
    impact: dict[str, float]
    asked: dict[str, Beside] = field(default_factory=dict)

    @cached_property
    def null(self) -> Array:
        """(draws,) the best evidence on data that lack nothing, and whose noise is as modelled."""
        return self.earlier.chance(self.state, self._drawn_null)

    def _drawn_null(self) -> Array:
        rng = np.random.default_rng(self.seed)
        state = replace(self.state)  # without its columns: a search outlives them
        rows = state.setup.inner[looked_at(state.setup)]
        sampled, own = state.base.take(rows)
        every, all_rows = (
            [*own, *candidates(state, self.rejected, rows).blocks],
            np.arange(len(rows)),
        )

        def noise(count: int) -> tuple[Array, Array]:
            along, power = noise_products(sampled, every, all_rows, rng, count)
            own = state.base.along(along[: state.base.raw].T).T
            return self.base.out_of_noise(own, along[state.base.raw :], power, rng)

        tests = sum(s.candidate.kind == "noise" for s in self.scores)
        best = best_of_null(self.contest, noise, self.draws)
        return np.maximum(best, best_of_noise(tests, rng, self.draws))

    @cached_property
    def drawn(self) -> tuple[Score, ...]:
        """The scores, each with its p by simulated data."""
        return tuple(s if s.absorbed else self.by_chance(s) for s in self.scores)

    def passing(self, alpha: float) -> Iterator[Score]:
        """Those that stand out, best first; data are simulated where the question is open."""
        for score in self.scores:
            known = score if score.p <= alpha else self.by_chance(score)
            if score.absorbed or known.p > alpha:
                return
            yield known

    def by_chance(self, score: Score, factor: float = 1.0) -> Score:
        """A score as if there were `factor` times fewer samples: noise that neighbours share."""
        value, bar = score.evidence / factor, self.contest.beyond_chance(self.draws)
        if value >= bar:
            return replace(score, evidence=value, p=1.0 / (self.draws + 1))
        reached, draws = int((self.null >= value).sum()), len(self.null)
        return replace(score, evidence=value, p=(1 + reached) / (draws + 1), draws=draws)

    def beside(self, name: str) -> Beside:
        """Made where it is asked for: of all candidates of many IMUs they would be large."""
        if name not in self.asked:
            self.asked[name] = beside(self.state, self.entries[name])
        return self.asked[name]

    def held_out(self, name: str) -> tuple[float, float]:
        """Nats that each half gains when the other has estimated the candidate and its size."""
        return self.beside(name).held_out

    def shared(self, name: str, state: ArrayState) -> float:
        """How many times fewer samples are left beside a candidate, at the least; state : the same
        as its own, with its columns."""
        return shared_ahead(state, self.entries[name], self.beside(name))

    def aliases(self, chosen: Score) -> tuple[str, ...]:
        """Other effects that have nearly as many nats as the chosen one; of a curve none."""
        if chosen.candidate.kind != "effect":
            return ()
        near = max(chosen.evidence - 3.0, chosen.evidence / 2.0)
        others = (s for s in self.scores if s.candidate.kind == "effect" and s.name != chosen.name)
        return tuple(s.name for s in others if s.evidence >= near)

    def moves(self, name: str) -> float:
        """m rms over the positions' coordinates: what taking a candidate in would move them by, or
        how far it says that one IMU moves; zero for noise, which has no columns."""
        if name not in self.entries:
            return 0.0
        effect, found = self.entries[name].effect, self.beside(name)
        return max(found.moves, wander(effect, found.value) if effect else 0.0)

    def correctable(self, name: str) -> bool:
        """Whether it is a curve that may be corrected. What all accelerometers share as a function
        of the force bends the array's shape: there a curve is no better than the error."""
        entry = self.entries.get(name)
        if entry is None or entry.effect is None or entry.kind != "probe":
            return False
        return not (entry.effect.shared and entry.effect.channel == "acceleration")

    def term(self, name: str) -> Term:
        """A candidate as a new term: the directions that the data can determine, at zero."""
        entry, found = self.entries[name], self.beside(name)
        assert entry.effect is not None
        if entry.kind == "effect":
            matrix = found.whole.matrix
            return determined(name, entry.effect, entry.only, matrix, self.state.found)
        kept = found.apart
        live = typical_of(entry.effect, len(kept))[:, None] * kept
        n = kept.shape[1]
        return Term(name, entry.effect, entry.only, live, np.zeros(n), np.ones(n))


def search(
    state: ArrayState, rejected: frozenset[str], rng: np.random.Generator, draws: int,
    earlier: Earlier,
) -> Search:  # fmt: skip
    """Score all candidates at a fitted state."""
    rows = state.setup.inner[looked_at(state.setup)]
    found = candidates(state, rejected, rows)
    starts, b = starts_of(found.blocks), len(state.base.prior)
    index = {e.name: starts[e.block] + e.part for e in found.entries}
    products = state.base.beside(found.blocks, rows)
    entries, missing = found.entries, found.missing
    del found
    prior = state.base.rests
    each = each_beside(products, prior, state.base.pull * (prior > 0.0))
    freedom = products.base.numbers - b
    before, after = (np.concatenate([np.diag(own) for own in x.own]) for x in (products, each))
    del products
    left = {n: float(after[at].sum() / max(before[at].sum(), 1e-300)) for n, at in index.items()}
    size = {n: float(np.sqrt(max(after[at].sum(), 0.0))) for n, at in index.items()}
    live = [e for e in entries if left[e.name] >= ABSORBED and size[e.name] >= OPEN]
    moved = np.sqrt(np.mean(each.base.carry(state.positions) ** 2, axis=0))
    # Absorbed columns are rounding errors: they must not enter the contest.
    sound, scale = after > 1e-9 * before, each.power / max(freedom, 1)
    contest = _contest(each, live, starts, sound, scale, freedom)
    evidence = contest.told(
        each.along / scale, each.power / scale,
        np.array([before[index[e.name]].sum() / scale for e in live]), np.zeros(0),
    )  # fmt: skip
    told = {
        e.name: (float(evidence.evidence[k]), float(evidence.share[k])) for k, e in enumerate(live)
    }
    scores = [_score(e, told.get(e.name), left[e.name], size[e.name]) for e in entries]
    scores += [_noise_score(test) for test in noise_tests(state)]
    return Search(
        scores=_first_told(scores, contest, draws),
        missing=missing,
        state=replace(state),  # without its columns: a search outlives them
        entries={e.name: e for e in entries},
        contest=contest,
        base=each.base,
        rejected=rejected,
        seed=int(rng.integers(2**63)),
        draws=draws,
        earlier=earlier,
        impact={e.name: float(np.linalg.norm(moved[index[e.name]])) for e in entries},
    )


def _first_told(scores: list[Score], contest: Contest, draws: int) -> tuple[Score, ...]:
    """Best first, with the p of what no simulated data reach, and 1 for all else."""
    bar, least = contest.beyond_chance(draws), 1.0 / (draws + 1)
    told = [replace(s, p=least if s.evidence >= bar else 1.0, draws=draws) for s in scores]
    return tuple(sorted(told, key=lambda s: -s.evidence))


def _contest(
    each: Each, live: list[Entry], starts: Index, sound: Flags, scale: float, freedom: int
) -> Contest:
    """Of entries whose columns are not absorbed; scale : the noise's variance in units of what is
    stated."""
    blocks, grams = [], []
    for entry in live:
        part = entry.part[sound[starts[entry.block] + entry.part]]
        blocks.append(starts[entry.block] + part)
        grams.append(each.own[entry.block][np.ix_(part, part)] / scale)
    size, turns = directions_of(grams)
    return Contest(blocks, size, turns, freedom, TAU)


def _score(entry: Entry, told: tuple[float, float] | None, left: float, strength: float) -> Score:
    """told : evidence and share of the power, None for what cannot be seen"""
    bare = Candidate(entry.name, entry.kind, np.zeros((0, len(entry.part))), entry.driver)
    evidence, share = told or (0.0, 0.0)
    return Score(
        candidate=bare,
        evidence=evidence,
        p=1.0,
        draws=0,
        left=0.0 if told is None else left,
        strength=strength,
        share=share,
    )


def _noise_score(test: NoiseTest) -> Score:
    bare = Candidate(test.name, "noise", np.zeros((0, 1)), test.driver)
    return Score(
        candidate=bare, evidence=test.evidence, p=1.0, draws=0, left=1.0, strength=test.strength,
        share=0.0,
    )  # fmt: skip


def absorbed(searches: tuple[Search, ...]) -> dict[str, float]:
    """What no motion shows, and by how much its typical size moves the positions."""
    found: dict[str, float] = {}
    for one in searches:
        for score in one.scores:
            if score.candidate.kind == "effect" and score.absorbed and "@" not in score.name:
                found[score.name] = one.impact[score.name]
    return found
