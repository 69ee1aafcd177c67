"""One search of the closed loop: what is scored, what is chosen, what speaks against it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.core.effect import Effect, Family
from imucalib.core.fit import Fit
from imucalib.effects import known
from imucalib.errors import NotConverged
from imucalib.loop.candidates import correlated_noise, effect_candidates, family_candidates, probes
from imucalib.loop.evidence import Score, score
from imucalib.loop.found import LoopSettings
from imucalib.loop.held_out import (
    fitted,
    left_out_sizes,
    log_predictive,
    settings_left_out,
)
from imucalib.loop.records import held_out_rms
from imucalib.loop.rivals.courses import course_of, courses_without_a_cause
from imucalib.loop.subject import Searched
from imucalib.loop.thresholds import (
    CERTAIN,
    HELD_OUT_NATS,
    HELD_OUT_RMS,
    MARGIN,
    NUMBERS,
    STRONG,
    WORSE,
)


def search(
    current: Fit,
    effects: Mapping[str, Effect],
    rng: np.random.Generator,
    rules: LoopSettings,
    rejected: Collection[str],
    families: tuple[Family, ...] = (),
) -> Searched:
    """Score everything that could be missing, and say what could not be tested.

    Of a scan only the best value is kept, at the evidence of the whole scan; all its values take
    part in the family-wise p.
    """
    current = thinned(current, rules.most_scored)
    usable = [e for e in effects.values() if e.name not in rejected]
    catalogue, missing = effect_candidates(current, usable)
    for family in families:
        if family.name not in rejected:
            values = family.values(current.observations.context)
            catalogue += family_candidates(current, family, values)
    everything = catalogue + probes(current)
    if current.observations.walk is None:
        everything += correlated_noise(current)
    draws = rules.draws if rules.bar is None else 0
    scores = score(current, everything, rng, draws=draws, alpha=rules.alpha)
    return Searched(_one_a_scan(scores), missing)


def _one_a_scan(scores: tuple[Score, ...]) -> tuple[Score, ...]:
    """Of each scan its best value, with the evidence of the whole scan: the mean over its values,
    which pays for having looked at many."""
    of: dict[str, list[Score]] = {}
    for found in scores:
        of.setdefault(found.candidate.family, []).append(found)
    best = of.pop("", [])
    for members in of.values():
        best.append(replace(members[0], evidence=max(scan_evidence(members), 0.0)))
    return tuple(sorted(best, key=lambda s: -s.evidence))


def scan_evidence(members: Sequence[Score]) -> float:
    """Nats of a whole scan: the log of the mean likelihood over its values."""
    nats = np.array([m.evidence for m in members])
    return float(nats.max() + np.log(np.mean(np.exp(nats - nats.max()))))


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


def refined(
    current: Fit,
    chosen: Score,
    families: tuple[Family, ...],
    rng: np.random.Generator,
    rules: LoopSettings,
) -> Score:
    """The best value near the one that a scan found; the p and the evidence of the scan stand."""
    for family in families:
        if family.name == chosen.candidate.family:
            current = thinned(current, rules.most_scored)
            context = current.observations.context
            near = family.nearby(context, chosen.name.partition("@")[2])
            if near:
                found = score(current, family_candidates(current, family, near), rng, draws=1)[0]
                return replace(chosen, candidate=found.candidate)
    return chosen


def effect_named(effects: Mapping[str, Effect], name: str) -> Effect:
    found = effects.get(name) or known(name)
    assert found is not None, name
    return found


def choose(
    scores: tuple[Score, ...], rules: LoopSettings, names: Collection[str] = ()
) -> Score | None:
    """The best catalogue effect. Neither noise nor a curve speaks against it here.

    names : of the model's effects. Beside a form or a curve the null of the search does not hold
        for what follows the same: of structure whose cause nobody knows something is left.
    """
    courses = courses_without_a_cause(names)

    def asked(found: Score) -> LoopSettings:
        effect = known(found.name) if courses else None
        return _stricter(rules) if effect and course_of(effect.needs) in courses else rules

    physical = (s for s in scores if s.candidate.kind == "effect" and _stands_out(s, asked(s)))
    return next(physical, None)


def _stricter(rules: LoopSettings) -> LoopSettings:
    """At the p of what is certain. Of the best evidence by chance, p falls as exp(-nats)."""
    if rules.bar is None:
        return replace(rules, alpha=min(rules.alpha, CERTAIN))
    return replace(rules, bar=rules.bar + max(0.0, float(np.log(rules.alpha / CERTAIN))))


def _stands_out(found: Score, rules: LoopSettings) -> bool:
    return (clear if found.candidate.unfounded else passes)(found, rules)


def passes(found: Score, rules: LoopSettings) -> bool:
    """By the family-wise p, or by the bar of an earlier search of the whole data."""
    if rules.bar is not None:
        return found.evidence >= rules.bar
    return found.p <= rules.alpha


def clear(found: Score, rules: LoopSettings) -> bool:
    """Whether structure without a name stands out far enough to be corrected: a name has physics to
    speak for it, a curve has only these data."""
    bar = found.bar if rules.bar is None else rules.bar
    return passes(found, rules) and found.evidence >= bar + MARGIN


@dataclass(frozen=True)
class Objection:
    """Why an effect must not be taken in; by_data : whether what it was not fitted to says so."""

    reason: str
    by_data: bool = False


def objection(
    before: Fit, after: Fit, least_nats: float = HELD_OUT_NATS, most_rms: float = HELD_OUT_RMS
) -> Objection | None:
    """Why an effect must not be taken in; None when the refit realises the gain and what it
    predicts for data that it was not fitted to is better.

    least_nats : that it must gain there; most_rms : share of the error before that may be left
    """
    if not after.converged:
        return Objection("its refit did not converge")
    if len(after.null_directions) > len(before.null_directions):
        return Objection(f"the data cannot determine it: {after.null_directions[-1]}")
    implausible = [
        f"{p.name} = {v:.3g} {p.unit}"
        for p, v in zip(after.parameters, after.theta, strict=True)
        if abs(v) > p.plausible
    ]
    if implausible:
        return Objection(f"implausible size ({', '.join(implausible)})")
    if len(after.theta) * NUMBERS > after.at.residual.size:
        return Objection("too few numbers for its parameters")
    words = _refuted(before, after, least_nats, most_rms)
    return Objection(f"it does not hold out: {words}", by_data=True) if words else None


def _refuted(before: Fit, after: Fit, least_nats: float, most_rms: float) -> str:
    """What data that it was not fitted to say against an effect."""
    gain = log_predictive(after) - log_predictive(before)
    if gain < least_nats:
        gain = max(gain, settings_left_out(before, after))
    ratio = held_out_rms(after) / max(held_out_rms(before), 1e-300)
    grown = ratio >= most_rms and not (
        gain >= STRONG and ratio < WORSE and _by_settings(before, after)
    )
    if gain < least_nats or grown:
        words = f"{gain:+.1f} nats" if gain < least_nats else f"{ratio:.3g} times the error"
        return f"{words} on data that it was not fitted to"
    # The correction itself, as a user will apply it, and not only the model run forwards.
    try:
        times = fitted(after).rms() / fitted(before).rms()
    except NotConverged:
        return "it has no inverse at the readings"
    return f"corrected readings are {times:.2g} times as far off" if times > WORSE else ""


def _by_settings(before: Fit, after: Fit) -> bool:
    """Whether errors that grow do so by how the settings happened to err: of rows that share them
    the sizes hold a few draws each, which an effect of the sensor meets by chance."""
    if not before.at.free:
        return False
    grown = left_out_sizes(after) ** 2 - left_out_sizes(before) ** 2
    index = before.observations.reference.directions(before.eta).index
    total, spread = float(grown.sum()), 0.0
    for setting in index.T[: before.at.free]:
        each = np.bincount(np.unique(setting, return_inverse=True)[1], weights=grown)
        spread = max(spread, float(np.sum((each - each.mean()) ** 2)) ** 0.5)
    return total < 2.0 * spread
