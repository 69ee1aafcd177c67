"""Recordings with planted effects: the model run forwards, with its noise and setting errors."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Noise
from imucalib.core.model import Model
from imucalib.core.observations import Observations


def simulate(
    model: Model,
    theta: Array,
    observations: Observations,
    noise: Noise,
    rng: np.random.Generator,
) -> Observations:
    """Draw new readings for the reference and context of `observations`.

    The settings' errors are drawn with the components' standard deviations and shared as the
    reference says; a reference without components keeps its truth at `start` of the readings.
    """
    reference, context = observations.reference, observations.context
    eta = reference.start(observations.reading)
    directions = reference.directions(eta)
    if any(directions.component):
        for column, component in enumerate(directions.component):
            sd = noise.sd[noise.component.index(component)] if component else 0.0
            used = np.unique(directions.index[:, column])
            eta[used] = sd * rng.standard_normal(used.size)
    clean = model.predict(theta, reference.truth(eta), context).reading
    spread = noise.factor * observations.sigma
    return observations.with_reading(clean + spread * rng.standard_normal(clean.shape))
