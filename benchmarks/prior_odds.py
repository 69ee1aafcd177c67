"""What measured instruments lack and how much: the prior odds and sizes of the search (empirical
Bayes).

    python benchmarks/prior_odds.py [--spread 2 3.5 6] ["actigraph day.cwa" ...]

With B_i the Bayes factor of recording i, of all that may be missing against nothing, and π the
share of instruments that lack something, the likelihood is Π_i (1 - π + π B_i). Printed are each
factor, and the mean and the standard deviation of π under an even prior (Carlin and Louis 2000),
for every factor of the sizes' log-normal, with the log of the likelihood, π integrated out: what
these recordings say of one spread of sizes over another. The measured recordings of `sample_logs`
are used, and those of the commands that are given.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from imucalib.posterior.odds import MISSING, SPREAD

SAMPLES = Path(__file__).resolve().parents[1] / "sample_logs"
MEASURED = SAMPLES.parent / "tests" / "measured"
#: Factors beyond which one more tells nothing of the share.
_BEYOND = 1e6
#: The command with another spread of sizes.
_RUN = "import sys, imucalib.posterior.odds as o; o.SPREAD = float(sys.argv.pop(1)); "
_RUN += "from imucalib.cli import main; sys.exit(main())"


def commands() -> list[str]:
    """Of every measured recording at hand the calibrator and its arguments."""
    norm = "--reference norm"
    tumble = f"{norm} --acc 1,2,3 --unit m/s2 --rate 100"
    caves = sorted(SAMPLES.glob("cave_*.csv"))
    return [
        *(f"lab {shlex.quote(str(path))} {norm}" for path in caves),
        *(f"lab {shlex.quote(str(MEASURED / f'imu{k}.log.gz'))} {tumble}" for k in (0, 1)),
        f"lab {shlex.quote(str(SAMPLES / 'paper_table_1.csv'))} --gravity 9.8061 --fix 10:y=-58593",
        f"actigraph {shlex.quote(str(SAMPLES / 'wrist_day.csv.gz'))}",
        f"imu {shlex.quote(str(SAMPLES / 'turns.csv.gz'))}",
    ]


def bayes_factor(command: str, spread: float) -> float:
    """Of all that a recording may lack against nothing, with sizes of a spread; 1 where it is too
    short to be searched."""
    with TemporaryDirectory() as folder:
        words = [*shlex.split(command), "-o", f"{folder}/out", "-q", "--force"]
        subprocess.run([sys.executable, "-c", _RUN, str(spread), *words], check=False)
        report = json.loads(Path(folder, "out", "report.json").read_text("utf-8"))
    nothing = report["loop"]["p_nothing_missing"]
    if nothing is None:
        return 1.0
    return float(min((1.0 - nothing) / max(nothing, 1e-300) / MISSING, _BEYOND))


def main() -> None:
    """Print the factor of every recording, and what they say together."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("more", nargs="*", help="other recordings: a calibrator and its arguments")
    parser.add_argument("--spread", nargs="+", type=float, default=[SPREAD])
    options = parser.parse_args()
    every = [*commands(), *options.more]
    share = np.linspace(0.0, 1.0, 2001)
    for spread in options.spread:
        factors = np.array([bayes_factor(command, spread) for command in every])
        for factor, command in zip(factors, every, strict=True):
            print(f"{factor:10.3g}  {command}", flush=True)
        logs = np.sum(np.log1p(share[:, None] * (factors - 1.0)), axis=1)
        weight = np.exp(logs - logs.max())
        likelihood = float(logs.max() + np.log(weight.mean()))
        weight /= weight.sum()
        mean = float(weight @ share)
        sd = float(np.sqrt(weight @ (share - mean) ** 2))
        odds = f"odds {mean / (1.0 - mean):.2g}, log likelihood {likelihood:.2f}"
        print(f"spread {spread:g}: share {mean:.2f} ± {sd:.2f}, {odds}, of {len(every)}\n")


if __name__ == "__main__":
    main()
