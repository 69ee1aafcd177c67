"""One search of the array's loop: everything that could be missing, scored in one contest.

The engine is the shared one (`evidence_gram`), fed with Gram matrices from which the motion of
every sample, the positions and the terms are taken out. Noise of another kind stands in the same
contest: its likelihood ratio against white noise of one size, under which its root is half a
standard normal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.loop.candidates import Entry, candidates
from imucalib.calibrators.array.loop.noise_tests import NoiseTest, noise_tests
from imucalib.calibrators.array.loop.setup import looked_at
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.terms import OPEN, Term, determined, typical_of
from imucalib.calibrators.array.loop.worth import TAU, Beside, beside
from imucalib.estimators.array.gram import gram, starts_of
from imucalib.estimators.array.reduced import Reduced, reduced
from imucalib.loop.evidence import Candidate, Score
from imucalib.loop.evidence_gram import GramEvidence, block_evidence
from imucalib.loop.subject import Searched

ABSORBED = 1e-5  # share of a block, beyond what the motion takes, that the rest must leave


@dataclass(frozen=True)
class Search(Searched):
    """state : where it was; entries by name; null : the best evidences of simulated data
    impact : m rms that a candidate's typical size moves the positions
    asked : candidates by themselves, as far as they were asked for"""

    state: ArrayState
    entries: dict[str, Entry]
    null: Array
    impact: dict[str, float]
    asked: dict[str, Beside] = field(default_factory=dict)

    def beside(self, name: str) -> Beside:
        """Made where it is asked for: of all candidates of many IMUs they would be large."""
        if name not in self.asked:
            self.asked[name] = beside(self.state, self.entries[name])
        return self.asked[name]

    def held_out(self, name: str) -> tuple[float, float]:
        """Nats that each half gains when the other has estimated the candidate and its size."""
        return self.beside(name).held_out

    def moves(self, name: str) -> float:
        """m rms over the positions' coordinates: what taking a candidate in would move them by;
        zero for noise, which has no columns."""
        if name not in self.entries:
            return 0.0
        return self.beside(name).moves

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
            return determined(name, entry.effect, entry.only, found.whole.matrix)
        kept = found.apart
        live = typical_of(entry.effect, len(kept))[:, None] * kept
        n = kept.shape[1]
        return Term(name, entry.effect, entry.only, live, np.zeros(n), np.ones(n))


def search(
    state: ArrayState, rejected: frozenset[str], rng: np.random.Generator, draws: int
) -> Search:
    """Score all candidates at a fitted state."""
    found = candidates(state, rejected)
    starts, b = starts_of(found.blocks), len(state.base.prior)
    index = {e.name: starts[e.block] + e.part for e in found.entries}
    rows = state.setup.inner[looked_at(state.setup)]
    total = state.base.free(gram(state.sampled, [*state.base.blocks, *found.blocks], rows))
    entries, missing = found.entries, found.missing
    del found
    prior = state.base.rests
    own_size = np.diag(total.matrix)[b:].copy()
    whole = reduced(total, prior, state.base.pull * (prior > 0.0))
    diagonal = own_size, np.diag(whole.matrix).copy()
    left = {n: float(diagonal[1][at].sum() / max(diagonal[0][at].sum(), 1e-300))
            for n, at in index.items()}  # fmt: skip
    size = {n: float(np.sqrt(max(diagonal[1][at].sum(), 0.0))) for n, at in index.items()}
    live = [e for e in entries if left[e.name] >= ABSORBED and size[e.name] >= OPEN]
    own = [index[e.name] for e in live]
    freedom = total.numbers - b
    moved = np.sqrt(np.mean(whole.carry[: state.positions] ** 2, axis=0))
    contest = _contest(whole, diagonal[0], own, freedom, rng, draws)
    del total, whole  # of many IMUs they are large, as the columns are
    evidence = contest()
    noises = noise_tests(state, rng, draws)
    null = np.maximum(evidence.best, noises.null)
    value = dict(zip((e.name for e in live), evidence.evidence, strict=True))
    share = dict(zip((e.name for e in live), evidence.share, strict=True))
    scores = [
        _score(e, value.get(e.name), left[e.name], size[e.name], share.get(e.name, 0.0), null)
        for e in entries
    ]
    scores += [_noise_score(test, null) for test in noises.tests]
    impact = {e.name: float(np.linalg.norm(moved[index[e.name]])) for e in entries}
    return Search(
        scores=tuple(sorted(scores, key=lambda s: -s.evidence)),
        missing=missing,
        state=replace(state),  # without its columns: a search outlives them
        entries={e.name: e for e in entries},
        null=null,
        impact=impact,
    )


def _contest(
    whole: Reduced, size: Array, own: list[Index], freedom: int, rng: np.random.Generator,
    draws: int,
) -> Callable[[], GramEvidence]:  # fmt: skip
    """Evidence of blocks of columns, to be called when `whole` is no longer held; size : squared,
    of every column before anything was taken."""
    scale = whole.power / max(freedom, 1)
    # Absorbed columns are rounding errors: they must not enter the simulation.
    sound = np.diag(whole.matrix) > 1e-9 * size
    kept = [at[sound[at]] for at in own]
    used = np.unique(np.concatenate(kept))
    matrix = whole.matrix[np.ix_(used, used)]
    matrix /= scale
    return partial(
        block_evidence,
        gram=matrix,
        along=whole.along[used] / scale,
        power=whole.power / scale,
        freedom=freedom,
        whole=np.array([size[at].sum() / scale for at in own]),
        blocks=[np.searchsorted(used, at) for at in kept],
        tau=TAU,
        rng=rng,
        draws=draws,
    )


def _score(
    entry: Entry, evidence: float | None, left: float, strength: float, share: float, null: Array
) -> Score:
    bare = Candidate(entry.name, entry.kind, np.zeros((0, len(entry.part))), entry.driver)
    if evidence is None:
        return Score(
            candidate=bare, evidence=0.0, p=1.0, draws=len(null), left=0.0, strength=strength,
            share=0.0,
        )  # fmt: skip
    p = float((1 + (null >= evidence).sum()) / (len(null) + 1))
    return Score(
        candidate=bare,
        evidence=float(evidence),
        p=p,
        draws=len(null),
        left=left,
        strength=strength,
        share=float(share),
    )


def _noise_score(test: NoiseTest, null: Array) -> Score:
    bare = Candidate(test.name, "noise", np.zeros((0, 1)), test.driver)
    p = float((1 + (null >= test.evidence).sum()) / (len(null) + 1))
    return Score(
        candidate=bare,
        evidence=test.evidence,
        p=p,
        draws=len(null),
        left=1.0,
        strength=test.strength,
        share=0.0,
    )


def discounted(score: Score, factor: float, null: Array) -> Score:
    """A score as if there were `factor` times fewer samples: noise that neighbours share."""
    value = score.evidence / factor
    p = float((1 + (null >= value).sum()) / (len(null) + 1))
    return replace(score, evidence=value, p=p)


def absorbed(searches: tuple[Search, ...]) -> dict[str, float]:
    """What no motion shows, and by how much its typical size moves the positions."""
    found: dict[str, float] = {}
    for one in searches:
        for score in one.scores:
            if score.candidate.kind == "effect" and score.absorbed and "@" not in score.name:
                found[score.name] = one.impact[score.name]
    return found
