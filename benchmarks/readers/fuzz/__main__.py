"""The truth fuzzer: damaged files of every format, and whether a wrong sample comes out unsaid.

    python benchmarks/readers/fuzz [--files 3000] [--seed 0] [--first 0] [--case NUMBER]
                                      [--show OUTCOME ...]

Every file is written by code that knows nothing of the readers, with the truth of each sample;
then it is cut, flipped, swapped, zeroed. A seed and a number make the same file again: `--case`
reads one and shows its traceback. The mark: nothing silent where a checksum covers what was
damaged, no traceback, no crash, no hang. Each case has 20 s and 1.5 GB more than an empty process.
"""

from __future__ import annotations

import argparse
import os
import resource
import select
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[3] / "tests"))
from worlds.fuzz import calibrations
from worlds.fuzz.cases import OUTCOMES, SECONDS, Fuzzer, Verdict
from worlds.fuzz.files import kinds

_MORE_MEMORY = 1536 << 20
BAD = ("silent", "traceback", "crash", "hang", "memory")


def judged(numbers: range, seed: int) -> Iterator[Verdict]:
    """Cases in a child process; one that dies or hangs in C costs its case and a new child."""
    at = numbers.start
    while at < numbers.stop:
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reading)
            _work(range(at, numbers.stop), seed, writing)
        os.close(writing)
        died = ""
        with os.fdopen(reading, "r") as lines:
            while at < numbers.stop:
                ready, _, _ = select.select([lines], [], [], 3 * SECONDS)
                line = lines.readline() if ready else ""
                if not line.endswith("\n"):
                    died = "crash" if ready else "hang"
                    break
                number, *words = line.rstrip("\n").split("\t")
                yield Verdict(int(number), *words)
                at = int(number) + 1
        if died != "crash":
            os.kill(child, 9)
        _, status = os.waitpid(child, 0)
        if died:
            yield Verdict(at, kind_of(at), "", died, f"the process ended with status {status}")
            at += 1


def _work(numbers: range, seed: int, out: int) -> None:
    """In the child: one line a case."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + _MORE_MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    try:
        with TemporaryDirectory() as folder:
            fuzzer = Fuzzer(Path(folder), seed)
            for number in numbers:
                words = [" ".join(str(v).split()) for v in astuple(fuzzer.case(number))]
                os.write(out, ("\t".join(words) + "\n").encode(errors="replace"))
    finally:
        os._exit(0)


def kind_of(number: int) -> str:
    """The format of a case."""
    names = [*kinds(), calibrations.NAME]
    return names[number % len(names)]


def table(verdicts: list[Verdict]) -> str:
    """Formats by outcomes, in Markdown."""
    counts = Counter((v.kind, v.outcome) for v in verdicts)
    checked = {v.kind: v.checked for v in verdicts}
    lines = [f"| format | checksum over | files | {' | '.join(OUTCOMES)} |"]
    lines.append("|---" * (3 + len(OUTCOMES)) + "|")
    for kind, covers in checked.items():
        row = [counts[kind, o] for o in OUTCOMES]
        lines.append(f"| {kind} | {covers} | {sum(row)} | {' | '.join(map(str, row))} |")
    row = [sum(counts[kind, o] for kind in checked) for o in OUTCOMES]
    return "\n".join([*lines, f"| all | | {sum(row)} | {' | '.join(map(str, row))} |"])


def main() -> None:
    """Parse the options and run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--case", type=int, help="one case in this process")
    parser.add_argument("--keep", type=Path, help="with --case: the folder that keeps the file")
    parser.add_argument("--show", nargs="*", default=list(BAD), choices=OUTCOMES)
    options = parser.parse_args()
    if options.case is not None:
        with TemporaryDirectory() as folder:
            print(Fuzzer(options.keep or Path(folder), options.seed).case(options.case))
        return
    verdicts = []
    for v in judged(range(options.first, options.first + options.files), options.seed):
        verdicts.append(v)
        if v.outcome in options.show:
            print(f"{v.number} {v.kind}, {v.outcome}: {v.detail}", file=sys.stderr)
    print(table(verdicts))


if __name__ == "__main__":
    main()
