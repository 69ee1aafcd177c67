"""The search over a motion: fit a set, make its products, search from it, until it stays the same.

The products are those of what is fitted, of all that may be missing, and of the readings,

    A = Zᵀ V⁻¹ Z,  Z = [positions and what the rests did not determine | components | y]

with the nine unknowns of every sample taken out. All is in absolute numbers: y is what the readings
would be off with everything at its prior's mean, so that products at two linearisations speak of
the same thing. Noise that neighbours share and tails lessen the weights before. Effects whose
columns are the same to the first order, delays and low-passes, are told apart by refits. A part of
a motion starts from the search of the whole: its own products say which of the sets that were
likely there is the likeliest.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.motion.ages import add_estimated_clock, add_phases
from imucalib.calibrators.array.motion.laws import (
    CURVE,
    array_catalogue,
    candidates_of,
    find_effect,
    find_skipped,
    twins_of,
)
from imucalib.calibrators.array.motion.setup import select_searched
from imucalib.calibrators.array.motion.state import (
    ArrayState,
    PositionBase,
    fit_jointly,
    measure_dispersion,
    size_in_words,
)
from imucalib.calibrators.array.motion.terms import (
    OPEN,
    Term,
    determine,
    typical_columns,
    typical_of,
)
from imucalib.calibrators.request import Request
from imucalib.core.effect import Effect, Response
from imucalib.errors import Undetermined
from imucalib.estimators.array.noise import MotionNoise, log_density
from imucalib.estimators.array.samples import inverse_root, marginalize, reweigh
from imucalib.posterior.closed_loop.found import CheckedError, Score, Step, Unexplained
from imucalib.posterior.closed_loop.words import SelectedModel, of_each, scores_of, select_model
from imucalib.posterior.odds import ABSORBED, CERTAIN, FINE_SIZES, SEARCHES
from imucalib.posterior.search.catalogue import Member, log_odds
from imucalib.posterior.search.driver import search_until_settled
from imucalib.posterior.search.gram import Grams, Multiplied
from imucalib.posterior.search.problem import Choice, Contest
from imucalib.posterior.search.space import Hypothesis, Pick, Posterior, blocks_of, hill_climb

#: Times that twins are told apart, where some have gone to another name.
_PASSES = 3
#: Nats by which a settled fit may be beside what its products foretold of it.
_SETTLED = 1.0
#: Probability below which no part of a motion asks for a component again.
_UNLIKELY = 0.01
DIVERGED = "its refit did not converge"
#: What gyros share, scale apart, against the accelerometers.
GYRO_FRAME = "gyro_frame"
#: Name in a model -> (twin, share) of what may be in its place, itself first.
Shares = dict[str, tuple[tuple[str, float], ...]]
#: Log prior odds of the components that are tried, by name.
Odds = Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class MotionProblem(Contest):
    """What a motion may lack; what is fitted has left its products.

    missing : why effects could not be tried
    prior : (C,) log prior odds of each component, be the others tried or not
    seen : (q,) squares of the columns without the motion, and what free positions leave of them
    moves : (d, q) m by which each column moves free positions at typical size
    """

    missing: dict[str, str]
    prior: Array
    seen: tuple[Array, Array]
    moves: Array

    @cached_property
    def odds(self) -> Array:
        """(C,) of `prior`."""
        return self.prior

    @property
    def sizes(self) -> Array:
        """Those of a component: a motion has thousands of readings, so that small ones count; the
        evidence is flat over a factor of four."""
        return FINE_SIZES[::2]

    def is_named(self, name: str) -> bool:
        """Whether a candidate of this name is a cause."""
        own = next(choice for choice in self.choices if choice.member.name == name)
        return self.components[own.component].named

    def measure(self, component: int) -> tuple[float, float, float]:
        """Of a component's first member at typical size: the share of its columns that free
        positions leave, their length in units of the noise, and the m rms by which it moves the
        positions."""
        at = next(c.at for c in self.choices if c.component == component)
        before, after = (float(one[at].sum()) for one in self.seen)
        moves = float(np.sqrt(np.sum(np.mean(self.moves[:, at] ** 2, axis=0))))
        return after / max(before, 1e-300), float(np.sqrt(max(after, 0.0))), moves

    def score(self, posterior: Posterior) -> tuple[Score, ...]:
        """Of every component; what no motion shows, nothing is left of."""
        shown = (self.measure(c) for c in range(len(self.components)))
        left = [(share if length > OPEN else 0.0, length, 0.0) for share, length, _ in shown]
        return scores_of(self, posterior, left)

    @property
    def absorbed(self) -> dict[str, float]:
        """What no motion shows, and by how many m rms its typical size moves the positions."""
        found = {}
        for c, component in enumerate(self.components):
            share, strength, moves = self.measure(c)
            if component.named and (strength <= OPEN or share < ABSORBED):
                found[component.name] = moves
        return found

    def of_set(self, hypothesis: Hypothesis) -> tuple[Member, ...]:
        """What a set adds to the model."""
        return tuple(self.choices[p.choice].member for p in hypothesis.picks)

    def picks(self, state: ArrayState) -> tuple[Pick, ...]:
        """The effects of a state as a set, at their sizes."""
        at = {choice.member.name: k for k, choice in enumerate(self.choices)}
        return tuple(Pick(at[t.name], float(t.sd[0])) for t in state.found if t.name in at)

    def find_shift(self, posterior: Posterior, hypothesis: Hypothesis, component: int) -> Array:
        """(d,) m by which a component of a set moves the positions."""
        columns, value, _ = self._linear(posterior, hypothesis)
        own = next(
            self.choices[p.choice].at
            for p in hypothesis.picks
            if self.choices[p.choice].component == component
        )
        mine = np.isin(columns, own)
        return np.asarray(self.moves[:, columns[mine]] @ value[mine])

    def shortfall(self, posterior: Posterior, hypothesis: Hypothesis, state: ArrayState) -> float:
        """Nats by which a settled fit of a set is beside what the products foretold of it."""
        columns, value, rows = self._linear(posterior, hypothesis)
        off = _collect_values(state, self.choices, int(columns.max(initial=0)) + 1)[columns] - value
        return float(0.5 * off @ rows[:, columns] @ off)

    def _linear(self, posterior: Posterior, hypothesis: Hypothesis) -> tuple[Array, Array, Array]:
        """Columns (m,) of a set, what the products say of each, and their rows."""
        blocks = blocks_of(self.choices, hypothesis.picks)
        columns = np.concatenate([at for at, _ in blocks])
        sizes = np.concatenate([np.full(at.size, size) for at, size in blocks])
        rows = posterior.grams.rows(columns)[0]
        value = np.linalg.solve(rows[:, columns] + np.diag(sizes**-2.0), rows[:, -1])
        return columns, value, rows


def products(
    state: ArrayState,
    skipped: frozenset[str],
    declared: Sequence[str],
    among: Odds | None = None,
) -> tuple[MotionProblem, Grams]:
    """At a fitted state. skipped : names that are not tried; declared : terms that are no question
    of the search; among : components that are tried, where these are not all"""
    motion, setup = state.motion, state.setup
    rows = setup.inner[select_searched(setup)]
    clock = any(t.aged for t in state.found if t.name in declared)
    own = tuple(
        t for t in state.terms if t.name in declared or not (t.found or (t.aged and not clock))
    )
    every = candidates_of(motion.take(rows), state.terms, skipped.union(declared), among)
    odds = log_odds(tuple(every.components))
    if among is not None:
        odds = np.array([among[one.name] for one in every.components])
    kappa = [measure_dispersion(state, gyro=gyro) for gyro in (False, True)]
    a, g = (n.information / k for n, k in zip(state.noise, kappa, strict=True))
    sampled = reweigh(state.sampled.take(rows), a, g)
    base = PositionBase(replace(state, sampled=sampled, motion=motion.take(rows)), own)
    found = base.multiply(sampled, np.arange(len(rows)), every.blocks)
    b = len(base.prior)
    theta = np.concatenate(
        [base.pull / base.prior, _collect_values(state, every.choices, every.width)]
    )
    toward = found.matrix @ theta
    along = (found.along + toward)[:, None]
    power = found.power + 2.0 * float(theta @ found.along) + float(theta @ toward)
    whole = np.block([[found.matrix, along], [along.T, np.array([[power]])]])
    matrix = marginalize(whole, base.prior)
    loose = inverse_root(found.matrix[:b, :b] + np.diag(base.rests))
    carried, square = loose.T @ found.matrix[:b, b:], np.diag(found.matrix)[b:]
    problem = MotionProblem(
        components=tuple(every.components),
        base=0,
        choices=tuple(every.choices),
        missing=every.missing,
        prior=odds,
        seen=(square, square - np.sum(carried**2, axis=0)),
        moves=loose[: state.positions] @ carried,
    )
    grams = Grams(
        products=Multiplied(matrix[None]),
        removed=np.zeros((1, 0, len(matrix))),
        log_weight=np.zeros(1),
        numbers=found.power,  # as many as their weights say
        points=(),
        spread=np.inf,
    )
    return problem, grams


def _collect_values(state: ArrayState, choices: Sequence[Choice], width: int) -> Array:
    """(width,) what the state has of the candidates' columns, in typical sizes."""
    theta = np.zeros(width)
    at = {choice.member.name: choice.at for choice in choices}
    phases = [t.value for t in state.terms if t.aged and not t.found]
    for term in state.found:
        if term.name in at:
            value = term.theta / typical_of(term.effect, len(term.theta))
            theta[at[term.name]] = np.concatenate([value, *(phases if term.aged else ())])
    return theta


@dataclass(frozen=True)
class MotionSearch:
    """The end of a search.

    state : with what is told in the model, twins told apart
    shares : of what is in it
    said : of the last products
    scores : of every component beside the base model, and impact : m rms by which what no motion
        shows moves the positions at its typical size; both of the first products
    rejected : (name, reason) of what the model could not take in
    """

    state: ArrayState
    shares: Shares
    said: SelectedModel[MotionProblem]
    scores: tuple[Score, ...]
    impact: dict[str, float]
    rejected: tuple[tuple[str, str], ...] = ()

    @property
    def chosen(self) -> tuple[Member, ...]:
        """What is told."""
        return self.said.problem.of_set(self.said.hypothesis)

    def drop_laws(self, request: Request) -> ArrayState | None:
        """The fit without laws, which have no name, unless these are to be corrected; None where it
        runs away."""
        named = [m for m in self.chosen if request.curves or self.said.problem.is_named(m.name)]
        known = {term.name for term in self.state.found}
        if known == {one.name for one in named} | (known & set(request.declare)):
            return self.state
        return fit_with_members(self.state, named, request)

    def list_steps(self, final: ArrayState, checks: tuple[CheckedError, ...]) -> tuple[Step, ...]:
        """What is told and corrected, likeliest first; a place that twins share is theirs together.

        final : the fit with what is corrected; checks : errors before and after
        """
        steps = []
        for place in self.said.places:
            name = self.said.name(place.component)
            twins = next((s for s in self.shares.values() if name in dict(s)), ((name, 1.0),))
            term = next((t for t in final.found if t.name == twins[0][0]), None)
            if term is None:
                continue
            rivals = [
                (own, share * part)
                for c, share in place.rivals
                for own, part in (twins if c == place.component else ((self.said.name(c), 1.0),))
            ]
            likely = [r for r in rivals if r[1] > 1.0 - CERTAIN or r[0] == term.name]
            ranked = sorted(likely, key=lambda r: -r[1])
            size = size_in_words(final, term)
            step = replace(
                self.said.step(place, checks, ranked, size),
                effect=term.name,
                aliases=tuple(n for n, _ in likely if n != term.name),
                certain=place.certain and twins[0][1] > CERTAIN,
                curve="" if self.said.problem.is_named(name) else term.name.removeprefix(CURVE),
                formula="",
            )
            steps.append(step)
        return tuple(steps)

    def find_unnamed(self, final: ArrayState) -> dict[Unexplained, Array]:
        """What is told and has no name, be it corrected or not: laws, and effects of which the data
        determine no size; with the (d,) m by which each moves the positions, where it is not
        corrected.

        final : the fit with what is corrected
        """
        shifts, own = {}, {term.name for term in final.found}
        for place in self.said.places:
            name = self.said.name(place.component)
            if self.said.problem.is_named(name) and name in own:
                continue
            moved = self.said.problem.find_shift(
                self.said.posterior, self.said.hypothesis, place.component
            )
            one = self.said.leave_unexplained(place)
            shifts[one] = 0.0 * moved if name in own else moved
        return shifts

    @property
    def likely(self) -> Odds:
        """Components that are in any set near the likeliest, or in what is told."""
        inside = of_each(self.said.posterior, len(self.said.problem.components))[1]
        inside[list(self.said.hypothesis.components)] = 1.0
        own = zip(self.said.problem.components, self.said.problem.odds, inside, strict=True)
        return {one.name: float(odds) for one, odds, share in own if share > _UNLIKELY}


def search_posterior(
    base: ArrayState, request: Request, whole: MotionSearch | None = None
) -> MotionSearch:
    """The posterior over what a fitted state lacks, at the set that it tells.

    request : declared effects stay in the model; whole : the search of a motion of which this is a
    part, which starts from what is told there
    """
    skipped, declared = find_skipped(request, base.setup.board.imus), request.declare
    among = None if whole is None else whole.likely
    start = _Held(base, Shares())
    if whole is not None:
        start = _take_in(start, whole.chosen, request, None) or start

    scores, impact = list[tuple[Score, ...]](), dict[str, float]()

    def search(held: _Held) -> SelectedModel[MotionProblem]:
        problem, grams = products(held.state, skipped, declared, among)
        found = select_model(problem, hill_climb(problem, grams, problem.picks(held.state)))
        if not scores:
            scores.append(problem.score(found.posterior))
            impact.update(problem.absorbed)
        return found

    def take_in(held: _Held, said: SelectedModel[MotionProblem]) -> tuple[_Held, bool] | None:
        chosen = said.problem.of_set(said.hypothesis)
        grown = _take_in(held, chosen, request, skipped if whole is None else None)
        if grown is None:
            return None
        # Where the fit is what its products foretold, at the noise that they had, others would say
        # the same.
        away = said.problem.shortfall(said.posterior, said.hypothesis, grown.state)
        away += _noise_gain(held.state.noise, grown.state)
        same = _list_names(said) == grown.names.difference(declared)
        return grown, same and away < _SETTLED

    settled = search_until_settled(
        start,
        search,
        take_in,
        told=_list_names,
        held=lambda held: held.names.difference(declared),
        rounds=SEARCHES,
    )
    held, said = settled.state, settled.found
    lost = _list_names(said).difference(held.names) if settled.refused else ()
    return MotionSearch(
        state=held.state,
        shares=held.shares,
        said=said,
        scores=scores[0],
        impact=impact,
        rejected=tuple((name, DIVERGED) for name in sorted(lost)),
    )


@dataclass(frozen=True)
class _Held:
    """A fitted state, and the shares of twins in it."""

    state: ArrayState
    shares: Shares

    @property
    def names(self) -> frozenset[str]:
        """Of the effects that it holds."""
        return frozenset(term.name for term in self.state.found)


def _list_names(said: SelectedModel[MotionProblem]) -> frozenset[str]:
    return frozenset(one.name for one in said.problem.of_set(said.hypothesis))


def _take_in(
    held: _Held, chosen: Sequence[Member], request: Request, skipped: Collection[str] | None
) -> _Held | None:
    """The fit with a set, its clocks and its twins told apart; None where it runs away.

    skipped : names that are not tried; None where twins stay as the whole motion has told them
    """
    grown = fit_with_members(held.state, chosen, request)
    if grown is None:
        return None
    if any(term.aged for term in grown.terms):
        grown = refit(add_estimated_clock(grown)) or grown
    return _Held(*((grown, Shares()) if skipped is None else resolve_aliases(grown, skipped)))


def _noise_gain(before: tuple[MotionNoise, MotionNoise], state: ArrayState) -> float:
    """Nats that the noise of a state gains over one before it, for the residuals of the state."""
    accelerometers, gyros, speed = state.squares()
    return sum(
        float(np.sum(log_density(now, square, speed) - log_density(then, square, speed)))
        for now, then, square in zip(state.noise, before, (accelerometers, gyros), strict=True)
    )


def fit_with_members(
    state: ArrayState, chosen: Sequence[Member], request: Request
) -> ArrayState | None:
    """The joint fit with these and what is declared, and no others; None where it runs away."""
    names = {*request.declare, *(one.name for one in chosen)}
    grown = replace(state, terms=tuple(t for t in state.terms if not t.found or t.name in names))
    for one in chosen:
        if one.name not in {t.name for t in grown.terms}:
            term = new_term(grown, one.name, one.effects[0][0])
            if term.value.size:
                grown = replace(grown, terms=(*grown.terms, term))
    return refit(add_phases(grown), shaped=True)


def add_declared(state: ArrayState, names: Sequence[str]) -> ArrayState:
    """The joint fit with the named effects in the model.

    Raises UsageError for unknown names, Undetermined where the motion cannot carry one.
    """
    for name in names:
        effect = find_effect(name, state.setup.board.imus)
        if "sample_age" in effect.needs and state.motion.age is None:
            state = add_estimated_clock(state)
        reason = effect.missing(state.motion.context)
        term = None if reason else new_term(state, name, effect)
        if term is None or term.value.size == 0:
            raise Undetermined(
                f"{name} was declared, and this motion does not show it"
                + (f": {reason}" if reason else ""),
                remedy=effect.identify,
            )
        state = replace(state, terms=(*state.terms, term))
    return fit_jointly(add_phases(state)) if names else state


def new_term(state: ArrayState, name: str, effect: Effect) -> Term:
    """An effect as a new term of a fitted state: what these data can determine of it, at zero.

    name : with "@imu3" where it is of one IMU alone
    """
    family, _, imu = name.partition("@")
    assert isinstance(effect, Response)
    own, only = replace(effect, name=family), state.setup.board.imus.index(imu) if imu else None
    return determine(name, own, only, own_gram(state, own, only), state.found)


def own_gram(state: ArrayState, effect: Response, only: int | None = None) -> Array:
    """(p, p) Gram matrix, in units of the noise, of an effect's columns in typical sizes, with
    motion, positions and terms taken out."""
    columns, base = typical_columns(effect, state.motion, only), state.base
    found = base.multiply(state.sampled, state.setup.inner, [columns])
    return marginalize(found.matrix, base.rests)


def frame_term() -> Term:
    """What gyros share against the accelerometers: no comparison of gyros shows it, every board has
    it, and positions hold it where a model does not."""
    effect = array_catalogue()[GYRO_FRAME]
    size = typical_of(effect, len(effect.each))
    return Term(GYRO_FRAME, effect, None, np.diag(size), 0.0 * size, np.ones(len(size)))


def refit(state: ArrayState, *, shaped: bool = False) -> ArrayState | None:
    """The joint fit, by default with the noise in the shape that it has; None where it runs
    away."""
    try:
        found = fit_jointly(state, shaped=shaped)
    except np.linalg.LinAlgError:
        return None
    return found if found.converged else None


def resolve_aliases(state: ArrayState, skipped: Collection[str]) -> tuple[ArrayState, Shares]:
    """Of a settled fit, every found effect that has twins against these, each fitted anew in its
    place; again where one has gone to a twin, for with a wrong one another seems right.

    skipped : names that are not tried. A twin whose fit is lost keeps the share it had before:
    nothing is known against it.
    """
    for _ in range(_PASSES):
        shares = Shares()
        names = [t.name for t in state.found]
        for name in names:
            twins = [twin for twin in twins_of(name) if twin not in skipped]
            if twins:
                state, known = _against(state, name, twins)
                shares[known[0][0]] = known
        if names == [t.name for t in state.found]:
            break
    return state, shares


def _against(
    state: ArrayState, name: str, twins: list[str]
) -> tuple[ArrayState, tuple[tuple[str, float], ...]]:
    """The fit with the likeliest of an effect and its twins, and the share of each."""
    fits: dict[str, ArrayState | None] = {name: state}
    term = next(t for t in state.terms if t.name == name)
    for twin in twins:
        other = _as_twin(term, twin)
        least = np.resize([p.least for p in other.effect.each], len(other.theta))
        # No filter has a negative time; those of all are against each other, so one of them has
        # none.
        alone = other.only is not None or other.effect.shared
        theta = other.theta - (0.0 if alone else other.theta.min())
        if np.all(theta + 3.0 * state.sd_of(term) >= least):
            terms = (other if t is term else t for t in state.terms)
            fits[twin] = refit(replace(state, terms=tuple(terms)))
    level = _nats(state, name)
    nats = np.array([_nats(s, n) - level if s else 0.0 for n, s in fits.items()])
    share = np.exp(nats - nats.max())
    order = np.argsort(-share, kind="stable")
    names = [list(fits)[k] for k in order]
    known = zip(names, share[order] / share.sum(), strict=True)
    return fits[names[0]] or state, tuple((n, float(s)) for n, s in known)


def _effect(name: str) -> Response:
    return array_catalogue()[name.partition("@")[0]]


def _as_twin(term: Term, twin: str) -> Term:
    """With the effect of a twin: where one kind of sensor lags, the other leads."""
    effect = _effect(twin)
    sign = 1.0 if effect.channel == term.effect.channel else -1.0
    return replace(term, name=twin, effect=effect, value=sign * term.value)


def _nats(state: ArrayState, name: str) -> float:
    """Log density of the residuals, neighbours counted for what they are worth. A lag of single
    sensors shows against others of their kind: what neighbours' noise brings into dω/dt, other for
    each twin, is in the other kind's residuals, and was worth 36 nats for the wrong one."""
    effect = _effect(name)
    *squares, speed = state.squares()
    return sum(
        float(log_density(noise, square, speed).sum()) / measure_dispersion(state, gyro=gyro)
        for noise, square, gyro in zip(state.noise, squares, (False, True), strict=True)
        if effect.shared or gyro == (effect.channel == "angular_rate")
    )
