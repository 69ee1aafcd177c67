"""What any test of a fleet could find at best, beside what ours finds, on the devices of fleet.py.

    python benchmarks/lab/fleet_bound.py [--devices 5] [--strength 1.8] [--fleets 4000]

By Neyman and Pearson no test is more often right than the likelihood ratio of what is known of the
truth. Known noise, and squares alike within a third between axes and devices, with

    sizes     the common size of each axis and its scatter known, one effect: nothing left to search
    scatter   the scatter known, the common size of each axis anything, one effect
    catalogue the same, and the effect any of the catalogue: the mean ratio over its effects

each at 4 % of fleets that lack nothing. `ours` is the test of `imucal fleet` on the same products,
with the noise known, and with it estimated from the residuals beside the base model: of each device
(15 degrees of freedom), and of all, as alike as these are.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from fleet import NOISE, REQUEST, device

from imucalib.calibrators.lab.files import LabFiles, calibrate_files
from imucalib.cohort.fleet.pooled import PooledDevice, device_of, outstanding
from imucalib.loop.candidates import effects_to_search

ALPHA, TRUTH, DOF = 0.04, "quadratic", 15.0


def devices_of(count: int, folder: Path) -> list[PooledDevice]:
    """Products of all candidates; the data themselves are drawn anew."""
    rng = np.random.default_rng(1)
    alone = replace(REQUEST, loop=False)
    effects = effects_to_search((), (), {}).effects
    found = []
    for k in range(count):
        path = folder / f"{k}.csv"
        device(rng, 0.0, path)
        run = calibrate_files(LabFiles(path), alone, lambda _: None)
        one = device_of(str(k), run.result.final, effects)
        # In units of the true noise, not of that of one draw.
        own = (run.result.final.noise.factor * 9.80665e-3 / (NOISE * 9.80665e-3)) ** 2
        found.append(replace(one, gram=one.gram * own, along=one.along * own))
    return found


def drawn(one: PooledDevice, strength: float, fleets: int, rng: np.random.Generator) -> np.ndarray:
    """(m, fleets) products of data with squares alike within a third, of λ `strength`."""
    values, vectors = np.linalg.eigh(one.gram)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    data = root @ rng.standard_normal((len(values), fleets))
    if strength > 0.0:
        at = one.columns[TRUTH]
        size = 1.0 + 0.3 * rng.standard_normal((3, fleets))
        own = one.gram[np.ix_(at, at)]
        size *= strength / np.sqrt(np.einsum("kn,kl,ln->n", size, own, size))
        data = data + one.gram[:, at] @ size
    return data


def square(one: PooledDevice, data: np.ndarray) -> np.ndarray:
    """(fleets,) variance of a device's noise by its residual, the effect unknown: 24 rests leave 15
    numbers, all of which the candidates' columns span."""
    return np.einsum("in,ij,jn->n", data, np.linalg.pinv(one.gram, rcond=1e-9), data) / DOF


def ratio(gram: np.ndarray, along: np.ndarray, tau: float, gamma: float) -> np.ndarray:
    """(fleets,) ln of the likelihood ratio: sizes N(μ, τ²) with μ ~ N(0, γ²)."""
    eye = np.eye(gram.shape[1])
    shrunk = np.linalg.inv(eye + tau**2 * gram)
    near = np.einsum("dij,djn->din", shrunk, along)
    nats = 0.5 * tau**2 * np.einsum("din,din->n", along, near)
    nats = nats + 0.5 * np.linalg.slogdet(shrunk)[1].sum()
    inside = np.einsum("dij,djk->ik", shrunk, gram)
    grown = eye + gamma**2 * 0.5 * (inside + inside.T)
    w = near.sum(axis=0)
    nats = nats + 0.5 * gamma**2 * np.einsum("in,in->n", w, np.linalg.solve(grown, w))
    return nats - 0.5 * np.linalg.slogdet(grown)[1]


def known_sizes(gram, along, mean: np.ndarray, tau: float) -> np.ndarray:
    """(fleets,) the same with μ known: (k,)."""
    eye, nats = np.eye(gram.shape[1]), np.zeros(along.shape[2])
    for own, data in zip(gram, along, strict=True):
        inner = np.linalg.inv(eye + tau**2 * own)
        away = data - (own @ mean)[:, None]
        nats = nats + mean @ data - 0.5 * mean @ own @ mean
        nats = nats + 0.5 * tau**2 * np.einsum("kn,kl,ln->n", away, inner, away)
        nats = nats + 0.5 * np.linalg.slogdet(inner)[1]
    return nats


def power(null: np.ndarray, found: np.ndarray) -> float:
    return float(np.mean(found > np.quantile(null, 1.0 - ALPHA)))


def main() -> None:
    """Power of every test at 4 %, in percent."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=5)
    parser.add_argument("--strength", type=float, default=1.8)
    parser.add_argument("--fleets", type=int, default=4000)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        devices = devices_of(asked.devices, Path(name))
    rng = np.random.default_rng(2)
    names = [n for n in devices[0].columns if all(n in d.columns for d in devices)]
    worlds = [[drawn(d, s, asked.fleets, rng) for d in devices] for s in (0.0, asked.strength)]
    squares = [[square(d, w) for d, w in zip(devices, world, strict=True)] for world in worlds]
    loose = [
        [w / np.sqrt(s) for w, s in zip(world, own, strict=True)]
        for world, own in zip(worlds, squares, strict=True)
    ]
    together = [
        [w / np.sqrt(np.mean(own, axis=0)) for w in world]
        for world, own in zip(worlds, squares, strict=True)
    ]
    unit = np.mean([asked.strength / np.sqrt(d.gram[np.ix_(*[d.columns[TRUTH]] * 2)].sum())
                    for d in devices])  # fmt: skip

    def of(world, name):
        gram = np.stack([d.gram[np.ix_(d.columns[name], d.columns[name])] for d in devices])
        return gram, np.stack([w[d.columns[name]] for d, w in zip(devices, world, strict=True)])

    tau = 0.3 * unit
    sizes = [known_sizes(*of(w, TRUTH), np.full(3, unit), tau) for w in worlds]
    scatter = [ratio(*of(w, TRUTH), tau, 2.0 * unit) for w in worlds]
    every = [np.stack([ratio(*of(w, n), tau, 2.0 * unit) for n in names]) for w in worlds]
    mean = [np.logaddexp.reduce(e, axis=0) for e in every]
    ours, estimated, pooled = (
        [np.max([outstanding(*of(w, n)) for n in names], axis=0) for w in both]
        for both in (worlds, loose, together)
    )
    print(f"{asked.devices} devices, λ {asked.strength:g} each, {len(names)} effects: {names}")
    for name, (null, found) in {
        "sizes": sizes, "scatter": scatter, "catalogue": mean, "ours, noise known": ours,
        "ours, noise of each device": estimated, "ours, noise of all devices": pooled,
    }.items():  # fmt: skip
        print(f"| {name} | {100.0 * power(null, found):.0f} |")


if __name__ == "__main__":
    main()
