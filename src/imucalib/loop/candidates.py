"""What could be missing: catalogue effects, smooth probes, correlated noise and single records."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Effect, Family
from imucalib.core.eigen import eigen
from imucalib.core.fit import Fit
from imucalib.core.model import Prediction
from imucalib.core.truth import Truth
from imucalib.effects import known
from imucalib.effects.covariate import COLUMN
from imucalib.loop.evidence import Candidate
from imucalib.units import DEG, MG

#: Typical size of an unknown curve: 1 mg on an axis, 0.1 deg on an angle, 50 mg on one record.
_CURVE_MG, _CURVE_DEG, _RECORD_MG, _RECORD_DEG = 1.0, 0.1, 50.0, 2.0
#: Name of an error that all triads of one rigid body share.
ALL_TRIADS = "all"
_TERMS, _MOST_TERMS = 8, 32
#: Of a dial, whose teeth and rollers repeat up to six times a turn: as many as a curve can have.
_LOBES = 12
#: Beyond so many observations, noise in time is looked for in this many stretches.
_EXACT_NOISE, _STRETCHES = 400, 48


def effect_columns(fit: Fit, effect: Effect, prediction: Prediction | None = None) -> Array:
    """(N, m) columns of a catalogue effect at θ = 0, scaled by its typical sizes."""
    typical = np.array([p.typical for p in effect.parameters(fit.observations.context)])
    return np.asarray(effect_slopes(fit, effect, prediction) * typical)


def effect_slopes(fit: Fit, effect: Effect, prediction: Prediction | None = None) -> Array:
    """(N, m) what a catalogue effect does at θ = 0, per unit of each parameter.

    The effect's own derivative at the fitted truth, chained through what acts after it.
    prediction : of the fit, when it is there: an effect that does nothing at its start needs no new
        one
    """
    context = fit.observations.context
    start = np.array([p.start for p in effect.parameters(context)])
    if effect.stage == "mounting" or start.any():
        return fit.at.columns(_beside(fit, effect))
    prediction = prediction or fitted_prediction(fit)
    if effect.stage == "sensor":
        slope = effect.act(start, Truth(prediction.force), context).d_theta
    else:
        slope = effect.act(start, Truth(prediction.set_up), context).d_theta
        slope = prediction.d_set_up @ slope
    return fit.at.columns(slope)


def _beside(fit: Fit, effect: Effect) -> Array:
    """(n, K, 3, p) slopes of an effect at its start in the model that has it."""
    extended = fit.model.plus(effect)
    context, reference = fit.observations.context, fit.observations.reference
    slices = extended.slices(context)
    theta = extended.start(context)
    for name, part in fit.model.slices(context).items():
        theta[slices[name]] = fit.theta[part]
    prediction = extended.predict(theta, reference.truth(fit.eta), context)
    return prediction.d_theta[..., slices[effect.name]]


def effect_candidates(
    fit: Fit, effects: Iterable[Effect], *, parts: bool = False
) -> tuple[tuple[Candidate, ...], dict[str, str]]:
    """Candidates of all effects that the context can carry, and why the others cannot be tested.

    parts : whether what gravity's size shows as a part of another effect is tried by itself, where
        that has more numbers: in two dozen rows it only raises the bar
    """
    found, missing = [], {}
    prediction = fitted_prediction(fit)
    for effect in effects:
        if effect.name in fit.model.names:
            continue
        reason = effect.missing(fit.observations.context)
        undirected = bool(effect.part_of) and not fit.observations.reference.directed
        if undirected and (not parts or _no_smaller(effect, fit)):
            reason = f"by the size of gravity alone it is a part of {effect.part_of}"
        if reason or not effect.parameters(fit.observations.context):
            missing[effect.name] = reason or "it has no parameter on these data"
            continue
        columns = effect_columns(fit, effect, prediction)
        found.append(Candidate(effect.name, "effect", columns))
    return tuple(found), missing


def _no_smaller(effect: Effect, fit: Fit) -> bool:
    """Whether what holds an effect has no more numbers than it, so that nothing speaks for the
    part: a part with fewer leads the whole by those that it does without."""
    whole, context = known(effect.part_of), fit.observations.context
    return whole is not None and len(effect.parameters(context)) >= len(whole.parameters(context))


def fitted_prediction(fit: Fit) -> Prediction:
    """The fitted model's prediction of the fit's own observations."""
    context, reference = fit.observations.context, fit.observations.reference
    return fit.model.predict(fit.theta, reference.truth(fit.eta), context)


def family_candidates(fit: Fit, family: Family, values: Sequence[str]) -> tuple[Candidate, ...]:
    """Candidates of some members of a scan; those that the context cannot carry are left out."""
    found, _ = effect_candidates(fit, [family.member(value) for value in values])
    return tuple(replace(c, family=family.name, unfounded=family.unfounded) for c in found)


def _cosines(values: Array, terms: int) -> Array:
    """(n, terms) smooth curves over the range of a covariate, rougher ones smaller."""
    span = float(np.ptp(values))
    unit = (values - values.min()) / span if span > 0.0 else np.zeros_like(values)
    k = np.arange(1, terms + 1)
    return np.asarray(np.sqrt(2.0) * np.cos(np.pi * k * unit[:, None]) / k)


def _harmonics(angle: Array, terms: int) -> Array:
    k = np.arange(1, terms // 2 + 1)
    waves = np.concatenate([np.sin(angle[:, None] * k), np.cos(angle[:, None] * k)], axis=1)
    return np.asarray(waves / np.concatenate([k, k]))


def probes(fit: Fit) -> tuple[Candidate, ...]:
    """Smooth curves of every sensor axis and every reference angle against every covariate."""
    context, reference = fit.observations.context, fit.observations.reference
    prediction = fitted_prediction(fit)
    directions = reference.directions(fit.eta)
    n, k, _ = prediction.reading.shape
    found = []
    fine = int(np.clip(2 * n // 5, _TERMS, _MOST_TERMS))
    every = list[Array]()
    for axis, letter in enumerate("xyz"):
        curves = _cosines(prediction.force[:, :, axis].ravel(), fine).reshape(n, k, fine)
        block = np.zeros((n, k, 3, fine))
        block[:, :, axis] = curves * _CURVE_MG * MG
        every.append(block)
        name = f"response of {letter} against its own input"
        found.append(_probe(fit, name, block, letter, f"response:{letter}:-1:1"))
    name, block = "response of each axis against its own input", np.concatenate(every, axis=-1)
    found.append(_probe(fit, name, block, "xyz", "response:xyz:-1:1"))
    named = [name for name in context.covariates if name.startswith(COLUMN)]
    for name in ("order", "temperature", "inclination", "tool_face", *named):
        if name not in context or np.ptp(context[name]) <= 0.0:
            continue
        periodic = name == "tool_face"
        terms = min(_LOBES if periodic else _TERMS, max(2, len(np.unique(context[name])) - 1))
        curves = (_harmonics if periodic else _cosines)(context[name], terms)
        words = name.removeprefix(COLUMN) if name in named else name.replace("_", "-")
        block = np.einsum("nt,ij->nijt", curves, np.eye(3))[:, None]
        wide = np.broadcast_to(block, (n, k, 3, 3, curves.shape[1])).reshape(n, k, 3, -1)
        span = f"{name}:{np.min(context[name]):.10g}:{np.max(context[name]):.10g}"
        wide = wide * _CURVE_MG * MG
        found.append(_probe(fit, f"bias against {words}", wide, words, f"bias:{span}"))
        for column, component in enumerate(directions.component):
            what = (component or "").replace(" setting", "")
            if what.replace("-", "_") not in context:  # flat, or a tilt that no dial shows
                continue
            angle = prediction.d_truth @ directions.derivative[..., column, None]
            block = angle * curves[:, None, None, :] * _CURVE_DEG * DEG
            curve = f"{what.replace('-', '_')}:{span}"
            found.append(_probe(fit, f"{what} error against {words}", block, words, curve))
    return tuple(found)


def _probe(fit: Fit, name: str, block: Array, driver: str, curve: str) -> Candidate:
    return Candidate(name, "probe", fit.at.columns(block), driver, curve=curve)


def correlated_noise(fit: Fit) -> tuple[Candidate, ...]:
    """Noise that neighbours in the order of recording share (an exponential correlation)."""
    context = fit.observations.context
    if "order" not in context or context.n < 8:
        return ()
    position = np.argsort(np.argsort(context["order"])).astype(float)
    if context.n > _EXACT_NOISE:
        return (_stretches(fit, position),)
    covariance = np.exp(-np.abs(position[:, None] - position[None]) / 2.0)
    values, vectors = eigen(covariance)
    top = slice(max(0, context.n - 16), None)
    curves = vectors[:, top] * np.sqrt(values[top])
    k = fit.observations.reading.shape[1]
    block = np.einsum("nt,ij->nijt", curves, np.eye(3)).reshape(context.n, 1, 3, -1)
    wide = np.broadcast_to(block, (context.n, k, 3, block.shape[-1]))
    columns = fit.at.columns(wide * _CURVE_MG * MG)
    return (Candidate("noise correlated in time", "noise", columns, "order"),)


def _stretches(fit: Fit, position: Array) -> Candidate:
    """An error that all neighbours of one stretch of time share, stretch by stretch."""
    n = position.size
    of = np.minimum((position * _STRETCHES / n).astype(int), _STRETCHES - 1)
    one = (of[fit.at.owner][:, None] == np.arange(_STRETCHES)).astype(float)
    columns = one * _CURVE_MG * MG / fit.at.sigma[fit.at.owner, :1]
    return Candidate("noise correlated in time", "noise", columns, "order")


def record_candidates(fit: Fit) -> tuple[Candidate, ...]:
    """A free error on every component of every record, and on every setting of the bench."""
    at, labels = fit.at, fit.observations.label
    n, k, _ = fit.observations.reading.shape
    found = []
    if at.keep.shape[2] == 3 * k:
        for row in range(n):
            for axis in range(3 * k):
                column = np.zeros((n, 3 * k, 1))
                column[row, axis] = _RECORD_MG * MG / at.sigma[row, axis]
                name = f"{row}:{'xyz'[axis % 3]}"
                found.append(Candidate(name, "record", column.reshape(-1, 1), labels[row]))
    elif k == 1:
        for row in range(n):
            own = (at.owner == row).astype(float)[:, None] * _RECORD_MG * MG / at.sigma[row, 0]
            found.append(Candidate(f"{row}:norm", "record", own, labels[row]))
    else:
        found += _shared_direction(fit)
    own_settings: dict[tuple[int, str], list[Array]] = {}
    for name, matrix in zip(at.component[: at.free], at.settings, strict=False):
        for setting in range(matrix.shape[1]):
            column = matrix[:, setting : setting + 1] * _RECORD_DEG * DEG
            rows = np.unique(at.owner[np.abs(column[:, 0]) > 1e-9 * np.abs(column).max()])
            if rows.size == 1:  # a setting of several rows is not one record
                own_settings.setdefault((int(rows[0]), name), []).append(column)
    for (row, name), columns in own_settings.items():
        block = np.concatenate(columns, axis=1)
        found.append(Candidate(f"{row}:{name}", "record", block, labels[row]))
    return tuple(found)


def _shared_direction(fit: Fit) -> list[Candidate]:
    """Of triads that share gravity's direction: one of them off by itself, or all alike."""
    context, labels = fit.observations.context, fit.observations.label
    n, k, _ = fit.observations.reading.shape
    found = []
    for row in range(n):
        block = np.zeros((n, k, 3, 3))
        block[row] = context.in_own(np.broadcast_to(np.eye(3), (1, 1, 3, 3)))[0]
        for triad, name in enumerate(context.triads):
            alone = np.zeros_like(block)
            alone[row, triad] = block[row, triad]
            columns = fit.at.columns(_RECORD_MG * MG * alone)
            found.append(Candidate(f"{row}:{name}", "record", columns, labels[row]))
        columns = fit.at.columns(_RECORD_MG * MG * block)
        found.append(Candidate(f"{row}:{ALL_TRIADS}", "record", columns, labels[row]))
    return found
