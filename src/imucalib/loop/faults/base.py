"""The sheet as it stands, beside a set of components: what any change of its readings does.

At each noise the misfit is yᵀPy, P = V⁻¹ without what the model takes; for readings that differ by
D it is exactly

    RSS' = RSS + 2 Dᵀg + DᵀPD,  g = Py
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.loop.faults.sheet import Sheet
from imucalib.loop.posterior.explored import Explored
from imucalib.loop.posterior.gram import Grams, log_sum
from imucalib.loop.posterior.odds import SLIPS, WRONG
from imucalib.units import MG

#: Noises on which many hypotheses are looked at first.
_FEW = 3


@dataclass(frozen=True)
class Base:
    """P : (G, 3n, 3n) at G noises; g : P y (G, 3n); rss : (G,); grams : where they come from
    response : (3, 3) what the sensor makes of a force, mg for mg"""

    sheet: Sheet
    P: Array
    g: Array
    rss: Array
    grams: Grams
    dof: float
    response: Array

    def each(self, rss: Array) -> Array:
        """Log likelihood and prior at every noise for sums of squares (G, ...)."""
        weight = self.grams.log_weight.reshape((-1,) + (1,) * (rss.ndim - 1))
        return np.asarray(weight + self.grams.log_noise(np.maximum(rss, 1e-9), self.dof))

    def best(self, rss: Array) -> Array:
        """(...) log likelihood over all noises."""
        return log_sum(self.each(rss))

    def gain(self, rss: Array, count: float) -> Array:
        """(...) nats beyond the sheet as it stands, less what one slip of `count` in its class pays
        for being one of them."""
        return np.asarray(self.best(rss) - float(self.best(self.rss)) + prior_of(count))

    @property
    def few(self) -> Index:
        """The likeliest noises."""
        return np.argsort(-self.each(self.rss))[:_FEW]

    def at(self, noises: Index) -> Base:
        """The same at some of the noises only."""
        return replace(
            self,
            P=self.P[noises],
            g=self.g[noises],
            rss=self.rss[noises],
            grams=self.grams.of(noises),
        )


def prior_of(count: float) -> float:
    """Log prior odds of one slip among `count` of its class."""
    return float(np.log(WRONG / SLIPS / count))


def base_of(found: Explored, sheet: Sheet, one: Grams) -> Base:
    """The base of a sheet of known angles; one : Grams beside the base model and a set, the
    readings' own numbers before y."""
    unit = found.base.at.unit / MG
    single = np.arange(-1 - unit.size, -1) + one.along.shape[1]
    rows = one.rows(single)
    return Base(
        sheet=sheet,
        P=rows[:, :, single] / np.outer(unit, unit),
        g=rows[:, :, -1] / unit,
        rss=one.power,
        grams=one,
        dof=found.posterior.dof,
        response=_response(found),
    )


def _response(found: Explored) -> Array:
    """(3, 3) slope of a reading by the force on the tool, about no force."""
    fit = found.base
    one = fit.observations.context.take(np.zeros(1, np.intp))
    return np.asarray(fit.model.predict(fit.theta, np.zeros((1, 1, 3)), one).d_truth[0, 0])
