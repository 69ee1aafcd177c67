"""What a fleet says of the next device of its kind, as a file and as a prior.

A device's parameter is normal about the fleet's mean with the scatter between devices, the doubt
about both included; the noise is log-normal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Noise, balance
from imucalib.core.effect import Context, Effect
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.prior import Prior, joint_prior
from imucalib.data import plain
from imucalib.effects import named
from imucalib.errors import UnreadableInput, UsageError
from imucalib.estimators.least_squares import fit
from imucalib.file_hash import sha256_of
from imucalib.question import Question
from imucalib.recording.yaml_text import dump, load
from imucalib.units import MG

SCHEMA, VERSION = "imucal/fleet", 1
#: Chance below which a device is said not to be of its fleet's kind.
UNLIKELY = 0.01
#: A noise that the fleet knows nothing of: anything within a factor of ten.
_UNKNOWN = float(np.log(10.0))
_ABOUT = 1e-3  # rad, of a setting that no device of the fleet had


@dataclass(frozen=True)
class PriorParameter:
    """A parameter of the next device: mean and sd, in `unit`."""

    name: str
    unit: str
    mean: float
    sd: float


@dataclass(frozen=True)
class PriorNoise:
    """ "reading" (m/s²) or a component of the noise (rad): the middle of what devices have, and the
    sd of its log."""

    name: str
    middle: float
    log_sd: float


@dataclass(frozen=True)
class Population:
    """devices : that were calibrated; reference : as of `lab`; effects : of the model, in order
    covariance : (p, p) of the parameters, in their units"""

    devices: int
    reference: str
    effects: tuple[str, ...]
    parameters: tuple[PriorParameter, ...]
    covariance: Array
    noise: tuple[PriorNoise, ...]
    sha256: str = ""

    def prior(self, model: Model, data: Observations, components: Sequence[str]) -> Prior:
        """Of a model's θ and of its noise; parameters that the fleet has not stay at their typical
        size. components : of the noise, as the data have them. Raises UsageError for units that
        this version has not."""
        parameters = model.parameters(data.context)
        place = {one.name: k for k, one in enumerate(self.parameters)}
        mean = model.start(data.context)
        covariance = np.diag([p.typical**2 for p in parameters])
        here = [k for k, p in enumerate(parameters) if p.name in place]
        there = [place[parameters[k].name] for k in here]
        for k, j in zip(here, there, strict=True):
            known = self.parameters[j]
            if known.unit != parameters[k].unit:
                raise UsageError(
                    f"the fleet has {known.name} in {known.unit}, this version in "
                    f"{parameters[k].unit}",
                    remedy="make the fleet's file again with this version",
                )
            mean[k] = known.mean
        covariance[np.ix_(here, here)] = self.covariance[np.ix_(there, there)]
        sigma = float(np.median(data.sigma))
        noise = [self._noise("reading", sigma, MG)]
        noise += [self._noise(component, 1.0, _ABOUT) for component in components]
        return replace(joint_prior(mean, covariance), noise=np.array(noise))

    def select_shared(self, context: Context) -> tuple[Effect, ...]:
        """The shared effects, whose sizes the fleet knows: their covariates must be known, and need
        not vary. Raises UsageError where one is not."""
        found = tuple(named(name) for name in self.effects)
        for effect in found:
            absent = [name.replace("_", " ") for name in effect.needs if name not in context]
            if absent:
                raise UsageError(
                    f"the fleet has {effect.name}, and no {', '.join(absent)} was recorded",
                    remedy="record it, or calibrate without --fleet",
                )
        return found

    def _noise(self, name: str, unit: float, usual: float) -> tuple[float, float]:
        """Mean and sd of the log of a size in a unit; usual : where the fleet has none."""
        known = {one.name: (one.middle, one.log_sd) for one in self.noise}
        middle, log_sd = known.get(name, (usual, _UNKNOWN))
        return float(np.log(middle / unit)), log_sd


def not_of_its_kind(chance: float, instead: str) -> tuple[Question, ...]:
    """What a user must decide where a device is far from its fleet. chance : that one of the kind
    is as far off, NaN where nothing was compared; instead : what to do"""
    if not chance < UNLIKELY:
        return ()
    far = f"one of the kind is as far off with a chance of {max(chance, 1e-12):.1g}"
    return (Question(f"not of its fleet's kind: {far}", (), instead),)


def of_a_kind(kind: Population, model: Model, data: Observations) -> Fit:
    """One of a kind: as few rows as there are, beside what its fleet says."""
    start = model.start(data.context)
    names = balance(model, start, data.reference.start(data.reading), data).component
    prior = kind.prior(model, data, names)
    assert prior.noise is not None
    factor, *sds = np.exp(prior.noise[:, 0]).tolist()
    return fit(model, data, start=prior.mean, begin=Noise(factor, names, tuple(sds)), prior=prior)


def to_yaml(population: Population) -> str:
    """The file's text."""
    content = {**plain(asdict(population))}
    del content["sha256"]
    return dump({"schema": SCHEMA, "version": VERSION, **content})


def read(path: Path) -> Population:
    """Raises UnreadableInput for what is no such file."""
    if not path.is_file():
        raise UnreadableInput("no such file", where=str(path))
    content: Any = load(path)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise UnreadableInput(
            "not what a fleet says of its kind",
            where=str(path),
            remedy="give the fleet.yaml that `imucal fleet TABLE... -o FOLDER` writes",
        )
    try:
        parameters = tuple(PriorParameter(**block) for block in content["parameters"])
        size = len(parameters)
        return Population(
            devices=int(content["devices"]),
            reference=str(content["reference"]),
            effects=tuple(content["effects"]),
            parameters=parameters,
            covariance=np.array(content["covariance"], float).reshape(size, size),
            noise=tuple(PriorNoise(**block) for block in content["noise"]),
            sha256=sha256_of(path),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise UnreadableInput(f"the file is incomplete: {error!r}", where=str(path)) from None
