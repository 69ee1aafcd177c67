"""Calibration files with one leaf changed: of another type or size, or missing."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np

OTHERS: tuple[Any, ...] = (
    None, True, "", "x", "-1", -1, 0, 3, 10**30, -2.5, 1e-300, 1e300, float("nan"), float("inf"),
    [], [1], ["x"], [[1.0, 2.0], [3.0]], {}, {"x": 1}, "2024-01-01", "imu7", [None],
)  # fmt: skip


def places(content: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where every value of a document stands, blocks included."""
    pairs = content.items() if isinstance(content, dict) else enumerate(content)
    for key, value in pairs:
        yield (*above, key)
        if isinstance(value, dict | list):
            yield from places(value, (*above, key))


def mutants(content: dict[str, Any], count: int, seed: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """What was changed, and the document; each key of the top is as likely as any other."""
    rng = np.random.default_rng(seed)
    top = list(content)
    for _ in range(count):
        changed = copy.deepcopy(content)
        first = top[int(rng.integers(len(top)))]
        whole = [(first,), *(p for p in places({first: content[first]}) if len(p) > 1)]
        place = whole[int(rng.integers(len(whole)))]
        block: Any = changed
        for key in place[:-1]:
            block = block[key]
        new = OTHERS[int(rng.integers(len(OTHERS)))]
        if rng.random() < 0.15:
            del block[place[-1]]
            new = "deleted"
        else:
            block[place[-1]] = new
        yield f"{'.'.join(map(str, place))} = {new!r}", changed
