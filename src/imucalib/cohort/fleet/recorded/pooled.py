"""Recordings as devices of a pooled search, and their calibrations with what it says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.cohort.fleet.device import Device
from imucalib.cohort.fleet.pooled import gained
from imucalib.cohort.fleet.recorded.calibrated import Calibrated, Value
from imucalib.core.context import Context
from imucalib.core.prior import Prior
from imucalib.effects import named
from imucalib.loop.sums import Sums, columns_of

#: sd of an effect that a recording has by itself, in typical sizes: its own data decide.
_OWN = 10.0


def device_of(name: str, recordings: Sequence[Sums], wanted: Sequence[str]) -> Device:
    """A device whose recordings share the sizes of effects, each with a base model of its own."""
    names = [e for e in wanted if any(e in one.blocks for one in recordings)]
    width = {e: next(one.blocks[e].size for one in recordings if e in one.blocks) for e in names}
    ends = np.cumsum([0, *width.values()])
    columns: dict[str, Index] = {
        e: np.arange(a, b) for e, a, b in zip(names, ends, ends[1:], strict=False)
    }
    gram, along = np.zeros((ends[-1], ends[-1])), np.zeros(ends[-1])
    for one in recordings:
        has = [e for e in names if e in one.blocks]
        own, at = columns_of(one.blocks, has), columns_of(columns, has)
        gram[np.ix_(at, at)] += one.gram[np.ix_(own, own)]
        along[at] += one.along[own]
    dof = np.array([one.dof for one in recordings])
    square = np.array([one.noise**2 for one in recordings])
    noise = float(np.sqrt(dof @ square / dof.sum()))
    return Device(name, noise, columns, gram, along, float(dof.sum()))


@dataclass(frozen=True)
class Foretold:
    """What a device's data say of effects at the sizes that others say. error : mg, its noise then;
    nats : gained by its data"""

    error: float
    nats: float


def foretold(device: Device, said: Mapping[str, Prior]) -> Foretold:
    """What effects of a given size explain is known exactly: |y - Xθ|² = |y|² - 2 aᵀθ + θᵀGθ."""
    from scipy.linalg import block_diag

    at = columns_of(device.columns, list(said))
    size = np.concatenate([np.zeros(0), *(one.mean for one in said.values())])
    gram, along = device.gram[np.ix_(at, at)], device.along[at]
    less = (2.0 * along @ size - size @ gram @ size) / device.dof
    error = device.noise * float(np.sqrt(max(1.0 - less, 0.0)))
    spread = block_diag(*(one.covariance for one in said.values())) if said else np.zeros((0, 0))
    return Foretold(error, gained(gram, along, size, np.asarray(spread)))


@dataclass(frozen=True)
class Sizes:
    """Of a device's effects in typical sizes, by its own data and what the others say: names in the
    order of mean (k,) and covariance (k, k)."""

    names: tuple[str, ...]
    mean: Array
    covariance: Array

    def of(self, sums: Sums) -> Sizes:
        """Of those that a recording can show."""
        able = tuple(name for name in self.names if name in sums.blocks)
        width = [named(name).parameters(Context(1)) for name in self.names]
        of = np.repeat(self.names, [len(one) for one in width])
        at = np.flatnonzero(np.isin(of, able))
        return Sizes(able, self.mean[at], self.covariance[np.ix_(at, at)])


def sizes_of(device: Device, said: Mapping[str, Prior], own: Sequence[str]) -> Sizes:
    """said : by the others; own : effects of this device alone, of which nobody says anything"""
    names = (*said, *(e for e in own if e not in said))
    at = columns_of(device.columns, names)
    precision, towards, start = device.gram[np.ix_(at, at)], device.along[at], 0
    for name in names:
        part = slice(start, start + device.columns[name].size)
        start = part.stop
        if name in said:
            prior = said[name].root.T @ said[name].root
            precision[part, part] += prior
            towards[part] += prior @ said[name].mean
        else:
            precision[part, part] += np.eye(part.stop - part.start) / _OWN**2
    covariance = np.asarray(np.linalg.inv(precision), np.float64)
    return Sizes(names, covariance @ towards, covariance)


@dataclass(frozen=True)
class Combined:
    """A recording's parameters with its device's effects: values in their units, covariance."""

    effects: tuple[str, ...]
    values: tuple[Value, ...]
    covariance: Array


def combined(one: Calibrated, sizes: Sizes) -> Combined:
    """One Gauss-Newton step from the base model: second order is the base's share of an effect."""
    assert one.sums is not None
    able = sizes.of(one.sums)
    theta, covariance = one.sums.together(able.names, able.mean, able.covariance)
    new = [(name, p) for name in able.names for p in named(name).parameters(Context(1))]
    scale = np.concatenate([np.ones(one.sums.base.theta.size), [p.typical for _, p in new]])
    theta, covariance = theta * scale, covariance * np.outer(scale, scale)
    units = {v.name: (v.effect, v.unit) for v in one.values}
    units |= {p.name: (name, p.unit) for name, p in new}
    names = (*one.sums.base.parameters, *(p.name for _, p in new))
    values = tuple(
        Value(name, units[name][0], float(v), float(s), units[name][1])
        for name, v, s in zip(names, theta, np.sqrt(np.diag(covariance)), strict=True)
    )
    return Combined(able.names, values, covariance)


def own_effects(one: Calibrated) -> tuple[str, ...]:
    """Effects that the recording's own search has put beside the base model."""
    assert one.sums is not None
    base = set(one.sums.base.parameters)
    return tuple(dict.fromkeys(v.effect for v in one.values if v.name not in base))


def with_effects(own: Calibration, made: Combined) -> Calibration:
    """The calibration with the fleet's effects in the place of what it had beside its base; its
    errors stay those of the recording alone, and it says so."""
    stage = {p.effect: p.stage for p in own.parameters}
    stage |= {name: named(name).stage for name in made.effects}
    stored = tuple(
        StoredParameter(v.name, v.effect, stage[v.effect], v.value, v.sd, v.unit)
        for v in made.values
    )
    said = {"effects": list(made.effects), "errors": "of the recording calibrated alone"}
    facts = {**own.facts, "fleet": said}
    return replace(own, parameters=stored, covariance=made.covariance, facts=facts, sha256="")
