"""The trials of the acceptance benchmark, scenario by scenario, in a fixed order of seeds."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from itertools import count
from types import ModuleType
from typing import Any

import numpy as np
from trial import Job

SIZES = (0.35, 1.0, 3.0)
WORLDS = {
    "lab": "lab_world",
    "actigraph": "week_world",
    "array": "array_world",
    "sheets": "sheet_world",
}


def world(calibrator: str) -> ModuleType:
    """The generator of a calibrator: effects(), OUTSIDE, NOISE, FAULTS, CONFOUNDED, trial(job);
    where it matters sizes(effect), in typical ones, and ABSORBED, what must be listed as such.
    One that has jobs(scale) and rows(trials) brings its own scenarios and marks."""
    return import_module(WORLDS[calibrator])


def jobs(calibrator: str, scale: float) -> Iterator[Job]:
    """All trials of a calibrator; `scale` multiplies their number (1 is the full benchmark)."""
    if hasattr(world(calibrator), "jobs"):
        yield from world(calibrator).jobs(scale)
        return
    seeds = count(1_000_000 * (1 + list(WORLDS).index(calibrator)))
    for scenario, number, recipes in _recipes(world(calibrator)):
        for recipe in recipes:
            for _ in range(max(1, round(number * scale))):
                yield Job(calibrator, scenario, next(seeds), **recipe)


Recipe = dict[str, Any]


def _recipes(of: ModuleType) -> Iterator[tuple[str, int, list[Recipe]]]:
    """Scenario, trials of each recipe at scale 1, and the recipes."""
    names = of.effects()
    yield "clean", 400, [{}]
    for kind in of.NOISE:
        yield f"noise: {kind}", 100, [{"noise": kind}]
    sizes = getattr(of, "sizes", lambda name: SIZES)
    single = [{"effects": ((name, size),)} for name in names for size in sizes(name)]
    yield "one effect", 300 // len(single) + 3, single
    draw = np.random.default_rng(5)
    pairs = [draw.choice(len(names), 2, replace=False) for _ in range(40)]
    yield "two effects", 3, [{"effects": tuple((names[k], 1.0) for k in pair)} for pair in pairs]
    for size, words in ((1.0, "weak"), (3.0, "strong")):
        yield f"outside, {words}", 30, [{"outside": (name, size)} for name in of.OUTSIDE]
    some = [{"effects": ((n, size),), "layout": layout} for n, layout, size in of.CONFOUNDED]
    yield "confounded", 40, some
    for fault in of.FAULTS:
        yield f"fault: {fault}", 60, [{"fault": fault}]
