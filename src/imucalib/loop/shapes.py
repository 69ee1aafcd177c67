"""Whether a curve without a name has a form with a formula.

Every form of `effects/shape` is scanned over its numbers against the driver of the curve. The
evidence of a form is the mean over what was tried, which pays for having looked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.effects import known
from imucalib.loop.candidates import effect_candidates, fitted_prediction
from imucalib.loop.evidence import Score, score
from imucalib.loop.search import scan_evidence
from imucalib.loop.thresholds import MARGIN
from imucalib.units import DEG, STANDARD_GRAVITY

_ANGLES = ("tool_face", "inclination")
_FINER, _HARMONICS = 9, 12
_PERIODIC = ("sine", "saw_tooth")
#: Sine of the angle between two ways to write one function, beside what is in the model: a kink at
#: a hundredth of a g is asymmetry.
_ITSELF = 0.1


@dataclass(frozen=True)
class Formed:
    """The best form of a driver, and others that do about as well."""

    score: Score
    effect: Effect
    rivals: tuple[str, ...]


def form_of(fit: Fit, curve: Score, rng: np.random.Generator) -> Formed | None:
    """The form beside a fit that a curve found there may have, or None where none can be tried.

    curve : the score of a probe, whose `curve` says what is bent and by which driver
    """
    what, against, *_ = curve.candidate.curve.split(":")
    scan = _scanned(fit, what, against, rng)
    return _best_of(fit, curve, scan, rng) if scan.found else None


@dataclass(frozen=True)
class _Scan:
    """Of each kind of form what was tried, and the scores."""

    what: str
    against: str
    tried: dict[str, list[tuple[float, ...]]]
    found: dict[str, list[Score]]


def _scanned(fit: Fit, what: str, against: str, rng: np.random.Generator) -> _Scan:
    driver = _driver(fit, what, against)
    tried = {kind: list(_numbers(kind, driver, what, against)) for kind in _GRIDS}
    return _Scan(what, against, tried, _scored(fit, what, against, tried, rng))


def _best_of(fit: Fit, curve: Score, scan: _Scan, rng: np.random.Generator) -> Formed:
    """The best of what was scanned, its numbers looked for once more around the best ones."""
    of_kind = {kind: scan_evidence(members) for kind, members in scan.found.items()}
    best = max(of_kind, key=lambda kind: of_kind[kind])
    top = max(scan.found[best], key=lambda s: s.evidence)
    # What goes with a tool-face comes back after a turn: between its harmonics there is nothing.
    turns = scan.against == "tool_face" and best in _PERIODIC
    near = [] if turns else _between(scan.tried[best], _numbers_of(top.name))
    finer = _scored(fit, scan.what, scan.against, {best: near}, rng).get(best, [])
    top = max([top, *finer], key=lambda s: s.evidence)
    effect = known(top.name)
    assert effect is not None, top.name
    rivals = tuple(
        max(scan.found[kind], key=lambda s: s.evidence).name
        for kind, nats in of_kind.items()
        if kind != best and nats > of_kind[best] - MARGIN
    )
    named = replace(curve.candidate, name=effect.name, kind="effect", curve="")
    return Formed(replace(curve, candidate=named, evidence=of_kind[best]), effect, rivals)


def forms_of(fit: Fit, kind: str, what: str, against: str) -> tuple[str, ...]:
    """Names of the forms of a kind that a scan beside a fit tries."""
    return tuple(
        _name(what, against, kind, numbers)
        for numbers in _numbers(kind, _driver(fit, what, against), what, against)
    )


def _name(what: str, against: str, kind: str, numbers: tuple[float, ...]) -> str:
    return f"shape@{what}:{against}:{kind}:" + ":".join(f"{v:.4g}" for v in numbers)


def better_form(fit: Fit, effect: Effect, named: Score, rng: np.random.Generator) -> Formed | None:
    """The form that explains about as much as a named effect of the sensor with the same driver, if
    one does: then the name is not certain. A form that is the effect itself is none."""
    context = fit.observations.context
    if effect.stage != "sensor" or len(effect.needs) > 1:
        return None
    if effect.needs and effect.needs[0] not in context.covariates:
        return None
    what, against = ("bias", effect.needs[0]) if effect.needs else ("response", "xyz")
    scan = _scanned(fit, what, against, rng)
    scan = replace(scan, found=_others(fit, effect, scan.found))
    if not scan.found:
        return None
    nats = [scan_evidence(members) for members in scan.found.values()]
    # A form of the same covariate has the same cause; one of the response has another, and nothing
    # says which of them it would be.
    together = float(np.logaddexp.reduce(nats))
    behind = max(nats) <= named.evidence if effect.needs else together <= named.evidence - MARGIN
    return None if behind else _best_of(fit, named, scan, rng)


def _others(fit: Fit, effect: Effect, found: dict[str, list[Score]]) -> dict[str, list[Score]]:
    """Without the forms that are the effect itself."""
    white, basis = fit.white_basis()
    (own,), _ = effect_candidates(fit, [effect])

    def projected(columns: Array) -> Array:
        rest = white(columns)
        return np.asarray(rest - basis @ (basis.T @ rest))

    span = np.linalg.qr(projected(own.columns))[0]

    def itself(score: Score) -> bool:
        rest = projected(score.candidate.columns)
        return bool(np.linalg.norm(rest - span @ (span.T @ rest)) < _ITSELF * np.linalg.norm(rest))

    left = {kind: [s for s in members if not itself(s)] for kind, members in found.items()}
    return {kind: members for kind, members in left.items() if members}


def _scored(
    fit: Fit, what: str, against: str, every: dict[str, list[tuple[float, ...]]],
    rng: np.random.Generator,
) -> dict[str, list[Score]]:  # fmt: skip
    effects, kind_of = [], {}
    for kind, values in every.items():
        for numbers in values:
            name = _name(what, against, kind, numbers)
            effect = known(name)
            if effect is not None and name not in kind_of:
                effects.append(effect)
                kind_of[name] = kind
    candidates, _ = effect_candidates(fit, effects)
    # Scores of many observations come without their columns, which tell a form from the name.
    whole = {candidate.name: candidate for candidate in candidates}
    found: dict[str, list[Score]] = {}
    for one in score(fit, candidates, rng, draws=0):
        found.setdefault(kind_of[one.name], []).append(replace(one, candidate=whole[one.name]))
    return found


def _driver(fit: Fit, what: str, against: str) -> Array:
    """Sorted distinct values of the driver, in g or as the covariate is, angles in degrees."""
    if what == "response":
        force = fitted_prediction(fit).force / STANDARD_GRAVITY
        values = force[..., ["xyz".index(a) for a in against]]
    else:
        values = fit.observations.context[against] / (DEG if against in _ANGLES else 1.0)
    return np.unique(np.round(values, 9))


def _sines(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    if against == "tool_face":
        # Beyond half of the settings a harmonic reads as a slower one: that one is the simpler.
        most = min(_HARMONICS, max(1, len(np.unique(np.round(np.mod(u, 360.0), 6))) // 2))
        yield from ((360.0 / k,) for k in range(1, most + 1))
        return
    span = float(np.ptp(u))
    shortest = max(4.0 * span / u.size, span / 16.0)
    yield from ((float(p),) for p in np.geomspace(shortest, 1.5 * span, 32))


def _powers(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    middle, reach = 0.5 * float(u[0] + u[-1]), 0.5 * float(np.ptp(u))
    if what == "response":
        middle, reach = 0.0, 1.0
    # The square of a temperature has a name, and a turning point that is looked for.
    powers = (3, 4, 5) if against == "temperature" else (2, 3, 4, 5)
    yield from ((float(k), middle, reach) for k in powers)


def _inside(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    yield from ((float(v),) for v in np.linspace(u[0], u[-1], 18)[2:-2])


def _steps(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    between = 0.5 * (u[1:] + u[:-1])
    edge = max(1, between.size // 12)
    picked = np.unique(np.linspace(edge, between.size - 1 - edge, 24).astype(int))
    yield from ((float(v),) for v in between[picked])


def _limits(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    if what == "response":
        yield from ((float(v),) for v in (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9))


def _teeth(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    for (period,) in _sines(u, what, against):
        yield from ((period, float(phase)) for phase in np.arange(8) / 8.0)


def _decays(u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    span = float(np.ptp(u))
    for share in (0.05, 0.1, 0.2, 0.4, 0.8):
        yield share * span, float(u[0])
        yield -share * span, float(u[-1])


_GRIDS = {
    "sine": _sines, "power": _powers, "kink": _inside, "step": _steps, "saturation": _limits,
    "soft_saturation": _limits, "saw_tooth": _teeth, "exponential": _decays,
}  # fmt: skip


def _numbers(kind: str, u: Array, what: str, against: str) -> Iterator[tuple[float, ...]]:
    return _GRIDS[kind](u, what, against) if u.size >= 8 else iter(())


def _numbers_of(name: str) -> tuple[float, ...]:
    return tuple(float(v) for v in name.split(":")[3:])


def _between(tried: list[tuple[float, ...]], best: tuple[float, ...]) -> list[tuple[float, ...]]:
    """Values of the first number between its neighbours in the scan."""
    first = np.unique([t[0] for t in tried])
    at = int(np.argmin(np.abs(first - best[0])))
    low, high = first[max(at - 1, 0)], first[min(at + 1, first.size - 1)]
    if low == high or np.allclose(first, np.round(first)):  # whole numbers have none between
        return []
    return [(float(v), *best[1:]) for v in np.linspace(low, high, _FINER + 2)[1:-1]]
