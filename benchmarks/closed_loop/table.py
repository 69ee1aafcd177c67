"""The benchmark's table: a row for each sort of world."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from draws import ROWS
from judge import Judged
from numpy.typing import NDArray

HEADING = (
    "worlds",
    "n",
    "claims",
    "names a cause",
    "truth in the sets",
    "certain and right",
    "certain and wrong",
    "error over oracle: median, 90 %, worst",
    "response over its oracle",
    "over base: median",
    "worse than base by 5 %",
    "95 % intervals hold",
    "record accused",
    "CPU s",
)
#: By how much an error may exceed the base model's before it counts as worse.
_WORSE = 1.05
#: Edges of the classes of stated probabilities.
EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.01)


def table(judged: Sequence[Judged]) -> str:
    """Markdown, and below it what is said of slips and how reliable probabilities are."""
    lines = [f"| {' | '.join(HEADING)} |", "|" + "---|" * len(HEADING)]
    for row in ROWS:
        some = [j for j in judged if j.recipe.row == row]
        if some:
            lines.append(f"| {' | '.join(_cells(row, some))} |")
    failed = [j for j in judged if j.told is None and not j.recipe.slip]
    lines += [
        f"no report: {j.recipe.kind} {j.recipe.seed}, exit {j.code}: {j.said}" for j in failed
    ]
    return "\n".join([*lines, *_slips(judged), *_reliability(judged), *_of_nothing(judged)])


def _cells(row: str, some: Sequence[Judged]) -> list[str]:
    planted = row not in ("clean", "slip", "outside")
    valued = [j for j in some if not np.isnan(j.error) and row != "slip"]
    held, of = sum(j.held for j in valued), sum(j.intervals for j in valued)
    worse = sum(j.over_base > _WORSE for j in valued)
    return [
        row,
        str(len(some)),
        _share(some, lambda j: j.claims),
        _share(some, lambda j: j.told is not None and j.told.names),
        _share(some, lambda j: j.within) if planted else "",
        _share(some, lambda j: j.right) if planted else "",
        str(sum(j.wrong for j in some)),
        _quantiles([j.over_oracle for j in valued], 0.5, 0.9, 1.0),
        _quantiles([j.over_response for j in valued if np.isfinite(j.response)], 0.5, 0.9, 1.0),
        _quantiles([j.over_base for j in valued], 0.5),
        f"{worse} of {len(valued)}" if valued else "",
        f"{held / of:.3f}" if of else "",
        _share(some, lambda j: j.accused),
        _quantiles([j.seconds for j in some], 0.5, 0.9),
    ]


def _share(some: Sequence[Judged], test: Callable[[Judged], bool]) -> str:
    return f"{100.0 * sum(test(j) for j in some) / len(some):.0f} %"


def _quantiles(values: Sequence[float], *levels: float) -> str:
    return " ".join(f"{q:.2f}" for q in np.quantile(values, levels)) if values else ""


def _slips(judged: Sequence[Judged]) -> list[str]:
    """What came of each kind of slip."""
    some = [j for j in judged if j.recipe.slip]
    if not some:
        return []
    lines = ["", "| slip | n | right | wrong | missed |", "|---|---|---|---|---|"]
    for kind in dict.fromkeys(sorted(j.recipe.slip for j in some)):
        mine = [j.slip for j in some if j.recipe.slip == kind]
        counts = " | ".join(str(mine.count(w)) for w in ("right", "wrong", "missed"))
        lines.append(f"| {kind} | {len(mine)} | {counts} |")
    return lines


def _stated(judged: Sequence[Judged]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Probability of each name that is told, and whether it is true; outside the catalogue no name
    is."""
    said = [
        (s.probability, s.names[0] in j.recipe.planted)
        for j in judged
        if j.told and not j.recipe.outside
        for s in j.told.steps
        if s.probability is not None and s.named
    ]
    return np.array([a for a, _ in said], float), np.array([b for _, b in said], bool)


def _reliability(judged: Sequence[Judged]) -> list[str]:
    """How often a name is true that is given with a probability; nothing where none is stated."""
    p, true = _stated(judged)
    if not p.size:
        return []
    lines = ["", "| probability stated | n | stated, mean | true |", "|---|---|---|---|"]
    for low, high in pairwise(EDGES):
        mine = (p >= low) & (p < high)
        if mine.any():
            words = f"{low:.2f} to {min(high, 1.0):.2f}"
            lines.append(
                f"| {words} | {mine.sum()} | {p[mine].mean():.2f} | {true[mine].mean():.2f} |"
            )
    return lines


def _of_nothing(judged: Sequence[Judged]) -> list[str]:
    """How often nothing is missing where that is said, against its stated probability."""
    said = [
        (j.told.nothing, j.recipe.row == "clean")
        for j in judged
        if j.told and j.told.nothing is not None and not j.told.claims and not j.recipe.slip
    ]
    if not said:
        return []
    stated, true = np.mean(said, axis=0)
    return ["", f"Nothing missing: said of {len(said)}, stated {stated:.2f}, true {true:.2f}"]
