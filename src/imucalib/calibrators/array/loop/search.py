"""One search of the array's loop: everything that could be missing, scored in one contest.

The engine is the shared one (`evidence_gram`), fed with Gram matrices from which the motion of
every sample, the positions and the terms are taken out. Noise of another kind stands in the same
contest: its likelihood ratio against white noise of one size, under which its root is half a
standard normal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.loop.candidates import Entry, candidates, typical_columns
from imucalib.calibrators.array.loop.noise_tests import NoiseTest, noise_tests
from imucalib.calibrators.array.loop.setup import looked_at
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.terms import OPEN, Term, determined, typical_of
from imucalib.core.eigen import eigen
from imucalib.estimators.array.gram import gram, starts_of
from imucalib.estimators.array.reduced import Alone, Reduced, alone, reduced
from imucalib.loop.evidence import Candidate, Score
from imucalib.loop.evidence_gram import GramEvidence, block_evidence
from imucalib.loop.subject import Searched

TAU = 10.0 ** np.arange(-3.0, 1.1, 0.5)
ABSORBED = 1e-5  # share of a block, beyond what the motion takes, that the rest must leave
_APART = 0.2  # share of a curve's direction that the base must leave


@dataclass(frozen=True)
class Search(Searched):
    """state : where it was; entries by name; index : where a candidate's columns are
    whole : of each candidate by itself, with the base taken out, total : before that
    carry : (b, M) base per unit of each column; null : the best evidences of simulated data
    impact : m rms that a candidate's typical size moves the positions"""

    state: ArrayState
    entries: dict[str, Entry]
    index: dict[str, Index]
    whole: dict[str, Alone]
    total: dict[str, Array]
    carry: Array
    null: Array
    impact: dict[str, float]

    def held_out(self, name: str) -> tuple[float, float]:
        """Nats that each half gains when the other has estimated the candidate and its size."""
        state, entry = self.state, self.entries[name]
        assert entry.effect is not None
        columns = typical_columns(entry.effect, state.motion, entry.only)
        blocks, some = [*state.base.blocks, columns], looked_at(state.setup)
        first, gains = state.setup.first[some], []
        halves = [
            alone(state.base.free(gram(state.sampled, blocks, state.setup.inner[some[rows]])),
                  state.base.rests)
            for rows in (first, ~first)
        ]  # fmt: skip
        for one, two in (halves, halves[::-1]):
            value = _most_likely(one.matrix, one.along)
            gains.append(float(two.along @ value - 0.5 * value @ two.matrix @ value))
        return gains[0], gains[1]

    def moves(self, name: str, coordinates: int) -> float:
        """m rms over the positions' coordinates: what taking a candidate in would move them by;
        zero for noise, which has no columns."""
        if name not in self.index:
            return 0.0
        value = _most_likely(self.whole[name].matrix, self.whole[name].along)
        return float(np.sqrt(np.mean((self.carry[:coordinates, self.index[name]] @ value) ** 2)))

    def correctable(self, name: str) -> bool:
        """Whether it is a curve that may be corrected. What all accelerometers share as a function
        of the force bends the array's shape: there a curve is no better than the error."""
        entry = self.entries.get(name)
        if entry is None or entry.effect is None or entry.kind != "probe":
            return False
        return not (entry.effect.shared and entry.effect.channel == "acceleration")

    def term(self, name: str) -> Term:
        """A candidate as a new term: the directions that the data can determine, at zero."""
        entry, at = self.entries[name], self.index[name]
        assert entry.effect is not None
        matrix = self.whole[name].matrix
        if entry.kind == "effect":
            return determined(name, entry.effect, entry.only, matrix)
        kept = _apart(matrix, self.total[name])
        live = typical_of(entry.effect, len(at))[:, None] * kept
        n = kept.shape[1]
        return Term(name, entry.effect, entry.only, live, np.zeros(n), np.ones(n))


def _apart(matrix: Array, total: Array) -> Array:
    """(p, q) orthonormal directions of a curve of which the positions and terms take little: in the
    others it would trade off against the answer, whatever its cause.

    matrix, total : (p, p) Gram matrices with these taken out, and before
    """
    values, vectors = eigen(total)
    seen = values > 1e-9 * float(values[-1])
    white = vectors[:, seen] / np.sqrt(values[seen])
    share, turn = eigen(white.T @ matrix @ white)
    kept = white @ turn[:, share >= _APART]
    return np.asarray(np.linalg.qr(kept)[0])


def _most_likely(matrix: Array, along: Array) -> Array:
    """Estimate of a block of columns under the size that its own evidence prefers."""
    values, vectors = eigen(matrix)
    values, seen = np.maximum(values, 0.0), vectors.T @ along
    shrunk = TAU[:, None] ** 2 / (1.0 + TAU[:, None] ** 2 * values)
    evidence = np.sum(shrunk * seen**2 - np.log1p(TAU[:, None] ** 2 * values), axis=1)
    return np.asarray(vectors @ (shrunk[np.argmax(evidence)] * seen))


def search(
    state: ArrayState, rejected: frozenset[str], rng: np.random.Generator, draws: int
) -> Search:
    """Score all candidates at a fitted state."""
    found = candidates(state, rejected)
    starts, b = starts_of(found.blocks), len(state.base.prior)
    index = {e.name: starts[e.block] + e.part for e in found.entries}
    rows = state.setup.inner[looked_at(state.setup)]
    total = state.base.free(gram(state.sampled, [*state.base.blocks, *found.blocks], rows))
    prior = state.base.rests
    whole = reduced(total, prior, state.base.pull * (prior > 0.0))
    before = {n: total.matrix[np.ix_(at + b, at + b)] for n, at in index.items()}
    diagonal = np.diag(total.matrix)[b:].copy(), np.diag(whole.matrix).copy()
    left = {n: float(diagonal[1][at].sum() / max(diagonal[0][at].sum(), 1e-300))
            for n, at in index.items()}  # fmt: skip
    size = {n: float(np.sqrt(max(diagonal[1][at].sum(), 0.0))) for n, at in index.items()}
    live = [e for e in found.entries if left[e.name] >= ABSORBED and size[e.name] >= OPEN]
    own = [index[e.name] for e in live]
    freedom = total.numbers - b
    each = {n: Alone(whole.matrix[np.ix_(at, at)], whole.along[at]) for n, at in index.items()}
    carry, contest = whole.carry, _contest(whole, diagonal[0], own, freedom, rng, draws)
    del total, whole  # of many IMUs they are large
    evidence = contest()
    noises = noise_tests(state, rng, draws)
    null = np.maximum(evidence.best, noises.null)
    value = dict(zip((e.name for e in live), evidence.evidence, strict=True))
    share = dict(zip((e.name for e in live), evidence.share, strict=True))
    scores = [
        _score(e, value.get(e.name), left[e.name], size[e.name], share.get(e.name, 0.0), null)
        for e in found.entries
    ]
    scores += [_noise_score(test, null) for test in noises.tests]
    moved = np.sqrt(np.sum(carry[: state.positions] ** 2, axis=0) / state.positions)
    impact = {e.name: float(np.linalg.norm(moved[index[e.name]])) for e in found.entries}
    return Search(
        scores=tuple(sorted(scores, key=lambda s: -s.evidence)),
        missing=found.missing,
        state=state,
        entries={e.name: e for e in found.entries},
        index=index,
        whole=each,
        total=before,
        carry=carry,
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
