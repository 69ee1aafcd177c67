"""The array's closed loop on simulated logs with one undeclared error each: found, named, covered.

python benchmarks/array/stories.py [SEEDS [SAMPLES]]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from worlds.array_stories import STORIES, closed, named, planted_log, positions_z

_FIRST = 1000  # seeds from here on


def story(name: str, seeds: int, samples: int) -> str:
    """One row of the table."""
    effect = STORIES[name][0]
    right, other, z, off, cpu = 0, 0, [], [], []
    for seed in range(_FIRST, _FIRST + seeds):
        recording, true = planted_log(name, seed)
        start = time.process_time()
        found = closed(recording, samples)
        cpu.append(time.process_time() - start)
        names = named(found)
        right += effect in names if effect else not found.steps and not found.unexplained
        extra = [s for s in found.steps if effect not in (s.effect, *s.aliases)]
        other += bool(extra) or bool(found.unexplained)
        if effect != "sensing_elements":
            z.append(positions_z(found, true))
        assert found.gained is not None
        off.append(found.gained.acceleration.after / found.gained.acceleration.before)
    spread = f"{np.sqrt(np.mean(np.square(z))):.2f}" if z else "-"
    within = f"{100 * np.mean(np.abs(z) < 1.96):.0f} %" if z else "-"
    return (f"| {name} | {right} of {seeds} | {other} of {seeds} | {spread} | {within} | "
            f"{np.median(cpu):.2f} |")  # fmt: skip


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    samples = int(sys.argv[2]) if len(sys.argv) > 2 else 200
    print(f"T = {samples}, seeds {_FIRST} to {_FIRST + seeds - 1}\n")
    print("| planted | named, or in the set (clean: nothing) | something else claimed as well | "
          "z rms of positions | within 95 % | CPU s, median |")  # fmt: skip
    print("|---|---|---|---|---|---|")
    for name in STORIES:
        print(story(name, seeds, samples), flush=True)


if __name__ == "__main__":
    main()
