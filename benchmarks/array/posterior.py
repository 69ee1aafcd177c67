"""The array posterior on simulated data: accuracy, coverage, refusals, CPU seconds.

python benchmarks/array/posterior.py accuracy | coverage [SETS] | refusals
"""

from __future__ import annotations

import sys
import time

import numpy as np
from samples import MotionPlan, simulated_samples

from imucalib.calibrators.array.board import read_board
from imucalib.errors import ImucalError
from imucalib.estimators.array.problem import ArrayPrior
from imucalib.estimators.array.sampler import sample_positions, scale_of
from imucalib.estimators.markov.hmc import Stop

DRAWN = read_board("mimu4444").drawn
SETTINGS = {
    "paper": MotionPlan(),
    "0.79 m/s²": MotionPlan(sigma=0.79),
    "0.79, 500 deg/s": MotionPlan(sigma=0.79, rate=500.0, spin=8000.0),
    "0.79, 300 deg/s": MotionPlan(sigma=0.79, rate=300.0, spin=3000.0),
}


def one(plan: MotionPlan, seed: int, *, jitter: float | None = None, stop: Stop | None = None):
    """A fresh array, motion and data; the sampled positions, the truth and the CPU seconds."""
    rng = np.random.default_rng(seed)
    sd = 3e-3 if jitter is None else jitter
    offset = rng.normal(size=DRAWN.shape) * sd
    offset[0] = 0.0
    # Prior sets (jitter None): truth drawn about the drawing. Paper: a prior mean 0.1 mm off.
    true = DRAWN + offset if jitter is None else DRAWN
    nominal = DRAWN if jitter is None else DRAWN + offset
    data = simulated_samples(true, plan, rng)
    start = time.process_time()
    found = sample_positions(data, ArrayPrior(nominal), rng, stop=stop)
    return found, true, time.process_time() - start


def accuracy() -> None:
    print("| setting | T | median sd x/y/z, mm | rms error / rms sd | R-hat | ESS | CPU s |")
    print("|---|---|---|---|---|---|---|")
    for name in ("paper", "0.79 m/s²"):
        for samples in (5, 50, 500, 5000) if name == "paper" else (5, 50, 500):
            sds, errors, rhat, ess, cpu = [], [], [], [], []
            for seed in range(3 if samples > 500 else 8):
                plan = MotionPlan(samples=samples, sigma=SETTINGS[name].sigma)
                found, true, seconds = one(plan, 100 + seed, jitter=1e-4)
                sds.append(found.sd[1:])
                errors.append((found.mean - true)[1:])
                rhat.append(found.convergence.rhat.max())
                ess.append(min(found.convergence.bulk.min(), found.convergence.tail.min()))
                cpu.append(seconds)
            sd, error = np.array(sds), np.array(errors)
            shown = "/".join(f"{1e3 * v:.4f}" for v in np.median(sd, axis=(0, 1)))
            ratio = np.sqrt(np.mean(error**2) / np.mean(sd**2))
            print(f"| {name} | {samples} | {shown} | {ratio:.3f} | {max(rhat):.4f} | "
                  f"{min(ess):.0f} | {np.median(cpu):.2f} |", flush=True)  # fmt: skip


def coverage(sets: int) -> None:
    print("| setting | T | sets | 50/90/97 % cover | z sd | scale z mean, sd | refused | CPU s |")
    print("|---|---|---|---|---|---|---|---|")
    cases = [("paper", 5), ("paper", 50), ("0.79 m/s²", 5), ("0.79 m/s²", 50),
             ("0.79, 500 deg/s", 50), ("0.79, 300 deg/s", 50)]  # fmt: skip
    for name, samples in cases:
        base = SETTINGS[name]
        plan = MotionPlan(samples, base.rate, base.spin, base.force, base.sigma, base.sigma_gyro)
        ranks, z, scales, cpu, refused = [], [], [], [], 0
        for seed in range(sets):
            try:
                found, true, seconds = one(plan, 1000 + seed)
            except ImucalError as error:
                refused += 1
                print(f"<!-- {name} {samples} {seed}: {error} -->", file=sys.stderr)
                continue
            ranks.append((found.free < true[1:].ravel()).mean(axis=0))
            z.append((found.free.mean(axis=0) - true[1:].ravel()) / found.free.std(axis=0))
            mean, sd = found.scale
            scales.append((mean - scale_of(true[1:].reshape(1, -1).repeat(2, 0), DRAWN)[0]) / sd)
            cpu.append(seconds)
        rank = np.array(ranks)
        cover = [100 * np.mean(np.abs(rank - 0.5) < 0.5 * p) for p in (0.5, 0.9, 0.97)]
        print(f"| {name} | {samples} | {sets} | {'/'.join(f'{c:.1f}' for c in cover)} | "
              f"{np.std(z):.3f} | {np.mean(scales):+.2f}, {np.std(scales):.2f} | {refused} | "
              f"{np.median(cpu):.2f} |", flush=True)  # fmt: skip


def refusals() -> None:
    for rate, spin in ((100.0, 1000.0), (300.0, 3000.0)):
        plan = MotionPlan(500, rate, spin, sigma=0.79)
        for seed in range(3):
            try:
                found, true, _ = one(plan, 2000 + seed)
                size = scale_of(true[1:].reshape(1, -1).repeat(2, 0), DRAWN)[0]
                print(f"{rate:.0f} deg/s: scale error {100 * (found.scale[0] / size - 1):+.2f} % "
                      f"(sd {100 * found.scale[1]:.2f} %)")  # fmt: skip
            except ImucalError as error:
                print(f"{rate:.0f} deg/s: refused: {error}")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["accuracy"]:
            accuracy()
        case ["coverage", *rest]:
            coverage(int(rest[0]) if rest else 100)
        case ["refusals"]:
            refusals()
        case _:
            raise SystemExit(__doc__)
