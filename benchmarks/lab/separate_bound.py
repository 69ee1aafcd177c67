"""How near a plan of `design --separate` is to the best that any attitudes could do.

    python benchmarks/lab/separate_bound.py [--devices 8] [--size 2]

As many rests as the plan has, spread over a grid of 5 deg in any shares: the least of λ² sin² over
the ordered pairs of rivals, a mean over the sizes that the recording allows, is concave in the
shares, so that its linearisation bounds it from above (Frank and Wolfe 1956; of designs: Kiefer
1974). Printed are λ sin(angle) now, by the plan (15 deg steps, exchanged), by the best shares that
were found, and the bound.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

from collections.abc import Sequence

import numpy as np
import separate

from imucalib.calibrators.separate.candidates import Rests, pool_of, rests_of
from imucalib.calibrators.separate.recorded import recorded_block, recorded_of
from imucalib.loop.separation.ambiguities import ambiguities
from imucalib.loop.separation.angle import Pair, pairs_of
from imucalib.loop.separation.choice import total_of
from imucalib.loop.separation.plan import can_be_told, separation

GRID, ROUNDS, SHARP = 5.0, 400, 20.0  # deg


def squares(gram: np.ndarray, pairs: Sequence[Pair]) -> tuple[np.ndarray, list[np.ndarray]]:
    """λ² sin² of each pair, the mean over sizes, and (P, draws) what each size leaves of the truth
    beside its rival: the slope by a rest's products M is the mean of tᵀ M t."""
    values, left = [], []
    for pair in pairs:
        inside = gram[np.ix_(pair.rest, pair.rest)]
        inside = inside + np.diag(1e-10 * np.diag(inside) + 1e-12)
        carry = np.linalg.solve(inside, gram[np.ix_(pair.rest, pair.own)])
        own = np.zeros((len(gram), pair.size.shape[1]))
        own[pair.own], own[pair.rest] = pair.size, -carry @ pair.size
        left.append(own)
        values.append(float(np.mean(np.einsum("pd,pq,qd->d", own, gram, own))))
    return np.array(values), left


def best(
    old: np.ndarray, each: np.ndarray, count: int, pairs: Sequence[Pair]
) -> tuple[float, float]:
    """The largest least λ² sin² that was found, and its bound."""
    share, found, bound = np.full(len(each), 1.0 / len(each)), 0.0, np.inf
    for k in range(ROUNDS):
        value, left = squares(old + count * np.tensordot(share, each, 1), pairs)
        found = max(found, float(value.min()))
        weight = np.exp(-SHARP * (value / value.min() - 1.0))
        weight /= weight.sum()
        slope = sum(
            w * np.einsum("pd,cpq,qd->c", t, each, t, optimize=True) / t.shape[1]
            for w, t in zip(weight, left, strict=True)
        )
        bound = min(bound, float(weight @ value + count * (slope.max() - slope @ share)))
        share *= 1.0 - 2.0 / (k + 3.0)
        share[int(np.argmax(slope))] += 2.0 / (k + 3.0)
    return found, bound


def grid() -> Rests:
    """Every attitude of a two-axis table."""
    i, t = np.meshgrid(np.arange(-90.0, 90.1, GRID), np.arange(0.0, 360.0, GRID))
    return Rests(np.radians(i.ravel()), np.radians(t.ravel()), {})


def trial(truth: str, size: float, seed: int) -> str | None:
    one = separate.device("angles", truth, size, np.random.default_rng((seed, 6, len(truth))))
    loop = separate.search("angles", separate.first_table("angles", one))
    found = [a for a in ambiguities(loop) if truth in a.rivals]
    if not found or len(loop.named) != 1:
        return None
    fit, ambiguity = loop.as_recorded, found[0]
    reading = fit.noise.factor * float(np.median(fit.observations.sigma))
    block = recorded_of(recorded_block(fit, found, reading, separate.setting_noise(fit)), "here")
    calibration, old = separate.calibration_of(fit), ambiguity.products.gram
    pool = pool_of(block, calibration, ambiguity, rests_of(block, ambiguity))
    each = pool_of(block, calibration, ambiguity, grid()).gram
    plan = separation(ambiguity, pool, np.random.default_rng(seed)).plan
    pairs = [p for p in pairs_of(ambiguity) if can_be_told(ambiguity, pool, p)]
    now, then = (squares(g, pairs)[0].min() for g in (old, old + total_of(pool, plan)))
    cells = np.sqrt([now, then, *best(old, each, len(plan), pairs)])
    return f"| {truth} | {len(plan)} | " + " | ".join(f"{c:.2f}" for c in cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=8)
    parser.add_argument("--size", type=float, default=2.0)
    asked = parser.parse_args()
    print("| truth | rests | now | plan | best shares | bound |\n|---|---|---|---|---|---|")
    for truth in separate.TRUTHS["angles"]:
        for seed in range(asked.devices):
            line = trial(truth, asked.size, seed)
            if line:
                print(line, flush=True)


if __name__ == "__main__":
    main()
