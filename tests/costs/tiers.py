"""The two tiers: `make test` has what a change can break soon, `make test-slow` the rest.

A test that costs more than 0.6 CPU s is of the slow tier. Of a test with many members the cheapest
stays in the fast one, so that nothing is without a guard there.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

LIST = Path(__file__).with_name("slow_tier.txt")
#: CPU seconds beyond which a test is slow, and beyond which even the cheapest member is.
SLOW, TOO_SLOW = 0.6, 3.0


def slow_tier() -> frozenset[str]:
    """Names of the slow tests, below tests/."""
    lines = LIST.read_text(encoding="utf-8").splitlines()
    return frozenset(line for line in lines if line and not line.startswith("#"))


def chosen(costs: Mapping[str, float]) -> list[str]:
    """Names of the tests (name -> CPU s) that belong to the slow tier."""
    members = defaultdict[str, list[str]](list)
    for name in sorted(costs, key=lambda n: costs[n]):
        members[name.partition("[")[0]].append(name)
    kept = {m[0] for m in members.values() if len(m) > 1 and costs[m[0]] <= TOO_SLOW}
    return sorted(name for name, cost in costs.items() if cost > SLOW and name not in kept)


def rooms(costs: Mapping[str, float]) -> dict[str, tuple[int, float]]:
    """Room -> how many tests, and their CPU s; most first."""
    sums = defaultdict[str, list[float]](list)
    for name, cost in costs.items():
        folders = name.partition("::")[0].split("/")[:-1]
        sums["/".join(folders[:2]) or "of the house"].append(cost)
    found = {room: (len(each), sum(each)) for room, each in sums.items()}
    return dict(sorted(found.items(), key=lambda item: -item[1][1]))
