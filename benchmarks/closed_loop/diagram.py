"""The reliability diagram: how often names are true that are told with a probability, of all tables
of RESULTS.md that say so, class by class.

    python benchmarks/closed_loop/diagram.py
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

from scipy.stats import beta

RESULTS = Path(__file__).resolve().parents[1] / "RESULTS.md"
#: A row of `table.reliability`: class, names, mean probability, share that is true.
_ROW = re.compile(r"^\| (\d\.\d\d to \d\.\d\d) \| (\d+) \| (\d\.\d\d) \| (\d\.\d\d) \|$", re.M)


def classes(text: str) -> list[tuple[float, int, int]]:
    """Of every class the mean probability stated, the names, and how many are true."""
    stated, names, true = defaultdict(float), defaultdict(int), defaultdict(int)
    for group, n, mean, share in _ROW.findall(text):
        stated[group] += int(n) * float(mean)
        names[group] += int(n)
        true[group] += round(int(n) * float(share))
    return [(stated[g] / names[g], names[g], true[g]) for g in sorted(names)]


def main() -> None:
    """Draw each class with the 95 % interval of its share (Clopper and Pearson 1934) and its
    number of names."""
    from matplotlib import rcParams
    from matplotlib.figure import Figure

    rcParams["svg.hashsalt"] = "imucal"
    figure = Figure(figsize=(4.5, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.plot([0.0, 1.0], [0.0, 1.0], color="0.7", linestyle="--")
    for at, n, k in classes(RESULTS.read_text("utf-8")):
        share = k / n
        least = beta.ppf(0.025, k, n - k + 1) if k else 0.0
        most = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
        reach = [[share - least], [most - share]]
        axes.errorbar([at], [share], yerr=reach, fmt="o", color="C0", capsize=3)
        axes.annotate(str(n), (at, share), xytext=(6, -12), textcoords="offset points")
    axes.set(xlabel="probability stated", ylabel="share that is true", xlim=(0, 1), ylim=(0, 1.02))
    figure.savefig(RESULTS.with_name("reliability.svg"), metadata={"Date": None})


if __name__ == "__main__":
    main()
