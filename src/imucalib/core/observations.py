"""Observations: averaged still readings with their reference, context and held-out groups.

What changes from one power-up to the next: a bias, and where readings have known directions the
mounting too, as random errors that all readings of a session share.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import Context, cross_matrix
from imucalib.core.references import Reference

BIAS, MOUNTING = "session bias", "session mounting"


def add_sessions(data: Observations, session: Index) -> Observations:
    """The observations with the errors that sessions share as variance components (m/s² and rad).

    session : (n,) number of each observation's session, from 0; of one alone nothing can be told
    """
    one = np.eye(int(session.max()) + 1)[session]
    if one.shape[1] < 2:
        return data
    found = [SharedNoise(BIAS, one, math.inf)]
    if data.reference.directed:
        turned = -cross_matrix(data.reading[:, 0])  # φ × reading of a small turn φ
        found.append(SharedNoise(MOUNTING, one, math.inf, basis=turned))
    return replace(data, shared=(*found, *data.shared))


def session_of(data: Observations) -> Index | None:
    """(n,) number of each observation's session, or None where there is only one."""
    of = data.of_sessions
    return np.argmax(of[0].factor, axis=1).astype(np.intp) if of else None


@dataclass(frozen=True)
class SharedNoise:
    """A random error of each reading that observations share, of unknown size.

    name : of its variance component; factor : (n, q), factor factorᵀ is its correlation
    memory : observations after which it forgets; infinite where it is that of whole sessions
    basis : (n, 3, m) what its m numbers do to a reading; None for a bias of each axis
    """

    name: str
    factor: Array
    memory: float
    basis: Array | None = None

    @property
    def walks(self) -> bool:
        """Whether it forgets in the order of recording."""
        return math.isfinite(self.memory)

    def take(self, rows: Index) -> SharedNoise:
        basis = None if self.basis is None else self.basis[rows]
        return replace(self, factor=self.factor[rows], basis=basis)


@dataclass(frozen=True)
class NoisePrior:
    """What is known of a bench before its readings: few of them split their noise by chance.

    spread : standard deviation of the log of the readings' factor, about one times `sigma`
    setting : rad, the median of each setting's standard deviation, half-Cauchy (Gelman 2006)
    parameters : name -> standard deviation of a parameter about its start, in its unit; it is used
        where the noise is integrated out, as it is with few rows
    """

    spread: float
    setting: float
    parameters: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Observations:
    """What a calibrator fits.

    reading : (n, K, 3) m/s², as the sensor gave it
    sigma : (n, K, 3) relative noise of each component; the common factor is estimated
    reference : what is known of the truth
    context : covariates for the effects that need them
    group : (n,) held-out key: observations of one group leave the fit together
    label : (n,) name of each observation in reports ("row 10")
    shared : noise beyond sigma that observations have in common, each with a size to estimate
    noise_prior : of the noise, or None where the readings alone speak
    """

    reading: Array
    sigma: Array
    reference: Reference
    context: Context
    group: Index
    label: tuple[str, ...]
    shared: tuple[SharedNoise, ...] = ()
    noise_prior: NoisePrior | None = None

    @property
    def n(self) -> int:
        return len(self.reading)

    @property
    def walk(self) -> SharedNoise | None:
        """The noise that neighbours share, which stands last, if there is any."""
        return self.shared[-1] if self.shared and self.shared[-1].walks else None

    @property
    def of_sessions(self) -> tuple[SharedNoise, ...]:
        """What whole sessions share."""
        return tuple(noise for noise in self.shared if math.isinf(noise.memory))

    def take(self, rows: Index) -> Observations:
        """A subset; settings that no remaining row used disappear with their rows."""
        return replace(
            self,
            reading=self.reading[rows],
            sigma=self.sigma[rows],
            reference=self.reference.take(rows),
            context=self.context.take(rows),
            group=self.group[rows],
            label=tuple(self.label[r] for r in rows),
            shared=tuple(noise.take(rows) for noise in self.shared),
        )

    def without(self, rows: Index) -> Observations:
        """All observations except `rows`."""
        return self.take(np.setdiff1d(np.arange(self.n), rows))

    def set_reading(self, reading: Array) -> Observations:
        """The same observations with other readings (simulation, corrected records)."""
        return replace(self, reading=reading)
