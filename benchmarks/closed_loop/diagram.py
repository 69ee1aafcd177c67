"""The reliability diagram: how often names are true that are given with a probability."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta
from table import EDGES


def draw(stated: NDArray[np.float64], true: NDArray[np.bool_], path: str) -> None:
    """Write the share of true names of each class against their mean probability, with the 95 %
    interval of the share (Clopper and Pearson 1934) and the number of names.

    stated, true : (n,) probability of each name and whether it is true; path : of the SVG
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.5, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.plot([0.0, 1.0], [0.0, 1.0], color="0.7", linestyle="--")
    for low, high in pairwise(EDGES):
        mine = (stated >= low) & (stated < high)
        n, k = int(mine.sum()), int(true[mine].sum())
        if not n:
            continue
        at, share = float(stated[mine].mean()), k / n
        least = beta.ppf(0.025, k, n - k + 1) if k else 0.0
        most = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
        reach = [[share - least], [most - share]]
        axes.errorbar([at], [share], yerr=reach, fmt="o", color="C0", capsize=3)
        axes.annotate(str(n), (at, share), xytext=(6, -12), textcoords="offset points")
    axes.set(xlabel="probability stated", ylabel="share that is true", xlim=(0, 1), ylim=(0, 1.02))
    figure.savefig(path, metadata={"Date": None})
