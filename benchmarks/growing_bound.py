"""What looking again must cost: the level that one look of many can have, plain numpy.

    python benchmarks/growing_bound.py [--tables 40000]

A table that lacks nothing is looked at after every four rows from 16 on, up to so many; the largest
of eight effects of three numbers each (χ² with 3 degrees of freedom, as more rows come) is held
against one bar at every look, such that any look passes it in 5 % of tables. What is printed is how
often one look alone does: no rule that treats all looks alike gives one of them more.
"""

from __future__ import annotations

import argparse

import numpy as np

EFFECTS, NUMBERS, FIRST, STEP, LEVEL = 8, 3, 16, 4, 0.05


def looks(most: int) -> list[int]:
    """After every four rows up to 72, then after every tenth more."""
    rows = list(range(FIRST, min(most, 72) + 1, STEP))
    while (more := int(rows[-1] * 1.1) + 1) <= most:
        rows.append(more)
    return rows


def level(rows: list[int], tables: int, rng: np.random.Generator) -> float:
    """Share of tables that one look alone passes."""
    largest = np.zeros((tables, len(rows)))
    for _ in range(EFFECTS):
        walk, before = np.zeros((tables, NUMBERS)), 0
        for k, n in enumerate(rows):
            walk += np.sqrt(n - before) * rng.standard_normal(walk.shape)
            largest[:, k] = np.maximum(largest[:, k], np.sum(walk**2, axis=1) / n)
            before = n
    bar = np.quantile(largest.max(axis=1), 1.0 - LEVEL)
    return float(np.mean(largest[:, -1] > bar))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tables", type=int, default=40000)
    tables = parser.parse_args().tables
    rng = np.random.default_rng(0)
    print("| rows up to | looks | level of one look |\n|---|---|---|")
    for most in (36, 72, 144, 288):
        rows = looks(most)
        print(f"| {most} | {len(rows)} | {100 * level(rows, tables, rng):.2f} % |", flush=True)


if __name__ == "__main__":
    main()
