"""Intervals of the noise at rest against truth, on axes that plain numpy makes.

    python benchmarks/noise.py --seconds 3600 --rate 100 --axes 48 --seed 1

White noise of 1 unit/√Hz; flicker as Lorentzians an octave apart, S(f) = 1 / (ln 2 f); a walk of
independent steps. Prints a Markdown table: of every mix, how often a term is told, its median over
the truth, how many of the told intervals and of the limits hold, and what is told and not there.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
TERMS = ("white", "instability", "walk")
#: Instability times √span and walk times span, over the white noise.
MIXES = {
    "white": (0.0, 0.0),
    "white, instability": (12.0, 0.0),
    "white, walk": (0.0, 80.0),
    "all three": (15.0, 100.0),
}


def made(rng: np.random.Generator, n: int, step: float, flicker: float, walk: float) -> Array:
    """(n,) samples every `step` s."""
    y = rng.normal(size=n) / np.sqrt(step)
    y += walk * np.sqrt(step) * np.cumsum(rng.normal(size=n))
    total = np.zeros(n)
    for octave in range(int(np.log2(n)) + 3 if flicker else 0):
        keep = np.exp(-1.0 / 2.0**octave)
        start = [keep * rng.normal()]
        total += lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.normal(size=n), zi=start)[0]
    return np.asarray(y + flicker * np.sqrt(np.log(2.0) / np.pi) * total)


def main() -> None:
    """Judge every mix and print the table."""
    from imucalib.inspection.allan import AllanSums
    from imucalib.inspection.noise import identify

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--axes", type=int, default=16)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    step, span = 1.0 / options.rate, options.seconds
    print("| mix | term | told | median over truth | intervals hold | limits hold | false |")
    print("|---|---|---|---|---|---|---|")
    for mix, (flicker, walk) in MIXES.items():
        truth = (1.0, flicker / np.sqrt(span), walk / span)
        told: dict[str, list[tuple[float, bool]]] = {term: [] for term in TERMS}
        limits, false = dict.fromkeys(TERMS, 0), 0
        for axis in range(options.axes):
            rng = np.random.default_rng((options.seed, axis))
            sums = AllanSums(1)
            sums.add(made(rng, int(span / step), step, *truth[1:])[:, None])
            found = identify(sums.curves(step)[0])
            false += sum(t.value is not None for t in (found.ramp, found.quantisation))
            for term, true in zip(TERMS, truth, strict=True):
                own = getattr(found, term)
                if own.value is None:
                    limits[term] += own.bound >= true
                elif true == 0.0:
                    false += 1
                else:
                    told[term].append((own.value / true, own.low <= true <= own.high))
        for term in TERMS:
            ratio = f"{np.median([r for r, _ in told[term]]):.3f}" if told[term] else ""
            held, rest = sum(h for _, h in told[term]), options.axes - len(told[term])
            print(
                f"| {mix} | {term} | {len(told[term])} of {options.axes} | {ratio} | {held} of "
                f"{len(told[term])} | {limits[term]} of {rest} | {false} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
