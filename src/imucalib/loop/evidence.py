"""Evidence for what a model lacks: a score test of many candidates at once, without a refit.

Each candidate is a block of columns with a Gaussian prior of its physical size, times a factor τ:

    V → V + τ² G Gᵀ,   evidence = max over τ and noise of log p(data | with) - log p(data | without)

by restricted likelihood, with the noise factor profiled in closed form and the settings' variance
components profiled on a grid: a candidate that explains what looked like setting errors gets its
due. The chance that the best of all candidates does as well on data that lack nothing is found
by simulating such data through the same computation (Westfall and Young 1993, minimum p).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.thresholds import ABSORBED

Kind = Literal["effect", "probe", "noise", "record"]


@dataclass(frozen=True)
class Candidate:
    """One block. columns : (N, m) in the balance's units, scaled by the typical size.

    family : the scan that it is one value of, or empty; curve : of a probe, what could correct it
    (a value of the family "curve", without the number of terms); unfounded : as its family; chance
    is counted among such by themselves, and others pay nothing for them
    """

    name: str
    kind: Kind
    columns: Array
    driver: str = ""
    family: str = ""
    curve: str = ""
    unfounded: bool = False


@dataclass(frozen=True)
class Score:
    """What the data say of one candidate.

    evidence : nats in favour; p : family-wise, for the best of all candidates, from `draws`
        simulated data sets (no smaller than 1 / (draws + 1))
    left : share of the candidate's columns that the fitted parameters do not absorb (0..1)
    strength : λ, the length of its projected columns at typical size, in noise units: 4.7 gives
        an 80 % chance of detection
    share : of the weighted residual power that it explains, adjusted for its freedom (0..1)
    size : m/s², rms of the whole block on an observation: what an absorbed effect of typical size
        does to the answer without a trace in the residual
    bar : evidence that the best of all candidates exceeds by chance in a share alpha of data sets
        that lack nothing (infinite without draws)
    """

    candidate: Candidate
    evidence: float
    p: float
    draws: int
    left: float
    strength: float
    share: float
    size: float = 0.0
    bar: float = np.inf

    @property
    def name(self) -> str:
        return self.candidate.name

    @property
    def absorbed(self) -> bool:
        return self.left < ABSORBED
