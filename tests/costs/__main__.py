"""Measure every test, decide the tiers, and write docs/testing.md's tables of costs.

python tests/costs --reach FILE ... [--fast]    records (`reach`), the later ones' word counts; the
                                                last is measured where it does not exist
--fast : the fast tier alone is measured, and tiers stay as they are
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from costs.reach import collected, read, record
from costs.tiers import LIST, SLOW, chosen, rooms, slow_tier
from testing_page import written


def tables(costs: Mapping[str, float]) -> str:
    """Markdown: CPU s of both tiers by room, and the twenty that cost most in the fast one."""
    slow = slow_tier()
    fast = {name: cost for name, cost in costs.items() if name not in slow}
    rest = {name: cost for name, cost in costs.items() if name in slow}
    lines = ["| room | tests | CPU s | slow tests | CPU s |", "|---|---|---|---|---|"]
    of_rest = rooms(rest)
    for room, (count, cost) in rooms(fast).items():
        other = of_rest.get(room, (0, 0.0))
        lines.append(f"| {room} | {count} | {cost:.0f} | {other[0]} | {other[1]:.0f} |")
    lines.append(
        f"| all | {len(fast)} | {sum(fast.values()):.0f} | {len(rest)} | {sum(rest.values()):.0f} |"
    )
    lines += ["", "The twenty that cost most of `make test`:", "", "| test | CPU s |", "|---|---|"]
    most = sorted(fast, key=lambda name: -fast[name])[:20]
    return "\n".join([*lines, *(f"| `{name}` | {fast[name]:.1f} |" for name in most)])


def main() -> None:
    """Run, decide, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fast", action="store_true")
    parser.add_argument("--reach", type=Path, nargs="+", required=True)
    options = parser.parse_args()
    if not options.reach[-1].exists():
        record(options.reach[-1], "not slow" if options.fast else "")
    reach = read(options.reach).known_to(collected(""))
    if not options.fast:
        head = f"# Tests of more than {SLOW} CPU s, by `python tests/costs`: of `make test-slow`.\n"
        LIST.write_text(head + "\n".join(chosen(reach)) + "\n", encoding="utf-8")
    written("costs", tables({t.removeprefix("tests/"): c for t, c in reach.seconds.items()}))


if __name__ == "__main__":
    main()
