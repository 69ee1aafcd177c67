"""What else would do: the final model with one effect exchanged for each that may replace it.

Numbers that are read from one of several rivals carry the doubt between them: their mean by
evidence, and the spread of the rivals in their interval (Hoeting et al. 1999, eq. 2 and 3).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from string import ascii_lowercase

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.core.effect import Effect, Response
from imucalib.core.fit import Fit
from imucalib.effects import across, known
from imucalib.effects.thermal.lag import PREFIX, covariate
from imucalib.loop.candidates import effect_candidates
from imucalib.loop.evidence import Candidate, Score, apart, score
from imucalib.loop.found import FitLoop, LoopSettings, Step
from imucalib.loop.noise.shared import (
    WANDERING,
    WANDERING_SCALE,
    imitated_by_a_scale,
    lead_over_a_walk,
)
from imucalib.loop.records import extended, reduced
from imucalib.loop.search import effect_named, thinned
from imucalib.loop.thresholds import APART, CURVE_TERMS, MARGIN

#: What stands beside a name of a size that no data sheet tells: another effect, of nobody's list.
UNLISTED = "unlisted_effect"
_SURE = 2.0  # standard errors
#: What says where the sensor points; harmonics of the tool-face that tell the phase of a swing, and
#: the share of its power from which they do.
_POSITION = (
    "response", "inclination", "tool_face",
    *(f"{before}_{axis}" for before in ("previous", "approach") for axis in "xyz"),
)  # fmt: skip
_SWING, _HARMONICS, _IN_STEP = ("cycle@", "scale_cycle@"), 6, 0.8
#: Share of a tool-face's turning that goes at one pace, from which on it has one, and turns over a
#: recording by which what changes the size of what it causes, as the inclination, moves that pace.
_PACED, _MOVED = 0.5, 0.5
#: Turns by which two swings must part over a recording to be two.
_APART = 1.5
#: Covariates by which time drives an effect.
_TIME = ("order", "record", "sweep", "time", "time_of_day")


@dataclass(frozen=True)
class Rival:
    """One of the models that would do; weight : of all of them together, 1."""

    name: str
    weight: float
    fit: Fit


def rivals_of(loop: FitLoop) -> tuple[tuple[Rival, ...], ...]:
    """For every named effect with others beside it, itself and these."""
    return tuple(found for step in loop.named if len(found := _of_step(loop, step)) > 1)


def _of_step(loop: FitLoop, step: Step) -> tuple[Rival, ...]:
    effects = [e for name in (step.effect, *step.aliases) if (e := known(name)) is not None]
    if len(effects) < 2 or step.effect not in loop.final.model.names:
        return ()
    without = reduced(loop.final, (step.effect,))
    candidates, _ = effect_candidates(without, effects)
    nothing_drawn = np.random.default_rng(0)
    scores = score(without, candidates, nothing_drawn, draws=0)
    nats = {s.name: s.evidence for s in scores}
    best = max(nats.values())
    found = []
    for effect in effects:
        if effect.name not in nats:
            continue
        fit = loop.final if effect.name == step.effect else extended(without, effect)
        if fit.converged and not fit.null_directions:
            found.append((effect.name, float(np.exp(nats[effect.name] - best)), fit))
    total = sum(weight for _, weight, _ in found)
    return tuple(Rival(name, weight / total, fit) for name, weight, fit in found)


def aliases(
    current: Fit,
    effects: Mapping[str, Effect],
    chosen: Score,
    scores: tuple[Score, ...],
    rules: LoopSettings,
) -> tuple[str, ...]:
    """Effects that would do as well: nearly the same evidence, or too small an angle between; and a
    curve of another driver with nearly the same evidence, though it pays for its many numbers."""
    near = max(chosen.evidence - 3.0, chosen.evidence / 2.0)
    thin = thinned(current, rules.most_scored)

    def columns(name: str) -> Candidate:
        return effect_candidates(thin, [effect_named(effects, name)])[0][0]

    def beside(rival: Score) -> bool:
        own = rival.candidate.family and rival.candidate.family == chosen.candidate.family
        if rival.candidate.kind != "effect" or rival.name == chosen.name or own:
            return False
        if rival.evidence >= near:
            return True
        alike = rival.evidence >= chosen.evidence / 2.0
        return alike and apart(thin, columns(chosen.name), columns(rival.name)) < APART

    names = tuple(s.name for s in scores if beside(s))
    return names + _curve_beside(effect_named(effects, chosen.name), chosen, scores)


def _curve_beside(effect: Effect, chosen: Score, scores: tuple[Score, ...]) -> tuple[str, ...]:
    own = {_driver(name) for name in effect.needs} or {"response"}
    for s in scores:
        what, _, rest = s.candidate.curve.partition(":")
        of = what if what == "response" else _driver(rest.partition(":")[0])
        if s.candidate.curve and s.evidence >= chosen.evidence - MARGIN and of not in own:
            return (f"curve@{s.candidate.curve}:{CURVE_TERMS[1]}",)
    return ()


def _driver(covariate: str) -> str:
    """What drives: time by whatever name, the temperature be it of now or earlier."""
    if covariate.startswith("temperature"):
        return "temperature"
    return "order" if covariate in _TIME else covariate


def without_a_name(before: Fit, after: Fit, chosen: Score, margin: float) -> tuple[str, ...]:
    """What would do as well and has no name: a bias that wanders slowly, or the scale beside what
    goes with the force, unless the effect leads it by `margin` nats; and whatever else where its
    size is beyond what data sheets tell, where the model holds a form of the same driver that has
    no cause, where a swing keeps step or beats, where a lag is the longest that was tried, or where
    a polynomial has no cause of its own."""
    walk = lead_over_a_walk(before, chosen.evidence) < margin
    effect = known(chosen.name)
    forced = isinstance(effect, Response) and effect.basis_dx is not None
    scaled = forced and imitated_by_a_scale(before, after, chosen.name, margin)
    alike = effect is not None and (
        _course(effect.needs) in _of_forms(before.model.names)
        or _swings_in_step(before, chosen.name)
        or any(_beats(before.observations.context, chosen.name, n) for n in before.model.names)
        or _is_longest(before.observations.context, chosen.name)
        or chosen.name.startswith(across.PREFIX)
    )
    other = alike or beyond_usual(after, chosen.name)
    return (WANDERING,) * walk + (WANDERING_SCALE,) * scaled + (UNLISTED,) * other


def _course(needs: tuple[str, ...]) -> str:
    """What an effect follows: time first, then the temperature, else where the sensor points."""
    drivers = {_driver(name) for name in needs}
    timed = "order" in drivers
    other = drivers - set(_POSITION) - {"order"}
    return "order" if timed else min(other) if other else "position"


def _of_forms(names: tuple[str, ...]) -> set[str]:
    """What the forms and curves of a model follow, whose cause nobody knows."""
    parts = [n.partition("@")[2].split(":") for n in names if n.startswith(("shape@", "curve@"))]
    return {_course(() if what == "response" else (against,)) for what, against, *_ in parts}


def beside(fit: Fit, steps: Iterable[Step], chosen: Score) -> tuple[Step, ...]:
    """Steps as they stand beside a new one: a swing that beats with it comes and goes."""
    context = fit.observations.context
    return tuple(
        replace(s, aliases=(*s.aliases, UNLISTED)) if _beats(context, s.effect, chosen.name) else s
        for s in steps
    )


def _beats(context: Context, one: str, other: str) -> bool:
    """Whether two swings are nearer in frequency than the recording is long: together they are one
    whose size changes."""
    if not (one.startswith(_SWING) and other.startswith(_SWING)):
        return False
    swings = known(one), known(other)
    if swings[0] is None or swings[1] is None or swings[0].needs != swings[1].needs:
        return False
    first, second = (_number(name.partition("@")[2]) for name in (one, other))
    span = float(np.ptp(context[swings[0].needs[0]]))
    return abs(1.0 / first - 1.0 / second) * span < _APART


def _is_longest(context: Context, name: str) -> bool:
    """Whether a lag is the longest of those tried: what creeps on for ever looks like it too."""
    lags = [c for c in context.covariates if c.startswith(PREFIX)]
    own = covariate(name.partition("@")[2])
    return own in lags and own == max(lags, key=lambda lag: _number(lag.removeprefix(PREFIX)))


def _number(value: str) -> float:
    """The number of a value such as "7.3rows", "222s" or "0.5h"."""
    return float(value.rstrip(ascii_lowercase))


def _swings_in_step(before: Fit, name: str) -> bool:
    """Whether a swing, or one that it stands beside, keeps step with what else may cause it."""
    if not name.startswith(_SWING):
        return False
    swings = [name, *(n for n in before.model.names if n.startswith(_SWING))]
    effects = [effect for n in swings if (effect := known(n)) is not None]
    return any(keeps_step(before.observations.context, effect) for effect in effects)


def keeps_step(context: Context, swing: Effect) -> bool:
    """Whether the phase of a swing is told by the tool-face, or by the temperature and its change:
    then either may be its cause. So, of a scale, may a tool-face that turns at nearly its
    pace: what goes with that and changes its size, as with the inclination, beats."""
    angle = 2.0 * np.pi * context[swing.needs[0]] / _number(swing.name.partition("@")[2])
    wave = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    t = context["tool_face"]
    turns = min(_HARMONICS, max(1, len(np.unique(np.round(np.mod(t, 2.0 * np.pi), 6))) // 2))
    scale = swing.name.startswith(_SWING[1])
    if scale and any(_beats_with(angle, k * t) for k in range(1, turns + 1)):
        return True
    columns = [f(k * t) for k in range(1, turns + 1) for f in (np.cos, np.sin)]
    if "temperature" in context and np.ptp(context["temperature"]) > 0.0:
        warm = context["temperature"] - context["temperature"].mean()
        return max(_told(wave, columns), _told(wave, [warm, warm**2, np.gradient(warm)])) > _IN_STEP
    return _told(wave, columns) > _IN_STEP


def _beats_with(angle: Array, turned: Array) -> bool:
    """Whether a swing's angle (n,) and that of a tool-face part by less than `_MOVED` turns over
    the recording, either way round."""
    share = (angle - angle[0]) / (angle[-1] - angle[0])
    apart = np.linspace(-_MOVED, _MOVED, 41)[:, None] * 2.0 * np.pi * share
    power = [np.abs(np.exp(1j * (turned + way * angle + apart)).mean(axis=1)) for way in (-1, 1)]
    return bool(np.max(power) ** 2 > _PACED)


def _told(wave: Array, columns: list[Array]) -> float:
    """Share of a wave's power that columns and a constant explain, adjusted for their number."""
    design = np.linalg.qr(np.column_stack([np.ones(len(wave)), *columns]))[0]
    centred = wave - wave.mean(axis=0)
    rest = centred - design @ (design.T @ centred)
    left = max(len(wave) - design.shape[1], 1) / (len(wave) - 1)
    return float(1.0 - np.sum(rest**2) / np.sum(centred**2) / left)


def beyond_usual(fit: Fit, name: str) -> bool:
    """Whether an effect of a fit is surely larger than data sheets let one expect."""
    part = fit.model.slices(fit.observations.context).get(name, slice(0))
    sure = np.abs(fit.theta[part]) - _SURE * fit.sd[part]
    usual = np.array([p.usual for p in fit.parameters[part]])
    return bool(np.any(sure > usual))
