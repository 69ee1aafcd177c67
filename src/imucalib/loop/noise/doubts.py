"""Whether the noise is what the model takes it for: its size as declared, its tails as normal."""

from __future__ import annotations

import math

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.loop.evidence import Score
from imucalib.loop.found import LoopSettings, Unexplained
from imucalib.loop.noise.axes import doubtful_axes, doubtful_sessions
from imucalib.loop.noise.settings import doubtful_dials, strongest
from imucalib.loop.noise.shared import shared_evidence
from imucalib.units import MG

_MOST_DRAWN = 2000  # numbers on which tails are judged by simulation


def noise_doubts(
    fit: Fit,
    rng: np.random.Generator,
    rules: LoopSettings,
    *,
    shared: bool = False,
    scores: tuple[Score, ...] = (),
) -> tuple[Unexplained, ...]:
    """What speaks against the noise model, most serious first; no effect is claimed by it.

    shared : whether noise that neighbours share counts as structure: where nothing else was found
    scores : of the last search; effects that explain at least as much as that noise stand beside it
    """
    found = []
    nats = shared_evidence(fit) if shared else 0.0
    # Twice the gain of a variance on its border and of its memory: chi-square of two overstates p.
    if (p := math.exp(-nats)) < rules.noise_alpha:
        size = fit.noise.sd[-1] / MG
        assert fit.observations.walk is not None
        memory = fit.observations.walk.memory
        name = f"noise that neighbours share, {size:.2g} mg, forgotten in {memory:.2g} positions"
        likely = strongest(s for s in scores if s.candidate.kind == "effect")[:2]
        if likely:
            name += f" ({' or '.join(likely)} would do as well)"
        found.append(Unexplained(name, "order", "noise", p, nats, 0.0, alike=likely))
    if rules.declared and (p := beyond_declared(fit)) < rules.noise_alpha:
        name = f"scatter {fit.noise.factor:.2g} times the declared noise"
        found.append(Unexplained(name, "", "noise", p, 0.0, 1.0 - fit.noise.factor**-2.0))
    loud = (*doubtful_axes(fit, rules.noise_alpha), *doubtful_sessions(fit, rules.noise_alpha))
    found += [*loud, *doubtful_dials(fit, scores, rules.noise_alpha)]
    tails = 1.0 if loud else heavy_tails(fit, rng, round(2.0 / rules.noise_alpha))
    if (p := tails) < rules.noise_alpha:  # a mixture has heavy tails
        found.append(Unexplained("heavy tails", "", "noise", p, 0.0, 0.0))
    return tuple(found)


def beyond_declared(fit: Fit) -> float:
    """Chance of a noise factor this far above 1 if the declared noise were true.

    Chi-square (upper tail), with as many degrees of freedom as the estimate of the factor is worth:
    settings that scatter take some away.
    """
    from scipy.special import chdtrc

    spread = float(fit.noise_covariance[0, 0])
    dof = 0.5 / spread if spread > 0.0 else float(fit.dof)
    return float(chdtrc(dof, dof * fit.noise.factor**2))


def heavy_tails(fit: Fit, rng: np.random.Generator, draws: int) -> float:
    """Chance of a kurtosis this large in normal noise that went through the same projection."""
    white, basis = fit.white_basis()
    left = np.sqrt(np.maximum(1.0 - np.einsum("ij,ij->i", basis, basis), 0.0))
    use = left > 1e-4  # a number that the fit takes over says nothing
    if use.sum() < 8:
        return 1.0

    def kurtosis(data: Array) -> Array:
        rest = data - basis @ (basis.T @ data)
        square = (rest[use] / left[use, None]) ** 2
        return np.asarray(np.mean(square**2, axis=0) / np.mean(square, axis=0) ** 2)

    own = float(kurtosis(white(fit.at.residual)[:, None])[0])
    size = len(left)
    if size > _MOST_DRAWN:
        return 0.5 * math.erfc((own - 3.0) / math.sqrt(48.0 / size))
    null = kurtosis(rng.standard_normal((size, draws)))
    return (1 + int((null >= own).sum())) / (draws + 1)
