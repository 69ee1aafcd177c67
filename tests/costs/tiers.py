"""The two tiers: `make test` has what a change can break soon, `make test-slow` the rest.

A test that costs more than 0.4 CPU s is of the slow tier, unless it enters functions of the
package that no quicker one does: the fast tier runs all of the package that a test of seven seconds
reaches.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

from costs.reach import Reach

LIST = Path(__file__).with_name("slow_tier.txt")
#: CPU seconds beyond which a test is slow, and beyond which it is whatever it enters.
SLOW, TOO_SLOW = 0.4, 7.0


def slow_tier() -> frozenset[str]:
    """Names of the slow tests, below tests/."""
    lines = LIST.read_text(encoding="utf-8").splitlines()
    return frozenset(line for line in lines if line and not line.startswith("#"))


def chosen(reach: Reach) -> list[str]:
    """Names of the tests that belong to the slow tier, below tests/."""
    entered = defaultdict[str, set[str]](set)
    for function, tests in reach.tests.items():
        for test in tests:
            entered[test].add(function)
    slow = {test for test, cost in reach.seconds.items() if cost > SLOW}
    missing = set(reach.tests) - {f for test in reach.seconds if test not in slow
                                  for f in entered[test]}  # fmt: skip
    # The most new functions a second, one test after the other.
    affordable = sorted(test for test in slow if reach.seconds[test] <= TOO_SLOW)
    while missing and affordable:
        best = max(affordable, key=lambda t: len(entered[t] & missing) / reach.seconds[t])
        if not entered[best] & missing:
            break
        missing -= entered[best]
        slow.remove(best)
        affordable.remove(best)
    return sorted(test.removeprefix("tests/") for test in slow)


def rooms(costs: Mapping[str, float]) -> dict[str, tuple[int, float]]:
    """Room -> how many tests, and their CPU s; most first."""
    sums = defaultdict[str, list[float]](list)
    for name, cost in costs.items():
        folders = name.partition("::")[0].split("/")[:-1]
        sums["/".join(folders[:2]) or "of the house"].append(cost)
    found = {room: (len(each), sum(each)) for room, each in sums.items()}
    return dict(sorted(found.items(), key=lambda item: -item[1][1]))
