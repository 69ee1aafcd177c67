"""Ambiguities of a finished search over observations, and columns of what could be observed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Balanced, Noise, balance, whitener
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.effects import known, names_a_cause
from imucalib.effects.record_error import is_record_error
from imucalib.loop.candidates import effect_columns
from imucalib.loop.found import FitLoop, Step
from imucalib.loop.records import reduced
from imucalib.loop.separation.products import Ambiguity, Products

#: Share of an effect's evidence from which another is watched: cos² of the angle between them.
NEAR = 0.25


def ambiguities(
    loop: FitLoop, white: Callable[[Array], Array] | None = None
) -> tuple[Ambiguity, ...]:
    """Of every named effect that has rivals in the catalogue.

    white : of columns in units of the declared noise, where that is more than settings
    """
    found = (_of_step(loop, step, white) for step in loop.named)
    return tuple(one for one in found if one is not None)


def _of_step(loop: FitLoop, step: Step, white: Callable[[Array], Array] | None) -> Ambiguity | None:
    causes = filter(names_a_cause, (step.effect, *step.aliases))
    named = [e for name in causes if (e := known(name)) is not None]
    if len(named) < 2 or step.effect not in loop.final.model.names:
        return None
    without = reduced(loop.final, (step.effect,))
    context = without.observations.context
    able = [e for e in (*named, *_near(loop, step)) if e.name not in without.model.names]
    effects = [e for e in able if not e.missing(context)]
    rivals = tuple(e.name for e in effects if e in named)
    if len(rivals) < 2:
        return None
    columns = [effect_columns(without, e) for e in effects]
    held = replace(without, noise=loop.final.noise)
    base, products = _without_records(held, _products(held, columns, white))
    ends = np.cumsum([len(base), *(c.shape[1] for c in columns)])
    nats = {s.name: s.evidence for s in loop.first_scores} | {step.effect: step.evidence}
    return Ambiguity(
        effect=step.effect,
        base=tuple(n for n in without.model.names if not is_record_error(n)),
        columns=(*base, *(p.name for e in effects for p in e.parameters(context))),
        rivals=rivals,
        blocks={e.name: np.arange(a, b) for e, a, b in zip(effects, ends, ends[1:], strict=False)},
        nats={e.name: float(nats.get(e.name, np.nan)) for e in effects},
        products=products,
        dof=float(loop.final.dof),
    )


def _near(loop: FitLoop, step: Step) -> list[Effect]:
    """Effects that are no rivals yet, but take over so much that more data may make them some."""
    taken = {name.partition("@")[0] for name in (step.effect, *step.aliases)}
    near = [
        s.name
        for s in loop.first_scores
        if s.kind == "effect"
        and s.evidence >= NEAR * step.evidence
        and s.name.partition("@")[0] not in taken
        and s.name not in loop.final.model.names
    ]
    return [e for name in filter(names_a_cause, near) if (e := known(name)) is not None]


def _products(
    fit: Fit, columns: Sequence[Array], white: Callable[[Array], Array] | None
) -> Products:
    typical = np.array([p.typical for p in fit.parameters])
    white = white or whitener(fit.at.settings, fit.noise.ratio)
    every = np.column_stack([fit.at.jacobian * typical, *columns])
    seen = white(every) / fit.noise.factor
    data = white(fit.at.residual) / fit.noise.factor
    return Products(seen.T @ seen, seen.T @ data, float(data @ data), float(data.size))


def _without_records(fit: Fit, products: Products) -> tuple[list[str], Products]:
    """Without the columns of records that are set aside, which are free."""
    context, slices = fit.observations.context, fit.model.slices(fit.observations.context)
    aside = [np.arange(part.start, part.stop) for n, part in slices.items() if is_record_error(n)]
    free = np.concatenate(aside) if aside else np.zeros(0, np.intp)
    names = [p.name for k, p in enumerate(fit.model.parameters(context)) if k not in free]
    if not free.size:
        return names, products
    kept = np.setdiff1d(np.arange(len(products.gram)), free)
    inside = np.linalg.pinv(products.gram[np.ix_(free, free)], rcond=1e-12, hermitian=True)
    across, along = products.gram[np.ix_(free, kept)], products.along[free]
    return names, Products(
        products.gram[np.ix_(kept, kept)] - across.T @ inside @ across,
        products.along[kept] - across.T @ inside @ along,
        products.power - float(along @ inside @ along),
        products.numbers - free.size,
    )


def columns_of(
    model: Model, theta: Array, rivals: Sequence[Effect], data: Observations, noise: Noise
) -> Array:
    """(n, r, P) columns of the model's parameters and of the rivals', each observation's r numbers
    whitened by themselves, in units of the noise and at typical sizes.

    data : with sigma the noise of a reading, m/s², and settings that no two observations share
    noise : factor 1, and the settings' standard deviations by name
    """
    eta = data.reference.start(model.correct(theta, data.reading, data.context))
    at = balance(model, theta, eta, data)
    typical = np.array([p.typical for p in model.parameters(data.context)])
    blocks = [at.jacobian * typical]
    truth = data.reference.truth(eta)
    for effect in rivals:
        grown = model.plus(effect)
        slices, start = grown.slices(data.context), grown.start(data.context)
        for name, part in model.slices(data.context).items():
            start[slices[name]] = theta[part]
        slope = grown.predict(start, truth, data.context).d_theta[..., slices[effect.name]]
        size = np.array([p.typical for p in effect.parameters(data.context)])
        blocks.append(at.columns(slope * size))
    return _each_white(at, np.column_stack(blocks), data.n, noise)


def _each_white(at: Balanced, columns: Array, n: int, noise: Noise) -> Array:
    rows = columns.reshape(n, -1, columns.shape[1])
    covariance = np.broadcast_to(np.eye(rows.shape[1]), (n, rows.shape[1], rows.shape[1])).copy()
    sds = dict(zip(noise.component, noise.sd, strict=True))
    for name, matrix in zip(at.component, at.settings, strict=True):
        own = matrix.reshape(n, rows.shape[1], -1)
        covariance += sds.get(name, 0.0) ** 2 * own @ own.transpose(0, 2, 1)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), rows))
