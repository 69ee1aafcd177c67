"""The prior odds that a recording lacks something, from measured instruments (empirical Bayes).

    python benchmarks/prior_odds.py out/*/report.json

With B_i the Bayes factor of recording i, of all that may be missing against nothing, and π the
share of instruments that lack something, the likelihood is Π_i (1 - π + π B_i). Printed are each
factor, and the mean and the standard deviation of π under an even prior (Carlin and Louis 2000).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from imucalib.loop.odds import MISSING

#: Factors beyond which one more tells nothing of the share.
_BEYOND = 1e6


def main(paths: list[str]) -> None:
    """Print the factor of every report, and what they say together."""
    factors = []
    for path in paths:
        nothing = json.loads(Path(path).read_text("utf-8"))["loop"]["p_nothing_missing"]
        factors.append(min((1.0 - nothing) / max(nothing, 1e-300) / MISSING, _BEYOND))
        print(f"{factors[-1]:10.3g}  P(nothing missing) {nothing:.3f}  {path}")
    share = np.linspace(0.0, 1.0, 2001)
    weight = np.exp(np.sum(np.log1p(share[:, None] * (np.array(factors) - 1.0)), axis=1))
    weight /= weight.sum()
    mean = float(weight @ share)
    sd = float(np.sqrt(weight @ (share - mean) ** 2))
    print(f"share {mean:.2f} ± {sd:.2f}, odds {mean / (1.0 - mean):.2g}, of {len(factors)}")


if __name__ == "__main__":
    main(sys.argv[1:])
