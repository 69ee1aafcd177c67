"""What changes from one power-up to the next, and how far it carries: this session and the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import NoiseMixture
from imucalib.data import Data
from imucalib.estimators.power_ups import Parts, sizes_allowed


@dataclass(frozen=True)
class Between:
    """The scatter of one component between sessions.

    name : of the component; effect : whose parameters carry it; unit : that it is given in; sd : of
    all axes; interval : 95 % of what the data allow
    offsets, offsets_sd : (sessions, 3) of each session from the mean, in that unit
    """

    name: str
    effect: str
    unit: str
    sd: float
    interval: tuple[float, float]
    offsets: Array
    offsets_sd: Array


@dataclass(frozen=True)
class NextPowerUp:
    """A parameter after the next power-up: mean : sd of the mean over power-ups, sd : of the next
    one, half : half of its 95 % interval"""

    name: str
    effect: str
    unit: str
    value: float
    mean: float
    sd: float
    half: float


class ScatterFacts(Data):
    """What scatters between sessions."""

    what: str
    unit: str
    sd: Annotated[float, "Of all axes."]
    low_95: Annotated[float, "Of what the data allow."]
    high_95: float
    offsets: Annotated[Array, "Of each session from the mean, by axis."]
    offsets_sd: Array


class NextPowerUpFacts(Data):
    """A parameter after the next power-up."""

    parameter: str
    unit: str
    value: float
    sd_of_mean: Annotated[float, "Of the mean over power-ups."]
    sd_next_power_up: float
    half_of_95: Annotated[float, "Of the interval of the next one."]


class BetweenSessions(Data):
    """How much power-ups scatter, each one's own offset, and the next one's parameters."""

    sessions: tuple[str, ...]
    scatter: tuple[ScatterFacts, ...]
    next_power_up: tuple[NextPowerUpFacts, ...]


@dataclass(frozen=True)
class Sessions:
    """names : of the sessions, in the order of the offsets; between : what scatters between them;
    parameters : every one that changes with power-ups"""

    names: tuple[str, ...]
    between: tuple[Between, ...]
    parameters: tuple[NextPowerUp, ...]

    def describe(self) -> BetweenSessions:
        """What report.json and calibration.yaml tell of it."""
        facts = "parameter=name sd_of_mean=mean sd_next_power_up=sd half_of_95=half"
        scatter = tuple(
            ScatterFacts.of(one, "what=name", low_95=one.interval[0], high_95=one.interval[1])
            for one in self.between
        )
        following = tuple(NextPowerUpFacts.of(one, facts) for one in self.parameters)
        return BetweenSessions(self.names, scatter, following)


def estimate_scatter(
    what: tuple[str, str, str],
    parts: Parts,
    sd: float,
    parameters: Sequence[tuple[str, float, float]],
) -> tuple[Between, tuple[NextPowerUp, ...]]:
    """The scatter of parts, and their parameters after the next power-up.

    what : name, effect and unit; parts : three each, in that unit; sd : that the fit has taken them
    to scatter by; parameters : name, value of the mean and its sd, none where nothing carries them
    """
    sizes, weights, by_axis = sizes_allowed(parts, sd)
    offsets, spread = parts.predict(np.full(3, sd))
    below = np.cumsum(weights) - 0.5 * weights
    low, high = np.interp((0.025, 0.975), below, sizes)
    found = []
    name, effect, unit = what
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
            NextPowerUp(
                name=parameter,
                effect=effect,
                unit=unit,
                value=value,
                mean=mean,
                sd=float(np.sqrt(by_axis[axis] @ var)),
                half=float(next_one.half_widths(np.ones((1, 1)), 0.95)[0]),
            )
        )
    between = Between(
        name=name,
        effect=effect,
        unit=unit,
        sd=sd,
        interval=(float(low), float(high)),
        offsets=offsets,
        offsets_sd=np.sqrt(np.maximum(np.diag(spread), 0.0)).reshape(-1, 3),
    )
    return between, tuple(found)
