"""Hamiltonian Monte Carlo with Gaussian splitting, all chains in one batch.

In the frame where the target is nearly a unit Gaussian, the Gaussian part of the motion is solved
exactly by a rotation and only the rest kicks the momentum (Shahbaba, Lan, Johnson, Neal: Split
Hamiltonian Monte Carlo, Statistics and Computing 24 (2014)). A quarter turn in one or two steps
gives nearly independent draws for one or two gradients each.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.errors import NotConverged, UnreadableInput
from imucalib.estimators.markov.convergence import Convergence, convergence

#: (chains, d) in the frame -> log density (chains,) and its gradient (chains, d)
Target = Callable[[Array], tuple[Array, Array]]
#: Chains at a moment: z (c, d), log density (c,), gradient (c, d).
State = tuple[Array, Array, Array]
#: Steps of a trajectory with the acceptance wished for, of all chains and of the worst. One
#: step costs half of two and may be refused more often, but must not hold a chain in the tails.
_STEPS = ((1, 0.85, 0.6), (2, 0.9, 0.0), (3, 0.9, 0.0), (4, 0.9, 0.0), (6, 0.0, 0.0))
_TRIAL = 25  # draws on which the number of steps is chosen


@dataclass(frozen=True)
class Stop:
    """When the chains are long enough: blocks of `block` draws until R-hat and ESS are met."""

    rhat: float = 1.01
    ess: float = 400.0
    block: int = 50
    most: int = 4000


@dataclass(frozen=True)
class Chains:
    """draws (chains, n, d) in the frame; accepted: mean acceptance."""

    draws: Array
    accepted: float
    convergence: Convergence


def sample(
    target: Target,
    d: int,
    rng: np.random.Generator,
    *,
    chains: int = 4,
    stop: Stop | None = None,
    checkpoint: Path | None = None,
    seen: Callable[[Array], Array] = lambda draws: draws,
) -> Chains:
    """Draw until the diagnostics of `seen(draws)`, what will be reported, are met.

    Raises NotConverged with them when `stop.most` is not enough. With a checkpoint, every block is
    kept there, and a run that was cut short goes on from it with the same result.
    """
    rule = stop or Stop()
    run = _resumed(checkpoint, d, chains, rng) or _begin(target, d, rng, chains)
    while True:
        count = run.draws.shape[1]
        if count >= 2 * rule.block:
            found = convergence(seen(run.draws))
            if found.reached(rule.rhat, rule.ess):
                return Chains(run.draws, run.accepted, found)
            if count >= rule.most:
                raise NotConverged(
                    f"the chains do not agree after {count} draws each: {found.sentence}",
                    remedy="too little rotation, or samples that contradict each other: record a "
                    "more varied motion, or use more samples",
                )
        state, draws, accepted = _block(target, run.state, run.steps, rule.block, rng)
        mean = run.accepted * count + float(accepted.mean()) * rule.block
        mean /= count + rule.block
        run = replace(run, state=state, draws=np.concatenate([run.draws, draws], 1), accepted=mean)
        if checkpoint:
            _keep(checkpoint, run, rng)


@dataclass(frozen=True)
class _Run:
    state: State
    draws: Array
    steps: int
    accepted: float


def _begin(target: Target, d: int, rng: np.random.Generator, chains: int) -> _Run:
    """Overdispersed starts, and the number of steps by the acceptance of a first trial."""
    z = 1.3 * rng.standard_normal((chains, d))
    state = z, *target(z)
    for _ in range(20):
        bad = ~np.isfinite(state[1])
        if not bad.any():
            break
        z = np.where(bad[:, None], 0.5 * z, z)
        state = z, *target(z)
    for steps, wished, least in _STEPS:
        state, _, accepted = _block(target, state, steps, _TRIAL, rng)
        if accepted.mean() >= wished and accepted.min() >= least:
            break
    return _Run(state, np.empty((chains, 0, d)), steps, 0.0)


def _block(
    target: Target, state: State, steps: int, count: int, rng: np.random.Generator
) -> tuple[State, Array, Array]:
    """The chains `count` draws on, those draws, and the share each chain accepted."""
    chains, d = state[0].shape
    draws, accepted = np.empty((chains, count, d)), np.zeros(chains)
    for k in range(count):
        state, moved = step(target, state, steps, rng)
        draws[:, k] = state[0]
        accepted += moved
    return state, draws, accepted / count


def step(target: Target, state: State, steps: int, rng: np.random.Generator) -> tuple[State, Flags]:
    """One trajectory of a quarter turn for every chain, and which accepted."""
    z, value, gradient = state
    momentum = rng.standard_normal(z.shape)
    angle = 0.5 * np.pi / steps
    c, s = np.cos(angle), np.sin(angle)
    before = value - 0.5 * np.sum(momentum * momentum, axis=1)
    for _ in range(steps):
        momentum = momentum + 0.5 * angle * (gradient + z)
        z, momentum = c * z + s * momentum, c * momentum - s * z
        value, gradient = target(z)
        momentum = momentum + 0.5 * angle * (gradient + z)
    after = value - 0.5 * np.sum(momentum * momentum, axis=1)
    with np.errstate(invalid="ignore"):
        accepted = np.log(rng.random(len(z))) < after - before
    accepted &= np.isfinite(value) & np.isfinite(gradient).all(axis=1)
    keep = accepted[:, None]
    z, gradient = np.where(keep, z, state[0]), np.where(keep, gradient, state[2])
    return (z, np.where(accepted, value, state[1]), gradient), np.asarray(accepted)


def _keep(path: Path, run: _Run, rng: np.random.Generator) -> None:
    from imucalib.atomic_file import replaced_atomically

    with replaced_atomically(path) as temporary, open(temporary, "wb") as file:
        np.savez(
            file,
            z=run.state[0],
            value=run.state[1],
            gradient=run.state[2],
            draws=run.draws,
            steps=run.steps,
            accepted=run.accepted,
            generator=np.array(json.dumps(rng.bit_generator.state)),
        )


def _resumed(path: Path | None, d: int, chains: int, rng: np.random.Generator) -> _Run | None:
    """The run of a checkpoint, with `rng` set to where it was; None when there is none."""
    if path is None or not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as kept:
            z, steps, accepted = kept["z"], int(kept["steps"]), float(kept["accepted"])
            run = _Run((z, kept["value"], kept["gradient"]), kept["draws"], steps, accepted)
            rng.bit_generator.state = json.loads(str(kept["generator"]))
    except (OSError, ValueError, KeyError) as error:
        raise UnreadableInput(
            f"not a checkpoint: {error}", where=str(path), remedy="remove it to begin anew"
        ) from None
    if z.shape != (chains, d):
        raise UnreadableInput(
            f"the checkpoint holds {z.shape[0]} chains of {z.shape[1]} unknowns, "
            f"not {chains} of {d}",
            where=str(path),
            remedy="remove it to begin anew",
        )
    return run
