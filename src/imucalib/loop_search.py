"""One search of the closed loop: what is scored, what is chosen, what stays unexplained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from imucalib.candidates import correlated_noise, effect_candidates, family_candidates, probes
from imucalib.effect import Effect, Family
from imucalib.effects import known
from imucalib.evidence import Score, score
from imucalib.fit import Fit
from imucalib.loop import LoopSettings, Unexplained


def search(
    current: Fit,
    effects: Mapping[str, Effect],
    rng: np.random.Generator,
    rules: LoopSettings,
    rejected: Mapping[str, str],
    families: tuple[Family, ...] = (),
) -> tuple[tuple[Score, ...], dict[str, str]]:
    """Score everything that could be missing, and say what could not be tested.

    Of a scan only the best value is kept; all its values take part in the family-wise p.
    """
    current = thinned(current, rules.most_scored)
    usable = [e for e in effects.values() if e.name not in rejected]
    catalogue, missing = effect_candidates(current, usable)
    for family in families:
        if family.name not in rejected:
            values = family.values(current.observations.context)
            catalogue += family_candidates(current, family, values)
    everything = catalogue + probes(current) + correlated_noise(current)
    scores = score(current, everything, rng, draws=rules.draws, alpha=rules.alpha)
    seen: set[str] = set()
    best = []
    for found in scores:
        family_name = found.candidate.family
        if not family_name or family_name not in seen:
            best.append(found)
            seen.add(family_name)
    return tuple(best), missing


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
    """The best value near the one that a scan found; the p of the scan stands."""
    for family in families:
        if family.name == chosen.candidate.family:
            current = thinned(current, rules.most_scored)
            context = current.observations.context
            near = family.nearby(context, chosen.name.partition("@")[2])
            if near:
                found = score(current, family_candidates(current, family, near), rng, draws=1)[0]
                return replace(chosen, candidate=found.candidate, evidence=found.evidence)
    return chosen


def effect_named(effects: Mapping[str, Effect], name: str) -> Effect:
    found = effects.get(name) or known(name)
    assert found is not None, name
    return found


def choose(scores: tuple[Score, ...], rules: LoopSettings) -> Score | None:
    """The best catalogue effect, unless a probe or noise beats it by the margin."""
    passing = [s for s in scores if s.p <= rules.alpha]
    physical = [s for s in passing if s.candidate.kind == "effect"]
    if not physical or physical[0].evidence < passing[0].evidence - rules.margin:
        return None
    return physical[0]


def unexplained(scores: tuple[Score, ...], rules: LoopSettings) -> tuple[Unexplained, ...]:
    left = [s for s in scores if s.p <= rules.alpha and s.candidate.kind != "effect"]
    return tuple(
        Unexplained(s.name, s.candidate.driver, s.candidate.kind, s.p, s.evidence, s.share)
        for s in left[:3]
    )
