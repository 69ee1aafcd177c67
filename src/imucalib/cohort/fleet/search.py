"""The search of a fleet: effects that exist in all devices, each with its own size; and what the
others say of a device that took no part in it.

Device d says of the sizes θ_d (typical sizes, without the base model) exp(a_dᵀθ - θᵀG_dθ/2). With

    θ_d ~ N(μ, τ² 1),   μ ~ N(0, γ² 1)

everything is closed: w = Σ (1 + τ²G)⁻¹ a and Λ = Σ (1 + τ²G)⁻¹ G over the devices give

    2 q = Σ τ² aᵀ(1 + τ²G)⁻¹a + wᵀ(Λ + γ⁻²)⁻¹w
    ln m = -ν/2 ln(1 - 2 q / ν) - Σ ln det(1 + τ²G) / 2 - ln det(1 + γ²Λ) / 2

with the factor of all noises, which the same data tell in ν degrees of freedom, integrated out
under Jeffreys' prior. The evidence is the mean of m over a grid of τ and γ: all the same, all
different, and between. What exists is a posterior over nothing and each of the effects, with the
prior odds of one device's search.

Choosing an effect on all devices and leaving one out of its size only would flatter the held-out
error: the device that is predicted would have had a vote. A search costs no fit, since every device
keeps its products with all candidates, so it is made anew for each group that is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.prior import Prior, joint_prior
from imucalib.estimators.power_ups import predict_next
from imucalib.posterior.odds import DEEPEST, FALSE_CLAIM, KNOWN, MISSING, OCCAM
from imucalib.posterior.search.gram import log_sum

#: Devices from which on their noise is compared.
_MODERATED = 3
#: Sizes of the scatter τ between devices and of the common size γ, in typical sizes.
_TAU = (0.0, 0.1, 0.3, 1.0, 3.0)
_GAMMA = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0)
#: Of the estimate of τ: its range in sds of one device's own size, values, and a flat prior of μ.
_ALLOWED, _SIZES, _WIDE = (0.03, 30.0), 40, 30.0
#: Groups of devices, at most, each of which the others predict.
GROUPS = 20
#: Devices beyond which a fifth of them says no less than a twentieth would.
_MANY, _OF_MANY = 60, 5
#: Effect -> its sizes, in typical sizes.
Priors = Mapping[str, Prior]


@dataclass(frozen=True)
class PooledDevice:
    """A device as the pooled search sees it.

    noise : size of its noise, in a unit that all devices share; dof : its degrees of freedom
    columns : effect -> (k,) where its parameters stand in `gram`
    gram : (m, m) products of all candidates' columns in units of the noise, at typical sizes, with
        the base model's parameters projected out; along : (m,) their products with the residual
    """

    name: str
    noise: float
    columns: Mapping[str, Index]
    gram: Array
    along: Array
    dof: float


@dataclass(frozen=True)
class PooledEffect:
    """An effect over a fleet. evidence : nats; probability : that it exists, and no other does
    devices : how many can show it"""

    effect: str
    evidence: float
    probability: float
    devices: int


@dataclass(frozen=True)
class Sizes:
    """What a fleet says of an effect's size, in typical sizes.

    common, common_covariance : (k,), (k, k) of μ; scatter : τ, root of its mean square
    """

    common: Array
    common_covariance: Array
    scatter: float

    @property
    def another(self) -> tuple[Array, Array]:
        """Mean (k,) and covariance (k, k) of the size in another device of the kind."""
        return self.common, self.common_covariance + self.scatter**2 * np.eye(self.common.size)


@dataclass(frozen=True)
class FleetEffect(PooledEffect):
    """An effect that a fleet shares. rivals : names that explain as much; nats : that each device's
    data gain by the others' sizes; able : devices that can show it; sizes : theirs"""

    rivals: tuple[str, ...]
    nats: Array
    able: tuple[str, ...]
    sizes: Sizes


@dataclass(frozen=True)
class Search:
    """What the devices of a fleet share.

    found : in order
    first : every effect before any was accepted
    refused : what stood out, and why it was not accepted
    by_others : of each device what the others say of the effects
    unseen : the same where the others have found them too, empty where that was not wanted
    following : what is said of the next device
    """

    found: tuple[FleetEffect, ...]
    first: tuple[PooledEffect, ...]
    refused: tuple[tuple[str, str], ...]
    by_others: Mapping[str, Priors] = field(default_factory=dict)
    unseen: Mapping[str, Priors] = field(default_factory=dict)
    following: Priors = field(default_factory=dict)


def search_fleet(
    own: Sequence[PooledDevice], say: Callable[[str], None], *, without: bool
) -> Search:
    """Search a fleet. own : with their own noise; without : whether also without each device"""
    devices = shrink_noise(own)
    found = search(devices)
    by_device: dict[str, dict[str, Prior]] = {device.name: {} for device in devices}
    for one in found.found:
        say(f"{one.effect}: in {len(one.able)} devices, {100.0 * one.probability:.0f} %")
        able, gram, along = products(devices, one.effect)
        for name, said in zip(able, by_others(gram, along), strict=True):
            by_device[name][one.effect] = joint_prior(*said)
    unseen = _drop_each(own) if found.found and without else {}
    following = _predict_another(devices, found)
    return replace(found, by_others=by_device, unseen=unseen, following=following)


def search(devices: Sequence[PooledDevice]) -> Search:
    """Accept the likeliest effect while silence would cost more than a false claim, and each device
    confirms it by what the others predict."""
    now, found, refused = tuple(devices), list[FleetEffect](), dict[str, str]()
    first: tuple[PooledEffect, ...] = ()
    while True:
        scores = pool_effects(now, missing=bool(found))
        first = first or scores
        there = sum(s.probability for s in scores)
        if FALSE_CLAIM * (1.0 - there) >= there or len(found) == DEEPEST:
            return Search(tuple(found), first, tuple(refused.items()))
        best = scores[0]
        able, gram, along = products(now, best.effect)
        nats = gain_from_others(gram, along)
        if nats.sum() <= 0.0:
            refused[best.effect] = f"the others foretell no device's: {nats.sum():+.1f} nats"
            now = tuple(replace(d, columns=_leave_out(d, best.effect)) for d in now)
            continue
        said = sizes(gram, along)
        rivals = tuple(s.effect for s in scores[1:] if s.evidence > best.evidence - OCCAM)
        found.append(FleetEffect(**vars(best), rivals=rivals, nats=nats, able=able, sizes=said))
        now = tuple(_drop(device, best.effect, said) for device in now)


def _drop(device: PooledDevice, effect: str, said: Sizes) -> PooledDevice:
    """A device without an effect, whose size is N(μ, τ²) before its data are seen."""
    if effect not in device.columns:
        return device
    k = device.columns[effect]
    across, own = device.gram[:, k], device.gram[np.ix_(k, k)]
    shrunk = said.scatter**2 * np.linalg.inv(np.eye(len(k)) + said.scatter**2 * own)
    away = device.along[k] - own @ said.common
    along = device.along - across @ (said.common + shrunk @ away)
    gram = device.gram - across @ shrunk @ across.T
    return replace(device, columns=_leave_out(device, effect), gram=gram, along=along)


def _leave_out(device: PooledDevice, effect: str) -> dict[str, Index]:
    """Where the parameters of all other effects stand."""
    return {name: at for name, at in device.columns.items() if name != effect}


def _drop_each(devices: Sequence[PooledDevice]) -> dict[str, Priors]:
    """Of each device the effects that the others find, with what these say of its sizes.

    devices : with their own noise, not drawn towards the fleet's, which the one left out would
    tell
    """
    groups = min(len(devices), GROUPS if len(devices) <= _MANY else _OF_MANY)
    every: dict[str, Priors] = {}
    for group in range(groups):
        rest = shrink_noise([d for k, d in enumerate(devices) if k % groups != group])
        said = _predict_another(rest, search(rest))
        for device in devices[group::groups]:
            every[device.name] = {n: one for n, one in said.items() if n in device.columns}
    return every


def _predict_another(devices: Sequence[PooledDevice], found: Search) -> dict[str, Prior]:
    """The sizes in another device of the kind of the effects that were found in these."""
    return {
        one.effect: joint_prior(*sizes(*products(devices, one.effect)[1:]).another)
        for one in found.found
    }


def shrink_noise(devices: Sequence[PooledDevice]) -> tuple[PooledDevice, ...]:
    """With each device's noise drawn towards the fleet's, as far as the devices agree: its log is
    that of the kind and a part of its own, told by as many degrees of freedom as it has."""
    from scipy.special import polygamma, psi

    if len(devices) < _MODERATED:
        return tuple(devices)
    half = np.array([d.dof / 2.0 for d in devices])
    logs = np.log([d.noise for d in devices]) - 0.5 * (psi(half) - np.log(half))
    known = logs[:, None], 0.5 * np.sqrt(polygamma(1, half))[:, None]
    better = np.exp(predict_next(*known).shrink(*known)[:, 0])
    every = zip(devices, [d.noise for d in devices] / better, strict=True)
    return tuple(replace(d, gram=d.gram * r**2, along=d.along * r**2) for d, r in every)


def products(devices: Sequence[PooledDevice], effect: str) -> tuple[tuple[str, ...], Array, Array]:
    """Devices that can show an effect, the products of its columns (devices, k, k), and those with
    the residual (devices, k)."""
    able = [(d, d.columns[effect]) for d in devices if effect in d.columns]
    gram = np.stack([d.gram[np.ix_(at, at)] for d, at in able])
    return tuple(d.name for d, _ in able), gram, np.stack([d.along[at] for d, at in able])


def pool_effects(devices: Sequence[PooledDevice], *, missing: bool) -> tuple[PooledEffect, ...]:
    """Every effect that two devices or more can show, best first.

    devices : at least two
    missing : whether the fleet is known to lack something already, which one more is beside
    """
    names = dict.fromkeys(name for device in devices for name in device.columns)
    dof, found = sum(device.dof for device in devices), list[tuple[str, float, int]]()
    for name in names:
        able, gram, along = products(devices, name)
        if len(able) > 1:
            found.append((name, evidence(gram, along, dof), len(able)))
    odds = np.log(KNOWN * (1.0 if missing else MISSING) / max(len(found), 1))
    logs = np.array([0.0, *(nats + odds for _, nats, _ in found)])
    weight = np.exp(logs - log_sum(logs))[1:]
    best = [
        PooledEffect(name, nats, p, count)
        for (name, nats, count), p in zip(found, weight.tolist(), strict=True)
    ]
    return tuple(sorted(best, key=lambda one: -one.evidence))


def evidence(gram: Array, along: Array, dof: float) -> float:
    """Nats of one effect. gram : (devices, k, k); along : (devices, k); dof : of the noise"""
    sums = {tau: _sums(gram, along, tau) for tau in _TAU}
    grid = [(tau, gamma) for tau in _TAU for gamma in _GAMMA if tau or gamma]
    every = np.array([_nats(*sums[tau], gamma, dof) for tau, gamma in grid])
    return float(log_sum(every) - np.log(every.size))


def sizes(gram: Array, along: Array) -> Sizes:
    """The sizes of an effect. gram : (devices, k, k); along : (devices, k)

    All are means over the scatters that the data allow, with the prior 1 / (τ + sd of a device's
    own size): few devices that look equal are not believed to be.
    """
    alone = float(np.sqrt(np.mean(1.0 / np.maximum(np.einsum("dii->di", gram), 1e-12))))
    tau = np.concatenate([[0.0], alone * np.geomspace(*_ALLOWED, _SIZES)])
    nats = np.array([_nats(*_sums(gram, along, float(t)), _WIDE, np.inf) for t in tau])
    weight = np.exp(nats - nats.max()) * np.gradient(tau) / (tau + alone)
    weight /= weight.sum()
    wide = np.eye(gram.shape[1]) / _WIDE**2
    pulled = [_sums(gram, along, float(t))[2:] for t in tau]
    each = np.array([np.linalg.inv(inside + wide) for _, inside in pulled])
    common = np.einsum("tij,tj->ti", each, np.array([w for w, _ in pulled]))
    mean = weight @ common
    away = common - mean
    spread = np.einsum("t,tij->ij", weight, each) + (weight * away.T) @ away
    return Sizes(mean, spread, float(np.sqrt(weight @ tau**2)))


def by_others(gram: Array, along: Array) -> list[tuple[Array, Array]]:
    """Mean (k,) and covariance (k, k) of each device's size, by the devices of other groups."""
    group = np.arange(len(gram)) % min(len(gram), GROUPS)
    every = [
        sizes(gram[group != k], along[group != k]).another for k in range(int(group.max()) + 1)
    ]
    return [every[k] for k in group]


def gain_from_others(gram: Array, along: Array) -> Array:
    """(devices,) nats that each device's data gain by what the others say of the effect."""
    every = zip(gram, along, by_others(gram, along), strict=True)
    return np.array([evidence_of_sizes(own, sums, *said) for own, sums, said in every])


def evidence_of_sizes(gram: Array, along: Array, mean: Array, spread: Array) -> float:
    """Nats of a device with sizes N(m, S): ln ∫ N(θ; m, S) exp(aᵀθ - θᵀGθ/2) dθ."""
    inner = np.linalg.inv(np.eye(len(gram)) + gram @ spread)
    away = along - gram @ mean
    gain = along @ mean - 0.5 * mean @ gram @ mean + 0.5 * away @ spread @ inner @ away
    return float(gain + 0.5 * np.linalg.slogdet(inner)[1])


def _sums(gram: Array, along: Array, tau: float) -> tuple[float, float, Array, Array]:
    """What sizes that differ explain, log det of what they cost, (k,) w and (k, k) Λ."""
    shrunk = np.linalg.inv(np.eye(gram.shape[1]) + tau**2 * gram)
    pulled = np.einsum("dij,dj->di", shrunk, along)
    inside = np.einsum("dij,djk->ik", shrunk, gram)
    return (
        float(tau**2 * np.sum(along * pulled)),
        -float(np.linalg.slogdet(shrunk)[1].sum()),
        pulled.sum(axis=0),
        0.5 * (inside + inside.T),
    )


def _nats(
    explained: float, log_det: float, w: Array, inside: Array, gamma: float, dof: float
) -> float:
    """Of `_sums` with a common size; an infinite dof: at a noise that is known."""
    grown = np.eye(len(inside)) + gamma**2 * inside
    square = explained + gamma**2 * float(w @ np.linalg.solve(grown, w))
    cost = 0.5 * (log_det + float(np.linalg.slogdet(grown)[1]))
    if np.isinf(dof):
        return 0.5 * square - cost
    return -0.5 * dof * float(np.log(max(1.0 - square / dof, 1e-12))) - cost
