"""Intervals of the noise at rest against truth, on axes that plain numpy makes, beside allantools.

    python benchmarks/noise.py --seconds 3600 --rate 100 --axes 48 --seed 1

White noise of 1 unit/√Hz; flicker as Lorentzians an octave apart, S(f) = 1 / (ln 2 f); a walk of
independent steps. Prints a Markdown table: of every mix, how often a term is told, its median over
the truth, how many of the told intervals and of the limits hold, how often it is told and not
there (quantisation and ramps, which are never there, in the sum of all mixes), and the median of
allantools (extra `benchmarks`): `oadev` at octaves, the three terms by least squares with none
negative, each variance weighted by its size over √τ.
"""

from __future__ import annotations

import argparse
from collections import defaultdict

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.signal import lfilter

Array = NDArray[np.float64]
#: Variance per squared coefficient at τ (IEEE Std 952).
TERMS = {
    "white": lambda tau: 1.0 / tau,
    "instability": lambda tau: 2.0 * np.log(2.0) / np.pi * tau**0.0,
    "walk": lambda tau: tau / 3.0,
}
NEVER = ("quantisation", "ramp")
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


def fitted(y: Array, step: float) -> Array:
    """(3,) coefficients of the terms by allantools and least squares."""
    import allantools

    tau, deviation, _, _ = allantools.oadev(y, 1.0 / step, data_type="freq", taus="octave")
    weight = 1.0 / (deviation**2 * np.sqrt(tau))
    rows = np.stack([shape(tau) for shape in TERMS.values()], axis=1)
    return np.sqrt(nnls(rows * weight[:, None], deviation**2 * weight)[0])


def main() -> None:
    """Judge every mix and print the table."""
    from imucalib.inspection.noise import AllanSums, identify

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--axes", type=int, default=16)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    step, span = 1.0 / options.rate, options.seconds
    print(
        "| mix | term | told | median over truth | intervals hold | limits hold | false "
        "| allantools: median over truth |\n|---|---|---|---|---|---|---|---|"
    )
    total = defaultdict(_Tally)
    for mix, (flicker, walk) in MIXES.items():
        truth = dict(zip(TERMS, (1.0, flicker / np.sqrt(span), walk / span), strict=True))
        own = defaultdict(_Tally)
        for axis in range(options.axes):
            rng = np.random.default_rng((options.seed, axis, *map(ord, mix)))
            y = made(rng, int(span / step), step, truth["instability"], truth["walk"])
            sums = AllanSums(1)
            sums.add(y[:, None])
            found = identify(sums.curves(step)[0])
            other = dict(zip(TERMS, fitted(y, step), strict=True))
            for term in (*TERMS, *NEVER):
                for tally in (own[term], total[term]):
                    tally.add(getattr(found, term), truth.get(term, 0.0), other.get(term))
        for term in TERMS:
            print(f"| {mix} | {term} | {own[term]}", flush=True)
    for term, tally in total.items():
        print(f"| every mix | {term} | {tally}")


class _Tally:
    """What was told of one term."""

    def __init__(self) -> None:
        self.ratio: list[float] = []
        self.others: list[float] = []
        self.held = self.limits = self.kept = self.false = self.absent = 0

    def add(self, told: object, truth: float, other: float | None) -> None:
        """One axis: the coefficient with its interval or bound, and that of allantools."""
        self.absent += truth == 0.0
        if truth and other is not None:
            self.others.append(other / truth)
        if told.value is None:
            self.limits += 1
            self.kept += told.bound >= truth
        elif truth:
            self.ratio.append(told.value / truth)
            self.held += told.low <= truth <= told.high
        else:
            self.false += 1

    def __str__(self) -> str:
        told = len(self.ratio)
        median, others = (f"{np.median(r):.3f}" if r else "" for r in (self.ratio, self.others))
        return (
            f"{told} of {told + self.limits} | {median} | {self.held} of {told} "
            f"| {self.kept} of {self.limits} | {self.false} of {self.absent} | {others} |"
        )


if __name__ == "__main__":
    main()
