"""What changes from one power-up to the next, and how far it carries: this session and the next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import NoiseMixture
from imucalib.data import Data
from imucalib.estimators.power_ups import Parts, sizes_allowed


class ScatterFacts(Data):
    """What scatters between sessions."""

    what: str
    unit: str
    sd: Annotated[float, "Of all axes."]
    low_95: Annotated[float, "Of what the data allow."]
    high_95: float
    offsets: Annotated[Array, "Of each session from the mean, by axis."]
    offsets_sd: Array

    @property
    def effect(self) -> str:
        """Whose parameters carry it: "bias" of "session bias"."""
        return self.what.rpartition(" ")[2]


class NextPowerUpFacts(Data):
    """A parameter after the next power-up."""

    parameter: str
    unit: str
    value: float
    sd_of_mean: Annotated[float, "Of the mean over power-ups."]
    sd_next_power_up: float
    half_of_95: Annotated[float, "Of the interval of the next one."]

    @property
    def effect(self) -> str:
        """Whose it is: "bias" of "bias_x"."""
        return self.parameter.rpartition("_")[0]


class BetweenSessions(Data):
    """How much power-ups scatter, each one's own offset, and the next one's parameters."""

    sessions: tuple[str, ...]
    scatter: tuple[ScatterFacts, ...]
    next_power_up: tuple[NextPowerUpFacts, ...]


def estimate_scatter(
    what: str, unit: str, parts: Parts, sd: float, parameters: Sequence[tuple[str, float, float]]
) -> tuple[ScatterFacts, tuple[NextPowerUpFacts, ...]]:
    """The scatter of parts, and their parameters after the next power-up.

    what : name of the component; parts : three each, in the unit; sd : that the fit has taken them
    to scatter by; parameters : name, value of the mean and its sd, none where nothing carries them
    """
    sizes, weights, by_axis = sizes_allowed(parts, sd)
    offsets, spread = parts.predict(np.full(3, sd))
    below = np.cumsum(weights) - 0.5 * weights
    low, high = np.interp((0.025, 0.975), below, sizes)
    found = []
    for axis, (parameter, value, mean) in enumerate(parameters):
        # The mean's variance holds a share of what the scatter is taken to be.
        share = (sizes**2 - sd**2) / len(offsets)
        var = np.maximum(mean**2 + share, 0.1 * mean**2) + sizes**2
        next_one = NoiseMixture(
            log_sd=np.zeros(0),
            weight=by_axis[axis],
            shift=np.zeros((len(var), 1)),
            covariance=var[:, None, None],
        )
        found.append(
            NextPowerUpFacts(
                parameter=parameter,
                unit=unit,
                value=value,
                sd_of_mean=mean,
                sd_next_power_up=float(np.sqrt(by_axis[axis] @ var)),
                half_of_95=float(next_one.half_widths(np.ones((1, 1)))[0]),
            )
        )
    scatter = ScatterFacts(
        what=what,
        unit=unit,
        sd=sd,
        low_95=float(low),
        high_95=float(high),
        offsets=offsets,
        offsets_sd=np.sqrt(np.maximum(np.diag(spread), 0.0)).reshape(-1, 3),
    )
    return scatter, tuple(found)
