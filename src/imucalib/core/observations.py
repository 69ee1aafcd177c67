"""Observations: averaged still readings with their reference, context and held-out groups."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.context import Context
from imucalib.core.references import Reference


@dataclass(frozen=True)
class Observations:
    """What a calibrator fits.

    reading : (n, K, 3) m/s², as the sensor gave it
    sigma : (n, K, 3) relative noise of each component; the common factor is estimated
    reference : what is known of the truth
    context : covariates for the effects that need them
    group : (n,) held-out key: observations of one group leave the fit together
    label : (n,) name of each observation in reports ("row 10")
    """

    reading: Array
    sigma: Array
    reference: Reference
    context: Context
    group: Index
    label: tuple[str, ...]

    @property
    def n(self) -> int:
        return len(self.reading)

    def take(self, rows: Index) -> Observations:
        """A subset; settings that no remaining row used disappear with their rows."""
        return Observations(
            self.reading[rows],
            self.sigma[rows],
            self.reference.take(rows),
            self.context.take(rows),
            self.group[rows],
            tuple(self.label[r] for r in rows),
        )

    def without(self, rows: Index) -> Observations:
        """All observations except `rows`."""
        return self.take(np.setdiff1d(np.arange(self.n), rows))

    def with_reading(self, reading: Array) -> Observations:
        """The same observations with other readings (simulation, corrected records)."""
        return replace(self, reading=reading)
